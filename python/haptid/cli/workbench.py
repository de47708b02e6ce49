"""`haptid app`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from haptid.cli.common import AsJson, Quiet, command, errors_shown, out, print_json

HELP = """\
Open the workbench on a folder in the browser: device, logs, check, identification, results, exports.

FOLDER has `devices/`, `studies/`, `experiments/` (TOML), `logs/` and `results/`, the files of the other commands; what
is missing is made when it is needed. The server listens on 127.0.0.1 only, and answers the printed address only, which
has a token of this start. Ctrl-C ends it.

Exit status: 0 at the end, 2 if it cannot start; the message says what to do.

Example: `haptid app my-robot`
"""


@command(HELP, name="app")
def workbench(
    folder: Annotated[Path, typer.Argument(help="folder of devices, studies, logs and results")] = Path(),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="0: any that is free")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="print the address, open nothing")] = False,
    reindex: Annotated[bool, typer.Option("--reindex", help="make the index again from the files")] = False,
    largest: Annotated[
        int, typer.Option("--largest-log", min=1, help="of a log that is dropped on a page, MiB")
    ] = 2048,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.extras import needing

    with errors_shown():
        with needing("the workbench"):
            from haptid.app.server import serve

        def ready(address: str) -> None:
            if as_json:
                print_json("app", {"folder": str(folder.resolve()), "address": address})
                sys.stdout.flush()
            elif not quiet or no_browser:
                out.print(f"Workbench of {folder.resolve()}: {address}", soft_wrap=True, highlight=False)
                sys.stdout.flush()
            if not no_browser:
                import threading
                import webbrowser

                threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

        serve(folder, port, ready, reindex=reindex, largest_log=largest * 2**20)
