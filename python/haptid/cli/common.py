"""Shared by all commands: the application, consoles, one-line errors, progress bars."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer
from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment
from rich.text import Text

from haptid._internal.escaping import printable
from haptid.errors import HaptidError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

EXIT_CRITERIA, EXIT_ERROR, EXIT_DEFECT = 1, 2, 3
# Shell convention for an interrupted program.
EXIT_INTERRUPTED = 130

app = typer.Typer(
    help="Identify dynamic models of haptic devices and robots from their motion logs.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Where the output is not a terminal, lines are as wide as the tables, not 80 characters.
WIDE = None if sys.stdout.isatty() else 140


class _Printable(RenderHook):
    """Printed text comes from users' files: control characters in it are shown, not sent to the terminal."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_PrintableText(one) for one in renderables]


@dataclass(frozen=True)
class _PrintableText:
    content: ConsoleRenderable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for segment in console.render(self.content, options):
            yield segment if segment.control else Segment(printable(segment.text, keep="\n"), segment.style)


# No markup is interpreted either.
out, err = Console(width=WIDE, markup=False), Console(stderr=True, markup=False)
for _console in (out, err):
    _console.push_render_hook(_Printable())


@contextmanager
def errors_shown() -> Iterator[None]:
    """Print haptid's own errors as one line and exit with their status."""
    try:
        yield
    except HaptidError as error:
        complain(str(error))
        raise typer.Exit(EXIT_ERROR) from None


def complain(sentence: str) -> None:
    """Print one line on standard error."""
    err.print(Text.assemble(("error: ", "bold red"), sentence), soft_wrap=True)


def progress_bars(quiet: bool) -> Progress:
    """Progress bars on standard error."""
    from rich import progress  # slow to import, and most commands show no bars

    columns = (progress.TextColumn("{task.description}"), progress.BarColumn(), progress.TaskProgressColumn())
    times = (progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
    return progress.Progress(*columns, *times, console=err, transient=True, disable=quiet)


def progress_callback(bars: Progress) -> Callable[[str, float], None]:
    """A progress callback with one bar for each step; text after a colon is a changing detail."""
    tasks: dict[str, TaskID] = {}

    def progress(what: str, share: float) -> None:
        name = what.partition(": ")[0]
        if name not in tasks:
            tasks[name] = bars.add_task(what, total=1.0)
        bars.update(tasks[name], completed=share, description=what)

    return progress
