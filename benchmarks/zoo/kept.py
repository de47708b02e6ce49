"""Figures that are kept on disk from run to run, under the case and the code that makes them."""

from __future__ import annotations

import ast
import hashlib
import json
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from zoo.case import Case

HERE = Path(__file__).parent
# Not in git.
CACHE = HERE / ".cache"


def kept(
    what: str, case: Case, sources: tuple[str, ...], make: Callable[[], dict[str, Any]], fresh: bool = False
) -> dict[str, Any]:
    """A figure of a case.

    Args:
        what: the figure is.
        case: that it is of.
        sources: files of this folder that make it; it is made again where their code has changed.
        make: makes it.
        fresh: whether it is made again in any case.
    """
    digest = hashlib.sha256(repr(case).encode())
    for source in sources:
        digest.update(_code(source))
    path = CACHE / f"{what}-{digest.hexdigest()[:20]}.json"
    if path.exists() and not fresh:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found
    made = make()
    CACHE.mkdir(exist_ok=True)
    scratch = path.with_suffix(f".{time.monotonic_ns()}")
    scratch.write_text(json.dumps(made), encoding="utf-8")
    scratch.replace(path)
    return made


@cache
def _code(source: str) -> bytes:
    """A file without its comments, docstrings and layout."""
    tree = ast.parse((HERE / source).read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            del node.body[0]
    return ast.dump(tree).encode()
