"""Command line: the calls of the Python API, one module for each command."""

from __future__ import annotations

import os
import sys
import traceback
from typing import Annotated

import typer

import haptid
from haptid.cli.common import EXIT_DEFECT, app, complain, out

# isort: off
# Each module registers its command, in the order of `haptid --help`.
from haptid.cli import identify, advise, report, compare, characterise, eliminate, friction, payload, poses, export  # noqa: F401
from haptid.cli import channels, import_, model, devices, excite, bench, demo, schema  # noqa: F401
# isort: on


@app.callback(invoke_without_command=True)
def version(show: Annotated[bool, typer.Option("--version", help="print the version")] = False) -> None:
    """Identify dynamic models of haptic devices and robots from their motion logs."""
    if show:
        out.print(f"haptid {haptid.__version__}")
        raise typer.Exit


def main() -> None:
    """Entry point of the `haptid` command."""
    # The matrices are small: BLAS threads would spin longer than they work. Must be set before NumPy is imported; a
    # value set by the user takes precedence.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except Exception:
        traceback.print_exc()
        complain("this is a defect of haptid, not of your input. Please report it with the traceback above.")
        sys.exit(EXIT_DEFECT)
