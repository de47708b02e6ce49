"""Studies, of the pages of data and of solving: a draft from dropped logs, remedies, the check, and the jobs.

A remedy is a change of the study's text with which a log that is refused can be read. Each is tried on the log before
it is offered, so that a button does what it says.
"""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import asdict
from importlib.resources import files
from itertools import combinations
from pathlib import Path
from typing import Any

from haptid._internal.toml_edit import TomlEditError, with_value
from haptid.app.answers import Asked
from haptid.app.jobs import JobState
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import DEVICES, EXPERIMENTS, LOGS, RESULTS, STUDIES
from haptid.errors import HaptidError, WorkbenchError

# The virtual bench in place of a device: names of its files here and in the folder, and the logs with their seeds.
_TRIED = "bench-phantom"
_TRIED_LOGS = {f"{LOGS}/bench-sweep.parquet": 1, f"{LOGS}/bench-check.parquet": 2}
# Changes of a text: keys and value of each.
_Edits = tuple[tuple[tuple[str | int, ...], Any], ...]
# Channels of a kind that are exchanged in pairs; bytes of a log that is read again for every remedy; left out around a
# time, s.
_MOST_CHANNELS, _LARGEST, _AROUND = 10, 64 * 2**20, 0.05
# A part of a log ends this much before a time, s, or with the log: no log lasts longer than this.
_BEFORE, _END = 1e-6, 1e6
_UNITS = {"rad": ("deg",), "deg": ("rad",), "m": ("mm",), "mm": ("m",)}


def _state(session: Session, asked: Asked) -> dict[str, Any]:
    """Whether a study was checked as it is now, and what was found."""
    from haptid.app.work import digest_of

    name = asked.text("path")
    records = [one for one in session.jobs.recent(200) if one.arguments.get("study") == name]
    newest = {
        kind: next((one for one in records if one.kind == kind), None) for kind in ("check", "identify", "try-out")
    }
    check, now, why = newest["check"], "", ""
    try:
        now = digest_of(session.workspace.inside(name, STUDIES))
    except HaptidError as error:
        why = str(error)
    fresh = check is not None and check.state == JobState.DONE and check.outcome["inputs"] == now
    running = session.jobs.running()
    return {
        "check": check and asdict(check),
        "fresh": fresh,
        "ready": fresh and check is not None and not check.outcome["check"]["problems"],
        "error": why,
        "running": running and asdict(running),
        "last": next((asdict(one) for one in records if one.kind in ("identify", "try-out")), None),
    }


def _draft(session: Session, asked: Asked) -> dict[str, Any]:
    """A draft of a study, as `haptid channels --device` writes it."""
    from haptid.device import read_device
    from haptid.study.draft import draft_study

    device, logs = asked.text("device"), asked.texts("logs")
    if not logs:
        raise WorkbenchError("no log is chosen.", advice="Choose one log to identify from, others to validate with.")
    paths = [session.workspace.inside(log, LOGS) for log in logs]
    place = session.workspace.inside(device, DEVICES) if "/" in device else None
    text, found = draft_study(
        paths, read_device(place or device), str(place or device), session.workspace.folder / STUDIES
    )
    stem = Path(device).stem
    name, count = f"{STUDIES}/{stem}.toml", 2
    while (session.workspace.folder / name).exists():
        name, count = f"{STUDIES}/{stem}-{count}.toml", count + 1
    named = [log for log in logs if " " not in log] or logs
    typed = ["haptid", "channels", *named, "--device", device, "--out", name]
    return {"text": text, "path": name, "notes": list(found.notes), "command": shlex.join(typed)}


def _read(session: Session, asked: Asked) -> dict[str, Any]:
    """The contents of a study's text, as `read_study` reads them."""
    from haptid.study import read_study

    name = asked.text("path")
    with session.workspace.beside(name, asked.text("text")) as path:
        try:
            study = read_study(path)
        except HaptidError as error:
            return {"error": str(error).replace(str(path), name).replace(path.name, Path(name).name)}
    logs = [{"path": entry.path, "role": entry.role} for entry in study.logs]
    return {"name": study.name, "device": str(study.device), "logs": logs, "method": study.method.name}


def _start_check(session: Session, asked: Asked) -> dict[str, Any]:
    """The check of a study begins."""
    name = asked.text("path")
    session.workspace.inside(name, STUDIES)
    command = shlex.join(["haptid", "check", name])
    return asdict(session.jobs.start("check", f"Check of {name}", command, {"study": name}))


def _start_run(session: Session, asked: Asked) -> dict[str, Any]:
    """The identification of a study that was checked as it is now begins."""
    name, out = asked.text("path"), asked.text("out")
    session.workspace.check_name(Path(out).name)
    path = session.workspace.inside(out, RESULTS)
    if path.parent != session.workspace.folder / RESULTS:
        raise WorkbenchError(f"{out} is no folder right below {RESULTS}/.", where=out)
    found = _state(session, asked)
    if not found["ready"]:
        why = found["error"] or (
            "the check found problems"
            if found["fresh"]
            else "it was not checked as it is now, with its device and logs"
        )
        raise WorkbenchError(f"{name} does not run: {why}.", where=name, advice="Check it first.")
    path.parent.mkdir(exist_ok=True)
    scheduler = asked.text("scheduler", "")
    command = shlex.join(["haptid", "identify", name, "--out", out, *(["--scheduler", scheduler] if scheduler else [])])
    arguments = {"study": name, "out": out, "command": command, "scheduler": scheduler, "writes": [out]}
    return asdict(session.jobs.start("identify", f"Identification of {name}", command, arguments))


def _try_out(session: Session, _asked: Asked) -> dict[str, Any]:
    """Write the files of the trial, and run it; files that are there are used as they are."""
    study, experiment = f"{STUDIES}/{_TRIED}.toml", f"{EXPERIMENTS}/{_TRIED}.toml"
    shipped = files("haptid.app") / "try_out"
    for name, source in ((study, "study.toml"), (experiment, "experiment.toml")):
        if not session.workspace.inside(name).exists():
            session.workspace.save_text(name, (shipped / source).read_text(encoding="utf-8"), "")
    session.changed()
    device, out = "phantom_premium_15", f"{RESULTS}/{_TRIED}"
    benches = [
        shlex.join(["haptid", "bench", device, experiment, "--out", log, "--seed", str(seed)])
        for log, seed in _TRIED_LOGS.items()
    ]
    command = shlex.join(["haptid", "identify", study, "--out", out])
    arguments = {
        "device": device,
        "experiment": experiment,
        "logs": _TRIED_LOGS,
        "study": study,
        "out": out,
        "command": command,
        "writes": [out, *_TRIED_LOGS],
    }
    (session.workspace.folder / RESULTS).mkdir(exist_ok=True)
    return asdict(
        session.jobs.start("try-out", "Trial on the virtual bench", "\n".join([*benches, command]), arguments)
    )


def _remedies(session: Session, asked: Asked) -> dict[str, Any]:
    """What is said of each log of a study's text, and what would mend it."""
    name, text = asked.text("path"), asked.text("text")

    def read(changed: str) -> list[tuple[str, list[str], HaptidError | None]]:
        with session.workspace.beside(name, changed) as path:
            return list(_logs_of(path))

    found = []
    for k, (log, notes, error) in enumerate(read(text)):
        entry: dict[str, Any] = {"log": log, "notes": notes, "problem": "", "at": None, "remedies": []}
        if error is not None:
            at = _time(error)
            entry |= {"problem": str(error), "at": at}
            path = (session.workspace.folder / Path(name).parent / log).resolve()
            if path.is_file() and path.stat().st_size <= _LARGEST:
                entry["remedies"] = list(_working(text, k, at, read))
        found.append(entry)
    return {"logs": found}


def _logs_of(path: Path) -> Iterator[tuple[str, list[str], HaptidError | None]]:
    """Every log of a study: path, notes, and why it cannot be used."""
    from haptid.device import read_device
    from haptid.motion.channels import check_log
    from haptid.study import read_study
    from haptid.study.identify import read_entry

    study = read_study(path)
    device = read_device(study.device)
    for entry in study.logs:
        try:
            log = read_entry(entry, path.parent, lambda _what, _share: None)
            yield entry.path, [*log.notes, *check_log(device, log)], None
        except HaptidError as error:
            yield entry.path, [], error


def _working(
    text: str, k: int, at: float | None, read: Callable[[str], list[tuple[str, list[str], HaptidError | None]]]
) -> Iterator[dict[str, Any]]:
    """Remedies with which the k-th log is read."""
    for title, edits in _candidates(tomllib.loads(text), k, at):
        try:
            changed = text
            for path, value in edits:
                changed = with_value(changed, path, value)
            if read(changed)[k][2] is None:
                yield {"title": title, "text": changed}
        except (HaptidError, TomlEditError):
            continue


def _candidates(values: dict[str, Any], k: int, at: float | None) -> Iterator[tuple[str, _Edits]]:
    """Changes that may help, the likely ones first."""
    channels = values.get("channels", {})
    position = channels.get("position", {})
    for unit in _UNITS.get(position.get("unit", "rad"), ()):
        yield f"Positions are in {unit}", ((("channels", "position", "unit"), unit),)
    unwrap = (("channels", "position", "unwrap"), True)
    yield "Positions jump by their period: unwrap them", (unwrap,)
    for unit in _UNITS.get(position.get("unit", "rad"), ()):
        yield f"Positions are in {unit} and jump", ((("channels", "position", "unit"), unit), unwrap)
    for kind in ("position", "torque"):
        names = channels.get(kind, {}).get("channels", [])
        for i, j in combinations(range(len(names)), 2) if len(names) <= _MOST_CHANNELS else ():
            swapped = list(names)
            swapped[i], swapped[j] = names[j], names[i]
            yield f"Exchange {names[i]} and {names[j]}", ((("channels", kind, "channels"), swapped),)
    if at is not None:
        begin, end = values.get("logs", [{}])[k].get("time_range", [0.0, _END])
        yield f"Use the log from {at:.3f} s on", ((("logs", k, "time_range"), [round(at, 6), end]),)
        yield f"Use the log up to {at:.3f} s", ((("logs", k, "time_range"), [begin, round(at - _BEFORE, 6)]),)
        ranges = [*values.get("logs", [{}])[k].get("exclude", []), [round(at - _AROUND, 6), round(at + _AROUND, 6)]]
        yield f"Leave out {at - _AROUND:.3f} to {at + _AROUND:.3f} s", ((("logs", k, "exclude"), ranges),)
    for kind in ("position", "torque"):
        yield f"A {kind} may be constant", ((("channels", kind, "constant_ok"), True),)
    yield "Torques may stay at their limit", ((("channels", "torque", "allow_saturation"), True),)


def _time(error: HaptidError) -> float | None:
    """The time that an error is about, s."""
    where = error.where if isinstance(error.where, tuple) else (error.where,)
    return next((float(part) for part in where if isinstance(part, float)), None)


SOLVE_CALLS = PageCalls(
    reads={"study/state": _state},
    changes={
        "study/draft": _draft,
        "study/read": _read,
        "study/remedies": _remedies,
        "check": _start_check,
        "identify": _start_run,
        "try-out": _try_out,
    },
)
