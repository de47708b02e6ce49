"""Foreign parsers in a child process: bounded in time, processor time, memory and files.

`run_limited` runs `child.py`, sends the request as JSON and reads the answer as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from haptid.errors import MissingDependencyError, RobotFileError
from haptid.robot_files.child import CPU_SECONDS, MEMORY_LIMIT

# Longest time that a child may take, s.
WALL_SECONDS = 120
# Longest answer, bytes.
LONGEST_ANSWER = 100_000_000


def run_limited(task: str, request: dict[str, Any], folders: Sequence[Path], file: str, extra: str) -> dict[str, Any]:
    """The answer of a task in a child process.

    Args:
        task: "xacro", "mjcf" or "usd".
        request: argument, as JSON.
        folders: that the child may read from.
        file: the description, for errors.
        extra: optional dependencies that hold the task's library.

    Raises:
        MissingDependencyError: the library is not installed.
        RobotFileError: what the child found, or that it took too long or too much memory.
    """
    asked = json.dumps({"task": task, "request": request, "folders": [str(folder) for folder in folders]})
    with tempfile.TemporaryDirectory() as scratch:
        try:
            done = subprocess.run(
                [sys.executable, "-P", str(Path(__file__).with_name("child.py"))],
                input=asked.encode(),
                capture_output=True,
                cwd=scratch,
                timeout=WALL_SECONDS,
                check=False,
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(x for x in sys.path if x),
                    "OPENBLAS_NUM_THREADS": "1",
                },
            )
        except subprocess.TimeoutExpired:
            raise _stopped(file, f"takes longer than {WALL_SECONDS} s") from None
    answer = _answer(done.stdout)
    if answer is None:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        killed = (
            f"stopped the reader (status {done.returncode}, limits {CPU_SECONDS} s and {MEMORY_LIMIT // 2**30} GiB)"
        )
        raise _stopped(file, killed + (f": {last[0][:200]}" if last else ""))
    if "missing" in answer:
        raise MissingDependencyError(
            f"{file}: reading it requires the package {answer['missing']}, which is not installed.",
            where=answer["missing"],
            advice=f"Install it with `pip install haptid[{extra}]`.",
        )
    if "error" in answer:
        advice = answer.get("advice", "Correct the file.")
        raise RobotFileError(f"{file}: {answer['error']}.", where=(file, None), found=answer["error"], advice=advice)
    return dict(answer["result"])


def _answer(output: bytes) -> dict[str, Any] | None:
    if len(output) > LONGEST_ANSWER:
        return {"error": f"its content is larger than {LONGEST_ANSWER} bytes when read"}
    try:
        answer = json.loads(output)
    except (ValueError, RecursionError):
        return None
    return answer if isinstance(answer, dict) else None


def _stopped(file: str, found: str) -> RobotFileError:
    advice = "Is it a robot? Remove what multiplies: loops, replicates, meshes of millions of faces."
    return RobotFileError(f"{file}: it {found}.", where=(file, None), found=found, advice=advice)
