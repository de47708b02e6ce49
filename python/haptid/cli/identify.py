"""`haptid identify`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from haptid.cli.common import (
    EXIT_CRITERIA,
    AsJson,
    DataFolder,
    Quiet,
    StudyFile,
    command,
    errors_shown,
    out,
    progress_bars,
    progress_callback,
)

if TYPE_CHECKING:
    from haptid.report.source import ReportSource

HELP = """\
Identify a device from the logs of a study, and validate the model.

The STUDY (a TOML file) defines the device, the logs and their roles, their channels and units, the treatment, and the
estimator. Writes into OUT:

- `result.json`: all results: parameters with 95 % intervals, regroupings, errors, condition numbers, notes
- `report.html`: self-contained report: verdict, parameters, plots, the device in 3D, provenance
- `parameters.csv`: the table of parameters
- `correlation.csv`: correlation of their errors
- `clusters.npz`: scores of the time blocks, for joint tests of `haptid compare`
- `torque-*.svg`: measured and predicted torque, one plot for each log
- `haptid-files.json`: SHA-256 of these files: a reader refuses one of another run

Changes of study and device (terms, signs, gains, delays, lengths, ...) are tried on the same data; those with a proof
are listed by their gain. Nothing is changed; `haptid advise` writes files with the best of them.

Long logs are read in chunks. Intermediate results are stored in .OUT.partial next to OUT until the run is complete: an
interrupted run resumes from there, if study, logs and device are unchanged.

Exit status: 0 on success (and the study's criteria, if any, are met), 1 if the criteria are not met, 2 on an error in
the study, the device or a log; the message says what to do. 3 is a defect of haptid, 130 an interruption by Ctrl-C.

Example: `haptid identify examples/emps/study.toml --data ../shared/data/emps --out emps-result`
"""


@command(HELP)
def identify(
    study: StudyFile,
    data: DataFolder = None,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-result"),
    quiet: Quiet = False,
    as_json: AsJson = False,
    count: Annotated[int, typer.Option("--workers", min=1, help="processes that reduce the logs")] = 1,
    scheduler: Annotated[
        str | None, typer.Option(help="address of a Dask scheduler whose workers reduce the logs, tcp://host:8786")
    ] = None,
    no_resume: Annotated[
        bool, typer.Option("--no-resume", help="start again, not from an interrupted run's intermediate results")
    ] = False,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="only the numbers: no diagnosis, advice, report or pictures")
    ] = False,
) -> None:

    from haptid.cli.work import interruptible, resumed, workers
    from haptid.observation.cache import RFactorCache
    from haptid.report import tables
    from haptid.report.run import write_identification
    from haptid.study import read_study

    with errors_shown():
        plan = read_study(study)
        cache = resumed(RFactorCache.beside(out_folder), no_resume, quiet or as_json)
        with interruptible(cache), progress_bars(quiet or as_json) as bars:
            result, source = write_identification(
                plan,
                data,
                out_folder,
                command=_typed(study, data, out_folder),
                progress=progress_callback(bars),
                workers=workers(count, scheduler),
                cache=cache,
                report=not no_report,
            )
            identification = source.identification
    if as_json:
        sys.stdout.write(result.to_json())
    elif not quiet:
        tables.show_identification(out, identification)
        if no_report:
            out.print(f"Results in {out_folder}, without diagnosis, advice and report", highlight=False)
        else:
            _show_report(source, out_folder)
    if identification.meets_criteria is False:
        raise typer.Exit(EXIT_CRITERIA)


def _show_report(source: ReportSource, out_folder: Path) -> None:
    """Errors over time, verdict and advice, and where the report is."""
    from haptid.report import sparklines

    for line in ("", *sparklines(source), "", *source.verdict.sentences, *source.advice.sentences, ""):
        out.print(line, highlight=False)
    out.print(f"Results in {out_folder}; read {out_folder / 'report.html'} first")


def _typed(study: Path, data: Path | None, out_folder: Path) -> str:
    """The command line, for the report."""
    options = ["--data", _named(data)] if data else []
    return shlex.join(["haptid", "identify", _named(study), *options, "--out", _named(out_folder)])


def _named(path: Path) -> str:
    """A path as it may be shown to others: relative where it is below this folder, else its last part."""
    if not path.is_absolute():
        return str(path)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else path.name
