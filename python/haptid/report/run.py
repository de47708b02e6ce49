"""`write_identification`: carry out a study and write its result folder; the command line and the workbench call it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

from haptid._internal.atomic_folder import check_writable, publishing
from haptid.executors import Executor
from haptid.observation.cache import RFactorCache
from haptid.report.source import ReportSource
from haptid.report.torque_picture import draw_torque
from haptid.results.result import Result
from haptid.study import Study
from haptid.study.identify import Run, identify

# Logs whose torque is drawn into a file of its own, at most; the report shows all of them.
_MOST_PICTURES = 12


def write_identification(
    study: Study,
    data: Path | None,
    out: Path,
    *,
    command: str,
    progress: Callable[[str, float], None],
    workers: Executor,
    cache: RFactorCache,
    report: bool = True,
) -> tuple[Result, ReportSource]:
    """Carry out a study, and write result, report and pictures into a folder, all or none.

    Args:
        study: to carry out.
        data: folder of its relative log paths; that of the study where None.
        out: folder for the results.
        command: the command line, for the report.
        progress: called with the name of a step and the share of it done.
        workers: that reduce the logs.
        cache: of an interrupted run, forgotten at the end.
        report: False: only the numbers, in half of the time; the result has no verdict and no advice.

    Raises:
        OutputFolderError: the folder cannot be written.
    """
    check_writable(out)
    with publishing(out) as folder:
        identification = identify(study, data, progress, workers, cache)
        source = ReportSource(identification, command)
        if report:
            result = _write_with_report(source, folder, progress)
        else:
            result = Result.of(identification)
            result.write_into(folder)
    cache.forget()
    return result, source


def _write_with_report(source: ReportSource, folder: Path, progress: Callable[[str, float], None]) -> Result:
    """Result with verdict and advice, report and pictures."""
    from haptid.report.report import report_of  # slow to import, and numbers alone need no page

    identification = source.identification
    progress("writing the report", 0.0)
    result = Result.of(identification, source.verdict, source.advice)
    result.write_into(folder)
    report_of(source).write_into(folder)
    progress("writing the report", 1.0)
    for k, run in _pictured(identification.runs):
        name = f"{'-'.join(filter(None, (f'torque-{k + 1}', _file_stem(run.entry.path))))}.svg"
        progress(f"drawing {name}", 0.0)
        kind = "rows of the fit" if run.fit_errors else "unseen"
        title = f"{identification.study.name}: {run.entry.path} ({kind})"
        track = source.tracks[k]
        draw_torque([track.prediction], track.rows, title, folder / name)
        progress(f"drawing {name}", 1.0)
    return result


def _file_stem(log: str) -> str:
    """The name of a log's file without its suffix, nor a `*` and a separator beside it: `run1` of `run1_*.csv`."""
    return re.sub(r"^\*[-_. ]?|[-_. ]?\*", "", Path(log).stem)


def _pictured(runs: Sequence[Run]) -> list[tuple[int, Run]]:
    """Runs, with their places, whose torque is drawn into a file: of many, those that are predicted worst."""
    worst = sorted(range(len(runs)), key=lambda k: -_error(runs[k]))[:_MOST_PICTURES]
    return [(k, runs[k]) for k in sorted(worst)]


def _error(run: Run) -> float:
    """Error on unseen rows, per cent, or where none were held out on those of the fit."""
    found = run.unseen or ((run.fit_errors,) if run.fit_errors else ())
    return max((one.comparable.relative for one in found), default=0.0)
