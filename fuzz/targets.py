"""What is fuzzed: each target takes the bytes of one input, and may raise only haptid's own errors."""

from __future__ import annotations

import ast
import gzip
import io
import os
import select
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import haptid
from haptid import _core
from haptid._internal.atomic_folder import MANIFEST
from haptid.device.expressions import column
from haptid.device.toml.errors_at import Place
from haptid.errors import HaptidError
from haptid.experiment.bench import read_experiment
from haptid.log import read_log
from haptid.log.file_format import format_of
from haptid.log.request import Request
from haptid.report import read_report
from haptid.robot_files import child, import_robot, limited

# Channels that are read of a log whose own names are not the usual ones.
_MOST_CHANNELS = 40


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes:
        name: of the target, and of its folder of seeds.
        run: takes the bytes and a folder for files.
        text: whether inputs are text, of which words are exchanged too.
        allowed: classes of errors that are right for a wrong input.
        prepare: called once in the process that reads.
    """

    name: str
    run: Callable[[bytes, Path], object]
    text: bool = False
    allowed: tuple[type[Exception], ...] = (HaptidError,)
    prepare: Callable[[], object] = lambda: None

    @property
    def suffix(self) -> str:
        """Of files that are seeds of this target: "robot-urdf" reads .urdf."""
        return "." + self.name.rpartition("-")[2]


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
    text = suffix in ("csv", "json", "jsonl", "rows", "trace")
    return Target(f"log-{suffix}", _file(f"log.{'txt' if suffix == 'rows' else suffix}", _read_log), text=text)


def _read_log(path: Path) -> object:
    """All channels as they are in the file, and the log where its channels have the usual names."""
    reader = format_of(path)
    found = reader.columns(path, reader.names(path)[:_MOST_CHANNELS], Request())
    return found, read_log(path)


def _robot(suffix: str, task: str = "") -> Target:
    """A robot description; `task`: of the child process that reads it."""
    text = suffix not in ("usdc", "usdz")
    return Target(
        f"robot-{suffix}", _file(f"robot.{suffix}", _imported), text, prepare=lambda: task and _in_forks(task)
    )


def _imported(path: Path) -> object:
    made = import_robot(path)
    if not made.check.torque < 1e-8:
        raise AssertionError(f"imported with torques that differ by {made.check.torque:.1e}")
    return made.notes


def _in_forks(task: str) -> None:
    """Let foreign parsers run in forks of this process with the task's libraries: milliseconds in place of a second."""
    child._TASKS[task][0]()
    stand_in = SimpleNamespace(run=_forked, TimeoutExpired=subprocess.TimeoutExpired)
    limited.subprocess = stand_in  # type: ignore[assignment]


def _forked(call: list[str], *, input: bytes, cwd: str, timeout: float, **_: Any) -> SimpleNamespace:
    """`child.main` in a fork, as `subprocess.run` would return."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            os.chdir(cwd)
            os.close(reading)
            sys.stdin, sys.stderr = io.StringIO(input.decode()), io.StringIO()
            with os.fdopen(writing, "w") as sys.stdout:
                child.main()
        finally:
            os._exit(1)
    os.close(writing)
    parts = []
    with os.fdopen(reading, "rb", buffering=0) as stream:
        while True:
            if not select.select([stream], [], [], timeout)[0]:
                os.kill(pid, 9)
                os.waitpid(pid, 0)
                raise subprocess.TimeoutExpired(call, timeout)
            parts.append(os.read(stream.fileno(), 1 << 16))
            if not parts[-1]:
                break
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return SimpleNamespace(stdout=b"".join(parts), stderr=b"", returncode=status)


TARGETS = (
    Target("device", _file("device.toml", _device), text=True),
    Target("study", _file("study.toml", haptid.read_study), text=True),
    Target("experiment", _file("experiment.toml", read_experiment), text=True),
    Target("result", _file("result.json", _result), text=True),
    Target("report", _report, text=True),
    Target("expression", _expression, text=True),
    Target("core", _core_arguments, text=True, allowed=(ValueError, TypeError, OverflowError)),
    *(
        _log(suffix)
        for suffix in ("csv", "npz", "npy", "parquet", "h5", "mat", "json", "jsonl", "rows", "trace", "tdms")
    ),
    *(_log(suffix) for suffix in ("mcap", "db3", "bag")),
    *(_robot(suffix) for suffix in ("urdf", "sdf", "par", "csv")),
    *(_robot(suffix, task) for suffix, task in (("xml", "mjcf"), ("xacro", "xacro"), ("usda", "usd"))),
)
