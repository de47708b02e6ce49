"""What every command needs: the application, two consoles, errors in one line, progress bars."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.text import Text

from haptid.errors import HaptidError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

EXIT_CRITERIA, EXIT_ERROR, EXIT_DEFECT = 1, 2, 3
# As shells have it for a program that was interrupted.
EXIT_INTERRUPTED = 130

app = typer.Typer(
    help="Dynamic models of haptic devices and robots, identified from their own motion logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Where the output is no terminal, lines are as long as the tables need, not cut at 80.
WIDE = None if sys.stdout.isatty() else 140
# What is printed comes from users' files: no markup is read in it.
out, err = Console(width=WIDE, markup=False), Console(stderr=True, markup=False)


@contextmanager
def errors_shown() -> Iterator[None]:
    """haptid's own errors as one line, and the exit status for them."""
    try:
        yield
    except HaptidError as error:
        complain(str(error))
        raise typer.Exit(EXIT_ERROR) from None


def complain(sentence: str) -> None:
    """One line on standard error."""
    err.print(Text.assemble(("error: ", "bold red"), sentence), soft_wrap=True)


def progress_bars(quiet: bool) -> Progress:
    """Bars on standard error; imported here, as most commands show none."""
    from rich import progress

    columns = (progress.TextColumn("{task.description}"), progress.BarColumn(), progress.TaskProgressColumn())
    times = (progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
    return progress.Progress(*columns, *times, console=err, transient=True, disable=quiet)


def teller(progress: Progress) -> Callable[[str, float], None]:
    """A bar for each thing that is being done; what follows a colon says how it goes, and changes."""
    tasks: dict[str, TaskID] = {}

    def tell(what: str, share: float) -> None:
        name = what.partition(": ")[0]
        if name not in tasks:
            tasks[name] = progress.add_task(what, total=1.0)
        progress.update(tasks[name], completed=share, description=what)

    return tell
