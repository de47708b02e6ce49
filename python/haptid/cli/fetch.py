"""`haptid fetch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json, progress_bars, progress_callback

HELP = """\
Download a public recording of a real machine, and check it.

Without a NAME, the known recordings are listed with their licences. The files come from the pages of their authors,
at a fixed revision, and are written once each has the published SHA-256. This is the only command that uses the
network.

Exit status: 0 on success, 2 if a file cannot be downloaded or is not the published one.

Example: `haptid fetch emps --out recordings/emps`
"""


def _names(incomplete: str) -> list[str]:
    from haptid.demos.public_recordings import public_recordings

    return [recording.name for recording in public_recordings() if recording.name.startswith(incomplete)]


@command(HELP)
def fetch(
    name: Annotated[
        str | None, typer.Argument(help="of the recording", show_default=False, autocompletion=_names)
    ] = None,
    folder: Annotated[Path | None, typer.Option("--out", help="folder (default: recordings/NAME)")] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid.demos.public_recordings import fetch_recording, public_recording, public_recordings

    with errors_shown():
        chosen = public_recordings() if name is None else (public_recording(name),)
    if not quiet and not as_json:
        for recording in chosen:
            out.print(f"{recording.name}: {recording.what}", soft_wrap=True)
            out.print(f"  source: {recording.cite}; {recording.page}", soft_wrap=True)
            out.print(f"  licence: {recording.licence}", soft_wrap=True)
    written: list[Path] = []
    if name is not None:
        with errors_shown(), progress_bars(quiet or as_json) as bars:
            written += fetch_recording(chosen[0], folder or Path("recordings", name), progress_callback(bars))
    if as_json:
        print_json(
            "fetch",
            {
                "recordings": [recording.model_dump(by_alias=True) for recording in chosen],
                "files": [str(path) for path in written],
            },
        )
    elif not quiet:
        for path in written:
            out.print(f"{path}", soft_wrap=True)
