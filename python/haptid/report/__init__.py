"""The report: one HTML file with everything there is to say of an identification, or of several side by side."""

from haptid.report.compared import write_comparison
from haptid.report.report import Report, make_report, read_report, report_of
from haptid.report.source import Hand, Source
from haptid.report.terminal import sparklines

__all__ = ["Hand", "Report", "Source", "make_report", "read_report", "report_of", "sparklines", "write_comparison"]
