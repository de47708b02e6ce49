"""The functions of the commands as jobs, each in a process of its own in the folder of the workbench."""

from __future__ import annotations

import hashlib
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
# Rate of the samples of a motion, Hz; samples at which its limits are looked at; standard errors that are named, %.
_SAMPLES_HZ, _LIMIT_SAMPLES, _WEAK_PERCENT = 1000.0, 2000, 50.0


def run_work(pipe: Connection, root: str, kind: str, arguments: dict[str, Any]) -> None:
    """Entry point of a job's process; progress and outcome are sent through the pipe."""
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


def digest_of(study: Path) -> str:
    """SHA-256 over the study's text, the device it names and the size and time of every log file.

    Logs are not hashed as a whole: a folder of an hour's recordings would be read at every look at the page.

    Raises:
        StudyFileError: the study cannot be read.
        DeviceFileError: its device cannot be read.
    """
    from haptid.device.toml.reader import read_tables
    from haptid.log.formats.folders import log_files, root_of
    from haptid.study import read_study

    found, made = read_study(study), hashlib.sha256(study.read_bytes())
    made.update(read_tables(found.device)[0].model_dump_json(by_alias=True).encode())
    for entry in found.logs:
        path = study.parent / entry.path
        files = sorted(path.rglob("*")) if path.is_dir() else log_files(path)
        for file in files:
            about = file.stat() if file.exists() else None
            name = file.relative_to(root_of(path)).as_posix() if file != path else ""
            made.update(f"{entry.path}/{name}:{about and (about.st_size, about.st_mtime_ns)}".encode())
    return made.hexdigest()


def _check(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid check`."""
    from haptid.study.check import check_study

    before = digest_of(Path(arguments["study"]))
    found = check_study(Path(arguments["study"]), None, progress)
    return {"check": found.to_json(), "inputs": before}


def _identify(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid identify`."""
    from haptid.executors import DaskExecutor, SerialExecutor
    from haptid.observation.cache import RFactorCache
    from haptid.report.run import write_identification
    from haptid.study import read_study

    out, scheduler = Path(arguments["out"]), arguments.get("scheduler")
    out.parent.mkdir(parents=True, exist_ok=True)
    result, source = write_identification(
        read_study(Path(arguments["study"])),
        None,
        out,
        command=arguments["command"],
        progress=progress,
        workers=DaskExecutor(scheduler) if scheduler else SerialExecutor(),
        cache=RFactorCache.beside(out),
    )
    return {
        "result": arguments["out"],
        "verdict": list(source.verdict.sentences),
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


def _excite(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid excite`: the experiment, its samples, and how much of each limit the motion uses."""
    import math

    from haptid.device import read_device
    from haptid.dynamics.model import DynamicModel
    from haptid.experiment.excitation import FourierSeries, Search, design_excitation, write_experiment
    from haptid.experiment.excitation.writing import plain_experiment

    def said(share: float, cost: float) -> None:
        state = (
            f"mean standard error {math.exp(cost):.4g}" if math.isfinite(cost) else "no motion within the limits yet"
        )
        progress(f"searching: {state}", share)

    model = DynamicModel(read_device(arguments["device"]))
    found = design_excitation(
        model,
        FourierSeries(seconds=float(arguments["seconds"])),
        _motion_limits(model, arguments["limits"]),
        search=Search(tries=arguments["evaluations"]),
        progress=said,
    )
    write_experiment(Path(arguments["out"]), found, plain_experiment(found), _SAMPLES_HZ)
    return {
        "experiment": arguments["out"],
        "device": arguments["device"],
        "condition": [found.before.scaled, found.after.scaled],
        "limits": _used(found),
        "weak": [name for name, se in found.predicted.items() if _WEAK_PERCENT < se < math.inf],
    }


def _motion_limits(model: Any, given: dict[str, str]) -> Any:
    """Limits of a search from texts: one number for all, or one for each."""
    from haptid.errors import SettingError
    from haptid.experiment.excitation import Limits

    def numbers(key: str, many: int) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in given[key].split(","))
        except ValueError:
            values = ()
        if len(values) == 1 and key != "centre":
            values = values * many
        if len(values) != many:
            raise SettingError(f"{key} is {given[key]!r}; write {many} numbers with commas.", where=key)
        return values

    active, rows = len(model.device.active), len(model.device.row_names)
    made: dict[str, Any] = {key: numbers(key, rows if key == "torque" else active) for key in given}
    centre, stroke = made.pop("centre", None), made.pop("stroke", None)
    if (centre is None) != (stroke is None):
        raise SettingError("centre and stroke belong together.", where="centre", advice="Give both, or none.")
    if centre is not None and stroke is not None:
        made["position"] = tuple((c - abs(s), c + abs(s)) for c, s in zip(centre, stroke, strict=True))
    return Limits(**made)


def _used(found: Any) -> list[dict[str, Any]]:
    """Share of every limit that a motion uses, the most first."""
    import numpy as np

    from haptid.dynamics.inverse import inverse_dynamics

    bounds, device = found.bounds, found.model.device
    made = found.trajectory(found.seconds / _LIMIT_SAMPLES)
    states = [np.ascontiguousarray(x.T) for x in (made.q, made.qd, made.qdd)]
    low, high = bounds.position.T
    shares = [("position", bounds.names, np.abs(states[0] - (0.5 * (low + high))[:, None]), 0.5 * (high - low))]
    shares += [("speed", bounds.names, np.abs(states[1]), bounds.speed)]
    shares += [("acceleration", bounds.names, np.abs(states[2]), bounds.acceleration)]
    torque = np.abs(inverse_dynamics(found.model, bounds.beta, *states))
    shares += [("torque", device.row_labels, torque, bounds.actuation.torque)]
    rows = [
        {"limit": what, "of": name, "share": float(values.max() / most)}
        for what, names, each, limit in shares
        for name, values, most in zip(names, each, np.broadcast_to(limit, (len(names),)), strict=True)
        if np.isfinite(most) and most > 0
    ]
    return sorted(rows, key=lambda row: -row["share"])


def _bench(arguments: dict[str, Any], progress: _Progress) -> dict[str, Any]:
    """As `haptid bench`."""
    from haptid.experiment.bench.run import Job, make_log

    job = Job(arguments["device"], Path(arguments["experiment"]), Path(arguments["log"]), seed=1)
    make_log(job, lambda share: progress("simulating", share))
    return {"log": arguments["log"]}


WORK: dict[str, Callable[[dict[str, Any], _Progress], dict[str, Any]]] = {
    "check": _check,
    "identify": _identify,
    "try-out": _try_out,
    "excite": _excite,
    "bench": _bench,
}
