"""One identification and its report, made once for all tests of the report."""

from __future__ import annotations

import runpy
import tempfile
from functools import cache
from pathlib import Path

import haptid
from haptid.report import Report, ReportSource, report_of

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "phantom"


@cache
def logs() -> Path:
    """A folder with the example's logs; it stays for the test run."""
    folder = Path(tempfile.mkdtemp(prefix="haptid-reported-"))
    runpy.run_path(str(EXAMPLE / "make_logs.py"))["main"](folder)
    return folder


@cache
def found() -> haptid.Identification:
    return haptid.identify(haptid.read_study(EXAMPLE / "study.toml"), logs())


@cache
def source() -> ReportSource:
    return ReportSource(found(), "haptid identify study.toml")


@cache
def made() -> Report:
    return report_of(source())
