"""Foreign parsers in a child process: bounded in time, processor time, memory and files.

`run_limited` starts `python -m haptid.robot_files.limited NAME`, sends the request as JSON and reads the answer as JSON.
The child limits itself before it imports anything else, and reads no file outside the allowed folders.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from haptid.errors import MissingDependencyError, RobotFileError

# Processor time and elapsed time, s, and memory, bytes, of a child.
CPU_SECONDS, WALL_SECONDS, MEMORY = 40, 120, 6 * 2**30
# Longest answer, bytes.
LONGEST_ANSWER = 100_000_000
_TASKS = {"xacro": "haptid.robot_files.xacro", "mjcf": "haptid.robot_files.mjcf_compiler"}


def run_limited(task: str, request: dict[str, Any], folders: Sequence[Path], file: str, extra: str) -> dict[str, Any]:
    """The answer of a task's `run_child(request)` in a child process.

    Args:
        task: "xacro" or "mjcf".
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
                [sys.executable, "-m", "haptid.robot_files.limited", task],
                input=asked.encode(),
                capture_output=True,
                cwd=scratch,
                timeout=WALL_SECONDS,
                check=False,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(x for x in sys.path if x), "OPENBLAS_NUM_THREADS": "1"},
            )
        except subprocess.TimeoutExpired:
            raise _stopped(file, f"takes longer than {WALL_SECONDS} s") from None
    answer = _answer(done.stdout)
    if answer is None:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        killed = f"stopped the reader (status {done.returncode}, limits {CPU_SECONDS} s and {MEMORY // 2**30} GiB)"
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


def _limit() -> None:
    try:
        import resource
    except ImportError:  # no such limits on Windows: the time limit of the parent holds
        return
    for what, most in ((resource.RLIMIT_CPU, CPU_SECONDS), (resource.RLIMIT_CORE, 0), (resource.RLIMIT_FSIZE, 2**24)):
        resource.setrlimit(what, (most, most))
    if sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


class OutsideError(Exception):
    """The child was asked to open what it may not."""


def _guard(folders: Sequence[str]) -> None:
    """Refuse to open files outside these folders and Python's own, and to start processes or connections."""
    own = [*sys.path, sys.prefix, sys.base_prefix, os.getcwd(), os.path.dirname(os.__file__)]
    roots = [os.path.realpath(folder) for folder in (*folders, *own) if folder]

    def audit(event: str, arguments: tuple[Any, ...]) -> None:
        if event.startswith(("subprocess.", "socket.", "os.system", "os.exec", "os.posix_spawn", "os.fork", "ctypes.")):
            raise OutsideError(f"it tries to call {event}")
        if event in ("open", "os.listdir", "os.scandir") and isinstance(arguments[0], str | bytes):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if path != os.devnull and not any(path == root or path.startswith(root + os.sep) for root in roots):
                raise OutsideError(f"it reads {os.fsdecode(arguments[0])}, outside its folder and the packages stated")

    sys.addaudithook(audit)


def main() -> None:
    """Run the task that is asked for on standard input, and write the answer on standard output."""
    _limit()
    asked = json.load(sys.stdin)
    out, sys.stdout = sys.stdout, sys.stderr  # libraries print
    try:
        module = importlib.import_module(_TASKS[asked["task"]])
        module.prepare_child()
        _guard(asked["folders"])
        answer = {"result": module.run_child(asked["request"])}
    except ImportError as error:
        answer = {"missing": error.name or str(error)}
    except MemoryError:
        answer = {"error": f"reading it takes more than {MEMORY // 2**30} GiB of memory"}
    except OutsideError as error:
        advice = "If you trust it, state a folder that holds what it reads: --package NAME=FOLDER."
        answer = {"error": str(error), "advice": advice}
    except RecursionError:
        answer = {"error": "it is nested too deeply"}
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        answer = {"error": f"its parser says: {text[:400].rstrip('.')}"}
    json.dump(answer, out)
    out.flush()


if __name__ == "__main__":
    main()
