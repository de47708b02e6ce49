"""What jobs do, each in a process of its own that works in the folder of the workbench: the calls of the commands."""

from __future__ import annotations

import multiprocessing
import os
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from haptid.errors import HaptidError

_Progress = Callable[[str, float], None]


def run_work(pipe: Connection, root: str, kind: str, arguments: dict[str, Any]) -> None:
    """Entry point of a job's process: work, and say progress and outcome through the pipe."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as on the command line: matrices are small
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.chdir(root)
    try:
        outcome = WORK[kind](arguments, lambda what, share: pipe.send(("progress", (what, share))))
        pipe.send(("end", {"outcome": outcome}))
    except HaptidError as error:
        pipe.send(("end", {"error": str(error)}))
    except OSError as error:
        pipe.send(("end", {"error": f"{error.filename or 'the disk'}: {error.strerror or error}."}))
    except Exception:
        pipe.send(
            ("end", {"error": "This is a defect of haptid, not of your input.", "defect": traceback.format_exc()})
        )
    pipe.close()


def _end_with_parent() -> None:
    """A job does not outlive its server, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _check(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid check`."""
    from haptid.app.inputs import digest_of
    from haptid.study.check import check_study

    before = digest_of(Path(arguments["study"]))
    found = check_study(Path(arguments["study"]), None, progress)
    return {"check": found.to_json(), "inputs": before}


def _identify(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid identify`."""
    from haptid.executors import SerialExecutor
    from haptid.observation.cache import partial_of
    from haptid.report.run import write_identification
    from haptid.study import read_study

    out = Path(arguments["out"])
    out.parent.mkdir(parents=True, exist_ok=True)
    result, source = write_identification(
        read_study(Path(arguments["study"])),
        None,
        out,
        command=arguments["command"],
        progress=progress,
        workers=SerialExecutor(),
        cache=partial_of(out),
    )
    return {
        "result": arguments["out"],
        "verdict": list(source.diagnosis.verdict.sentences),
        "met": result.criteria.met,
    }


def _try_out(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """The virtual bench in place of a device: logs of an experiment, and their identification."""
    from haptid.experiment.bench.run import Job, make_log

    for log, seed in arguments["logs"].items():
        path = Path(log)
        path.parent.mkdir(parents=True, exist_ok=True)
        step = f"simulating {path.name}"
        make_log(
            Job(arguments["device"], Path(arguments["experiment"]), path, seed=seed),
            lambda share, step=step: progress(step, share),  # type: ignore[misc]
        )
    return _identify(arguments, progress)


WORK: dict[str, Callable[[dict[str, Any], _Progress], dict[str, Any]]] = {
    "check": _check,
    "identify": _identify,
    "try-out": _try_out,
}
