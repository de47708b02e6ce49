"""Shared by all commands: the application, consoles, one-line errors, progress bars."""

from __future__ import annotations

import errno
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderHook, RenderResult
from rich.segment import Segment
from rich.text import Text

from haptid._internal.escaping import printable
from haptid._internal.late import dataclass
from haptid.errors import HaptidError

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

# Set by the completion scripts, which then call the program for its suggestions.
COMPLETION_VARIABLE = "_HAPTID_COMPLETE"
_Command = TypeVar("_Command", bound=Callable[..., None])
EXIT_CRITERIA, EXIT_ERROR, EXIT_DEFECT = 1, 2, 3
# Shell convention for an interrupted program.
EXIT_INTERRUPTED = 130

app = typer.Typer(
    help="Identify dynamic models of haptic devices and robots from their motion logs.",
    no_args_is_help=True,
    # `haptid completion` prints the scripts; nothing writes into a user's shell configuration.
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
)
# Options that every command has in one form.
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="no progress, no tables")]
AsJson = Annotated[bool, typer.Option("--json", help="print the results as JSON")]
StudyFile = Annotated[Path, typer.Argument(help="the study file (TOML)", show_default=False)]
DataFolder = Annotated[
    Path | None, typer.Option("--data", help="folder of the study's relative log paths (default: the study's folder)")
]
DeviceName = Annotated[
    str,
    typer.Argument(
        help="a device file (TOML) or the name of a shipped device",
        show_default=False,
        autocompletion=lambda incomplete: [name for name in _shipped() if name.startswith(incomplete)],
    ),
]
# Where the output is not a terminal, lines are as wide as the tables, not 80 characters.
WIDE = None if sys.stdout.isatty() else 140


class _Printable(RenderHook):
    """Printed text comes from users' files: control characters in it are shown, not sent to the terminal."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_PrintableText(renderable) for renderable in renderables]


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


# Errors of the machine at any moment: disk full, quota, input or output, too many open files, memory.
MACHINE = frozenset(
    getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EIO", "EMFILE", "ENFILE", "ENOMEM") if hasattr(errno, name)
)


def _shipped() -> tuple[str, ...]:
    from haptid.device import shipped_devices

    return shipped_devices()


def unwrapped(text: str) -> str:
    """Markdown without line ends inside its paragraphs and list items: a terminal breaks the lines where it ends."""
    return re.sub(" +", " ", re.sub(r"(?<!\n)\n(?!\n|- )", " ", text.strip()))


def command(text: str, name: str | None = None) -> Callable[[_Command], _Command]:
    """Register a function as a command with a help text in Markdown."""
    return app.command(name, help=unwrapped(text))


def print_json(command: str, values: Mapping[str, Any] | Sequence[Any]) -> None:
    """Print values as the JSON of a command, null where a number is not finite."""
    from haptid.cli.outputs import output_text

    sys.stdout.write(output_text(command, values))


@contextmanager
def errors_shown() -> Iterator[None]:
    """Print haptid's own errors, and those of a full disk or a failing one, as one line and exit with their status."""
    try:
        yield
    except HaptidError as error:
        complain(str(error))
        raise typer.Exit(EXIT_ERROR) from None
    except OSError as error:
        if error.errno not in MACHINE:
            raise
        file = "" if error.filename is None else f"{error.filename}: "
        complain(f"{file}{error.strerror}. Make room (disk, open files, memory), and run the command again.")
        raise typer.Exit(EXIT_ERROR) from None


def compute_into(
    out_folder: Path,
    quiet: bool,
    as_json: bool,
    compute: Callable[[Path, Callable[[str, float], None]], tuple[str, str]],
) -> None:
    """Compute figures, publish their files in a folder, and print them as JSON, as a summary or not at all.

    Args:
        out_folder: where the files are published, all or none.
        compute: writes the files into a folder, reports progress, and returns the figures as JSON and as a summary.
    """
    from haptid._internal.atomic_folder import check_writable, publishing

    with errors_shown():
        check_writable(out_folder)
        with progress_bars(quiet or as_json) as bars, publishing(out_folder) as folder:
            text, summary = compute(folder, progress_callback(bars))
    if as_json:
        sys.stdout.write(text)
    elif not quiet:
        print_lines(*summary.splitlines(), "", f"Figures in {out_folder}")


def print_lines(*lines: str) -> None:
    """Print lines as they are: neither highlighted nor broken."""
    for line in lines:
        out.print(line, highlight=False, soft_wrap=True)


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
