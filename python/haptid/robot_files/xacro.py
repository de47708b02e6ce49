"""xacro: expanded to URDF in a child process, since its expressions and includes are a program."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

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
