"""xacro: expanded to URDF in a child process, since its expressions and includes are a program."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from haptid.robot_files.limited import run_limited
from haptid.robot_files.paths import Roots


def expand_xacro(path: Path, roots: Roots, arguments: Mapping[str, str]) -> bytes:
    """The URDF that a xacro file expands to.

    Args:
        path: of the file.
        roots: folders that it may read from; `$(find NAME)` is a package's.
        arguments: values of its `<xacro:arg>`.

    Raises:
        MissingDependencyError: xacro is not installed.
        RobotFileError: it is wrong, reads other files, or takes too long.
    """
    packages = {name: str(folder) for name, folder in roots.packages.items()}
    request = {"path": str(path.resolve()), "packages": packages, "arguments": dict(arguments)}
    return str(run_limited("xacro", request, roots.allowed, roots.file, "robots")["text"]).encode()


def prepare_child() -> None:
    """Import what opens Python's own files, before the child is guarded."""
    import encodings.idna  # noqa: F401
    import xml.dom.minidom  # noqa: F401

    import xacro  # noqa: F401
    import yaml  # noqa: F401


def run_child(request: dict[str, Any]) -> dict[str, Any]:
    """Expand a file, in the child."""
    import os

    import xacro
    from xacro import substitution_args

    packages = request["packages"]

    def find(name: str, *_: object) -> str:
        if name not in packages:
            raise ValueError(f"package {name!r} is not known: state --package {name}=FOLDER")
        return str(packages[name])

    def no_environment(name: str, *_: object) -> str:
        raise ValueError(f"$(env {name}) and $(optenv {name}) are not read")

    substitution_args._eval_find = find
    substitution_args._eval_env = substitution_args._eval_optenv = no_environment
    os.environ.clear()
    document = xacro.process_file(request["path"], mappings=request["arguments"])
    return {"text": document.toprettyxml(indent=" ")}
