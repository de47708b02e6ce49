"""`haptid compare`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, command, errors_shown, print_json, print_lines

if TYPE_CHECKING:
    from haptid.inference.comparison import Series
    from haptid.inference.drift import Drift
    from haptid.inference.joint_tests import JointTests

HELP = """\
Compare results: parameters that differ significantly, and their drift.

Each RESULT is an output folder of haptid identify; the logs are not needed. The results must not share rows.
The table gives for each parameter the confidence level of a difference, corrected for multiple testing (Holm), and the
smallest change that is found with 80 % power. Joint tests of a payload on each link, the torque at rest and the
friction of each motor find changes that no single parameter shows. With --times, also the drift of each parameter per
day, by weighted least squares.

`haptid report RESULT RESULT ...` writes a page with plots of the same results.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid compare monday tuesday friday --times 2026-03-02,2026-03-03,2026-03-06`
"""
SECONDS_IN_DAY = 86400.0


@command(HELP)
def compare(
    results: Annotated[list[Path], typer.Argument(help="output folders of haptid identify", show_default=False)],
    times: Annotated[
        str | None, typer.Option("--times", help="comma-separated dates (ISO 8601) or numbers, one for each result")
    ] = None,
    unit: Annotated[str, typer.Option("--unit", help="unit of these numbers: day, hour, kelvin, ..")] = "day",
    confidence: Annotated[float, typer.Option("--confidence", help="joint confidence level for all parameters")] = 0.95,
    as_json: AsJson = False,
) -> None:
    from haptid.inference.comparison import compare as compared
    from haptid.inference.drift import drift
    from haptid.report.compared import names_of
    from haptid.results.result import Result

    with errors_shown():
        when = None if times is None else [_time(part) for part in times.split(",")]
        series = compared(*map(Result.load, results), labels=names_of(results), confidence=confidence)
        lines = None if when is None else drift(series, when, unit)
    if as_json:
        print_json("compare", values(series, lines))
        return
    for text_lines in (series, lines):
        if text_lines is not None:
            print_lines(text_lines.summary())


def _time(text: str) -> float:
    """A number, or a date as days since 1970; a date without a time zone is taken as UTC.

    Raises:
        OptionError: it is neither.
    """
    from haptid.cli.options import wrong_option

    try:
        return float(text)
    except ValueError:
        pass
    try:
        date = datetime.fromisoformat(text.strip())
    except ValueError:
        wanted = "numbers such as 0,7,14 or dates such as 2026-03-02,2026-03-09T14:00"
        raise wrong_option("--times", text, wanted) from None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp() / SECONDS_IN_DAY


def values(series: Series, lines: Drift | None) -> dict[str, Any]:
    """Both as JSON values."""
    tables: dict[str, Any] = {
        "results": list(series.labels),
        "confidence": series.confidence,
        "parameters": [_parameter(series, k) for k in range(len(series.names))],
        "joint": None if series.joint is None else _joint(series.joint),
        "notes": list(series.notes),
    }
    if lines is not None:
        tables["drift"] = {
            "unit": lines.unit,
            "times": lines.times.tolist(),
            "parameters": [_slope(lines, k) for k in range(len(lines.names))],
        }
    return tables


def _parameter(series: Series, k: int) -> dict[str, Any]:
    return {
        "name": series.names[k],
        "unit": series.units[k],
        "value": series.value[:, k].tolist(),
        "se": series.se[:, k].tolist(),
        "dof": series.dof[:, k].tolist(),
        "common": float(series.common[k]),
        "p": float(series.p[k]),
        "p_holm": float(series.holm[k]),
        "differs": series.names[k] in series.differs,
        "detectable": float(series.detectable[k]),
    }


def _joint(joint: JointTests) -> dict[str, Any]:
    tests = [
        {
            "name": test.name,
            "directions": test.directions,
            "f": test.F,
            "dof": list(test.dof),
            "p": test.p,
            "p_holm": float(p),
            "differs": test.name in joint.differs,
            "distance": test.distance,
            "detectable": test.detectable,
        }
        for test, p in zip(joint.tests, joint.holm, strict=True)
    ]
    return {"tests": tests, "equality_p": joint.equality, "notes": list(joint.notes)}


def _slope(lines: Drift, k: int) -> dict[str, Any]:
    name = lines.names[k]
    return {
        "name": name,
        "slope": float(lines.slope[k]),
        "se": float(lines.se[k]),
        "dof": float(lines.dof[k]),
        "conf_int": lines.conf_int()[k].tolist(),
        "p": float(lines.p[k]),
        "p_holm": float(lines.holm[k]),
        "drifts": name in lines.drifts,
        "bent": name in lines.bent,
    }
