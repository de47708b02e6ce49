"""`haptid report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, print_json, print_lines

HELP = """\
Write the report of a result as one HTML file, or compare several results.

RESULT is an output folder of haptid identify. Its report.html is written again from the folder alone; the logs are not
needed. With several RESULTs the page compares each with the first and marks the significant differences.

The file works offline, on a screen, a phone and paper.

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid report before after --out comparison.html`
"""


@command(HELP)
def report(
    results: Annotated[list[Path], typer.Argument(help="output folders of haptid identify", show_default=False)],
    page: Annotated[
        Path | None,
        typer.Option("--out", help="file to write (default: RESULT/report.html, or comparison.html)"),
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import publishing
    from haptid.report import read_report, write_comparison
    from haptid.report.report import PAGE

    with errors_shown():
        if len(results) == 1:
            written, made_of = page or results[0] / PAGE, read_report(results[0])
            if written.resolve() == (results[0] / PAGE).resolve():
                with publishing(results[0], updating=True) as folder:
                    (folder / PAGE).write_text(made_of.html(), encoding="utf-8")
            else:
                made_of.write_page(written)
            pairs: list[dict[str, Any]] = []
        else:
            written = page or Path("comparison.html")
            files = write_comparison(results, written)
            pairs = list(files.pairs)
    if as_json:
        print_json("report", {"page": str(written), "pairs": pairs})
    elif not quiet:
        sentences = (f"{pair['second']}: {line}" for pair in pairs for line in pair["sentences"])
        print_lines(*sentences, f"Report in {written}")
