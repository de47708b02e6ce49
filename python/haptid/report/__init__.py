"""Reports: one self-contained HTML page of an identification or of several compared, terminal tables, pictures."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from haptid.report.compared import write_comparison
    from haptid.report.report import Report, make_report, read_report, report_of
    from haptid.report.source import HandForceData, ReportSource
    from haptid.report.terminal import sparklines

# Module of each public name: they are loaded at first use, since a table in the terminal needs no page.
_HOMES = {
    "HandForceData": "source",
    "Report": "report",
    "ReportSource": "source",
    "make_report": "report",
    "read_report": "report",
    "report_of": "report",
    "sparklines": "terminal",
    "write_comparison": "compared",
}
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


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
