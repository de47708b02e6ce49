"""Reports: one self-contained HTML page of an identification or of several compared, terminal tables, plots."""

from haptid.report.compared import write_comparison
from haptid.report.report import Report, make_report, read_report, report_of
from haptid.report.source import Hand, Source
from haptid.report.terminal import sparklines

__all__ = ["Hand", "Report", "Source", "make_report", "read_report", "report_of", "sparklines", "write_comparison"]
