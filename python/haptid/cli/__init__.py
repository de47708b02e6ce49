"""The command line: the same calls as the Python API. One file a command."""

from __future__ import annotations

import os
import sys
import traceback
from typing import Annotated

import typer

import haptid
from haptid.cli.common import EXIT_DEFECT, app, complain, out

# isort: off
# Each adds its command to the application, in the order in which `haptid --help` lists them.
from haptid.cli import identify, report, compare, characterise, eliminate, friction, export  # noqa: F401
from haptid.cli import model, devices, excite, bench, demo, schema  # noqa: F401
# isort: on


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="print the version")] = False) -> None:
    """Dynamic models of haptic devices and robots, identified from their own motion logs."""
    if show:
        out.print(f"haptid {haptid.__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point of the `haptid` command."""
    # Matrices here are small: threads of the linear algebra wait for each other, spinning, longer than they work. To be
    # said before NumPy is imported; what the user has set stays.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except Exception:
        traceback.print_exc()
        complain("this is a defect of haptid, not of your input. Please report it with the lines above.")
        sys.exit(EXIT_DEFECT)
