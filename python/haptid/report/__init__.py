"""The report: one HTML file with everything there is to say of an identification, or of several side by side."""

from haptid.report.compared import write_comparison
from haptid.report.report import Report, read_report, report
from haptid.report.source import Hand

__all__ = ["Hand", "Report", "read_report", "report", "write_comparison"]
