"""`haptid fleet`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import AsJson, DataFolder, Quiet, StudyFile, command, compute_into

if TYPE_CHECKING:
    from haptid.study.fleet import Fleet, FleetEstimate

HELP = """\
Identify every log of a fleet by itself, and tell which devices drift and which differ from the others.

Each folder in LOGS is a device, and every file in it a log, which has the channels of the STUDY's first log. Device
file, method and treatment are the study's; what it leaves open of the treatment is proposed from its own logs once, so
that estimates differ by the devices and not by filters. Days are dates in the names of the files (2026-03-02,
20260302T1400), or, where one has none, times of modification. A log that cannot be identified is listed with its error.
Writes into OUT:

- `logs.csv`: every log: status, error of the fit, parameters with standard errors
- `devices.csv`: every device and parameter: mean, spread between logs, drift in a day, distance from the other devices
- `fleet.json`: the same figures

Means and drift are random-effects regressions over the logs of a device: they allow for what changes from day to day.

Results of single logs are kept in .OUT.partial next to OUT until all are there: the same command after an interruption
computes the others, and those whose file, study or device has changed.

Exit status: 0 on success, 2 on an error in the study or its own logs; the message says what to do.

Example: `haptid fleet study.toml arms --workers 8 --out fleet`
"""


@command(HELP)
def fleet(
    study: StudyFile,
    logs: Annotated[Path, typer.Argument(help="folder with a folder of logs for each device", show_default=False)],
    data: DataFolder = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-fleet"),
    count: Annotated[int, typer.Option("--workers", min=1, help="processes that identify logs")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler whose workers identify logs, tcp://host:8786")
    ] = None,
    no_resume: Annotated[
        bool, typer.Option("--no-resume", help="start again, not from an interrupted run's results")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.escaping import write_csv
    from haptid.cli.outputs import output_text
    from haptid.cli.work import interruptible, resumed, workers
    from haptid.study import read_study
    from haptid.study.fleet import identify_fleet
    from haptid.study.fleet_results import FleetResults

    kept = resumed(FleetResults.beside(out_folder), no_resume, quiet or as_json)

    def compute(folder: Path, progress: Callable[[str, float], None]) -> tuple[str, str]:
        found = identify_fleet(read_study(study), logs, data, progress, workers(count, scheduler), kept)
        text = output_text("fleet", values(found))
        (folder / "fleet.json").write_text(text, encoding="utf-8")
        write_csv(folder / "logs.csv", found.log_table())
        write_csv(folder / "devices.csv", found.device_table())
        return text, found.summary()

    with interruptible(kept):
        compute_into(out_folder, quiet, as_json, compute)
    kept.forget()


def values(found: Fleet) -> dict[str, Any]:
    """All figures as JSON values."""
    from haptid.results.tables import treatment

    return {
        "study": found.name,
        "dates": found.dates,
        "treatment": treatment(found.treatment),
        "confidence": found.confidence,
        "logs": [_log(one) for one in found.entries],
        "devices": [
            {
                "device": trend.device,
                "logs": trend.logs,
                "parameters": [_parameter(found, d, k) for k in range(len(found.names))],
            }
            for d, trend in enumerate(found.trends)
        ],
        "sentences": list(found.sentences),
    }


def _log(one: FleetEstimate) -> dict[str, Any]:
    columns = (one.names, one.units, one.values.tolist(), one.se.tolist(), one.dof.tolist(), one.conf_int().tolist())
    keys = ("name", "unit", "value", "se", "dof", "conf_int")
    return {
        "device": one.log.device,
        "log": one.log.path.name,
        "day": one.log.day,
        "status": one.status,
        "error_percent": one.error_percent,
        "problem": one.error,
        "parameters": [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)],
    }


def _parameter(found: Fleet, d: int, k: int) -> dict[str, Any]:
    trend = found.trends[d]
    mean, slope = trend.mean[k], trend.slope[k]
    return {
        "name": found.names[k],
        "unit": found.units[k],
        "mean": float(mean.values[0]),
        "se": float(mean.se[0]),
        "between_logs": mean.between,
        "slope": float(slope.values[-1]),
        "slope_se": float(slope.se[-1]),
        "p_holm": float(found.drift_p[d, k]),
        "distance": float(found.distance[d, k]),
    }
