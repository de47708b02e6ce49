"""`haptid check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import (
    EXIT_ERROR,
    AsJson,
    DataFolder,
    Quiet,
    StudyFile,
    command,
    errors_shown,
    print_json,
    print_lines,
    progress_bars,
    progress_callback,
)

HELP = """\
Read everything that a study names, fit nothing, and say what is wrong and what would be done.

The STUDY, its device and all its logs are read and checked; a problem of one log does not hide those of the others.
With --plan, each log is compared with the motion that was to be recorded: its time scale, missing parts, the tracking
error, clipped torque. The treatment is chosen with its reasons, and the steps that `haptid identify` would take are
listed.

Exit status: 0 if nothing is wrong, 2 if something has to be changed first; the message says what to do.

Example: `haptid check examples/emps/study.toml --data ../shared/data/emps`
"""


@command(HELP)
def check(
    study: StudyFile,
    data: DataFolder = None,
    plans: Annotated[
        list[Path] | None, typer.Option("--plan", help="CSV of `haptid excite`, one for each log in their order")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.study.check import check_study

    with errors_shown(), progress_bars(quiet or as_json) as bars:
        checked = check_study(study, data, progress_callback(bars), plans or ())
    if as_json:
        print_json("check", checked.to_json())
    elif not quiet:
        print_lines(*checked.summary().splitlines())
    if checked.problems:
        raise typer.Exit(EXIT_ERROR)
