"""Reports: one self-contained HTML page of an identification or of several compared, terminal tables, plots."""

from haptid.report.compared import write_comparison
from haptid.report.report import Report, make_report, read_report, report_of
from haptid.report.source import HandForceData, ReportSource
from haptid.report.terminal import sparklines

__all__ = [
    "HandForceData",
    "Report",
    "ReportSource",
    "make_report",
    "read_report",
    "report_of",
    "sparklines",
    "write_comparison",
]
