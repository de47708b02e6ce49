"""What is fuzzed: each target takes the bytes of one input, and may raise only haptid's own errors."""

from __future__ import annotations

import ast
import gzip
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import haptid
from haptid import _core
from haptid._internal.atomic_folder import MANIFEST
from haptid.device.expressions import column
from haptid.device.toml.errors_at import Place
from haptid.errors import HaptidError
from haptid.experiment.bench import read_experiment
from haptid.log import read_log
from haptid.report import read_report


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        name: of the target, and of its folder of seeds.
        run: takes the bytes and a folder for files.
        text: whether inputs are text, of which words are exchanged too.
        allowed: classes of errors that are right for a wrong input.
    """

    name: str
    run: Callable[[bytes, Path], object]
    text: bool = False
    allowed: tuple[type[Exception], ...] = (HaptidError,)


def _file(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def run(data: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(data)
        return read(path)

    return run


def _device(path: Path) -> object:
    return haptid.DynamicModel(haptid.read_device(path)).base.names


def _result(path: Path) -> object:
    (path.parent / MANIFEST).unlink(missing_ok=True)
    read = haptid.Result.load(path)
    return read.to_json(), read.unconstrained, read.conf_int(), read.unseen


def _report(data: bytes, folder: Path) -> object:
    """Data of a report, compressed after the mutation where they are not."""
    (folder / "report-data.json.gz").write_bytes(data if data[:2] == b"\x1f\x8b" else gzip.compress(data, 1))
    return read_report(folder).html()


def _expression(data: bytes, _: Path) -> object:
    return column(data.decode("utf-8", "replace"), ["1", "2"], {"L": 0.3}, Place("fuzz"))


def _core_arguments(data: bytes, _: Path) -> object:
    """A mechanism of the core from its arguments in Python's notation, with `array([...], "type")` for arrays."""
    try:
        tree = ast.parse(data.decode("utf-8"), mode="eval").body
        given = [_value(node) for node in tree.elts] if isinstance(tree, ast.Tuple) else []
    except (SyntaxError, ValueError, TypeError, OverflowError, RecursionError, MemoryError):
        return None  # not an input of the core
    return _core.Mechanism(*given)


def _value(node: ast.expr) -> object:
    """A value of the notation."""
    if isinstance(node, ast.Call):
        values, kind = (ast.literal_eval(part) for part in node.args)
        return np.array(values, dtype=kind)
    if isinstance(node, ast.List):
        return [_value(part) for part in node.elts]
    if isinstance(node, ast.Tuple):
        return tuple(_value(part) for part in node.elts)
    return ast.literal_eval(node)


def _log(suffix: str) -> Target:
    return Target(f"log-{suffix}", _file(f"log.{suffix}", read_log), text=suffix == "csv")


TARGETS = (
    Target("device", _file("device.toml", _device), text=True),
    Target("study", _file("study.toml", haptid.read_study), text=True),
    Target("experiment", _file("experiment.toml", read_experiment), text=True),
    Target("result", _file("result.json", _result), text=True),
    Target("report", _report, text=True),
    Target("expression", _expression, text=True),
    Target("core", _core_arguments, text=True, allowed=(ValueError, TypeError, OverflowError)),
    *(_log(suffix) for suffix in ("csv", "npz", "parquet", "h5", "mat")),
)
