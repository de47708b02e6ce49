"""read_robot: a robot description of any format as a neutral tree."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from haptid.robot_files.dh_table import read_dh_table
from haptid.robot_files.mjcf import read_mjcf
from haptid.robot_files.paths import Roots
from haptid.robot_files.sdf import read_sdf
from haptid.robot_files.symoro import read_symoro
from haptid.robot_files.tree import RobotTree
from haptid.robot_files.urdf import read_urdf
from haptid.robot_files.usd import read_usd
from haptid.robot_files.xacro import expand_xacro
from haptid.robot_files.xml import parse, read_bytes, refused

_FORMATS = "URDF, xacro, MJCF, SDF, USD, SYMORO (.par) or a table of Denavit-Hartenberg parameters (.csv)"
# What xacro expands; its name space alone stands in many URDFs that it has written.
_COMMENT = re.compile(rb"<!--.*?(?:-->|\Z)", re.DOTALL)
_XACRO = re.compile(rb"<xacro:|\$\{|\$\(")


def read_robot(
    path: str | Path,
    *,
    packages: Mapping[str, str | Path] | None = None,
    xacro_arguments: Mapping[str, str] | None = None,
    lengths: Mapping[str, float] | None = None,
    snap: float = 0.0,
) -> RobotTree:
    """Read a robot description; the format is detected from its content.

    Args:
        path: of the file.
        packages: folders that it may read from besides its own, by name of the package.
        xacro_arguments: values of a xacro file's arguments.
        lengths: values of lengths that a SYMORO file or a table names, m.
        snap: angles nearer than this to a quarter turn are made one, rad.

    Raises:
        RobotFileError: file and line, what was found and what to do.
        MissingDependencyError: the format needs an optional package.
    """
    path = Path(path)
    roots = Roots.of(path, packages or {})
    content = read_bytes(path)
    suffix = path.suffix.lower()
    if not content.strip():
        raise refused(
            str(path), "it is empty", "Run `xacro` again if it was to write it, or import the xacro file itself."
        )
    if content.startswith(b"version https://git-lfs"):
        raise refused(str(path), "it is a pointer of Git LFS, not the file", "Run `git lfs pull` in its repository.")
    if suffix == ".par":
        return read_symoro(content, str(path), lengths or {}, snap)
    if suffix == ".csv":
        return read_dh_table(content, str(path), lengths or {}, snap)
    if suffix in (".usd", ".usda", ".usdc", ".usdz"):
        return read_usd(path, roots, snap)
    if b"<" not in content[:4096]:
        raise refused(str(path), "it is no robot description", f"Give {_FORMATS}.")
    root = parse(content, str(path))
    if root.tag == "mujoco":
        return read_mjcf(path, roots, snap)
    if root.tag == "sdf":
        return read_sdf(root, roots, snap)
    if root.tag == "robot" and is_xacro(path, content):
        expanded = expand_xacro(path, roots, xacro_arguments or {})
        if b"<link" not in expanded:
            raise refused(str(path), "it expands to no <link>", "Give the file of the robot, which calls these macros.")
        return read_urdf(expanded, f"{path}, expanded", snap)
    if root.tag == "robot":
        return read_urdf(content, str(path), snap)
    raise refused(str(path), f"its root is <{root.tag[:60]}>", f"Give {_FORMATS}.", root.line)


def is_xacro(path: Path, content: bytes) -> bool:
    """Whether a URDF is to be expanded before it is one."""
    return path.suffix.lower() == ".xacro" or bool(_XACRO.search(_COMMENT.sub(b"", content)))
