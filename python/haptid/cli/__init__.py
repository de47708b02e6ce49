"""Command line: the calls of the Python API, one module for each command."""

from __future__ import annotations

import gc
import os
import sys
import traceback
from typing import Annotated

import typer

import haptid
from haptid.cli.common import COMPLETION_VARIABLE, EXIT_DEFECT, EXIT_ERROR, app, complain, out
from haptid.errors import MissingDependencyError

# isort: off
# Each module registers its command, in the order of `haptid --help`.
from haptid.cli import check, identify, advise, report, compare, characterise, datasheet, redesign, eliminate, fleet  # noqa: F401
from haptid.cli import friction, response, payload, poses, export, channels, import_, model, devices, excite, bench  # noqa: F401
from haptid.cli import workbench, demo, fetch, schema, completion  # noqa: F401
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
    # Pydantic would look for plugins of its own in the metadata of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # The garbage collector would go through what is imported again and again, a tenth of a command's time.
    gc.set_threshold(300_000, 50, 50)
    if COMPLETION_VARIABLE in os.environ:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()
    try:
        app(prog_name="haptid")
    except MissingDependencyError as error:  # of an import, before a command does anything
        complain(str(error))
        sys.exit(EXIT_ERROR)
    except Exception:
        traceback.print_exc()
        complain("this is a defect of haptid, not of your input. Please report it with the traceback above.")
        sys.exit(EXIT_DEFECT)
