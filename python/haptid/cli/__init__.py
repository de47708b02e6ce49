"""Command line: the calls of the Python API, one module for each command."""

from __future__ import annotations

import os
import sys
import traceback
from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import typer

import haptid
from haptid.cli import common
from haptid.cli.common import COMPLETION_VARIABLE, EXIT_DEFECT, EXIT_ERROR, complain, out
from haptid.errors import MissingDependencyError

if TYPE_CHECKING:
    from haptid.cli.common import app as app

# Commands in the order of `haptid --help`. Each is registered by the module of its name, but for a few.
_COMMANDS = """
check identify advise report compare characterise datasheet redesign eliminate fleet pool friction response payload
poses export channels import model devices excite bench app demo fetch schema completion
"""
_MODULES = {"import": "import_", "app": "workbench"}


def _register(called: str | None = None) -> typer.Typer:
    """The application with all commands, or with one alone where it is called: the others take as long to load."""
    every = _COMMANDS.split()
    for name in [called] if called in every else every:
        import_module(f"{__name__}.{_MODULES.get(name, name)}")
    return common.app


def __getattr__(name: str) -> object:
    """`app`, with all commands, at its first use (PEP 562)."""
    if name == "app":
        return _register()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


@common.app.callback(invoke_without_command=True)
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
    is_completion = COMPLETION_VARIABLE in os.environ
    if is_completion:
        from typer.completion import completion_init  # type: ignore[attr-defined]

        completion_init()
    try:
        _register(None if is_completion else next(iter(sys.argv[1:]), None))(prog_name="haptid")
    except MissingDependencyError as error:  # of an import, before a command does anything
        complain(str(error))
        sys.exit(EXIT_ERROR)
    except Exception:
        traceback.print_exc()
        complain("this is a defect of haptid, not of your input. Please report it with the traceback above.")
        sys.exit(EXIT_DEFECT)
