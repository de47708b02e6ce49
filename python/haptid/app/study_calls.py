"""Calls of studies: a draft from dropped logs, the contents of an edited text, the check, and the jobs."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid.app.answers import Asked
from haptid.app.jobs import JobState
from haptid.app.workspace import DEVICES, EXPERIMENTS, LOGS, RESULTS, STUDIES
from haptid.errors import HaptidError, WorkbenchError

if TYPE_CHECKING:
    from haptid.app.pages import Session

_Calls = dict[str, Callable[[Asked], Any]]
# The virtual bench in place of a device: names of its files here and in the folder, and the logs with their seeds.
_TRIED = "bench-phantom"
_TRIED_LOGS = {f"{LOGS}/bench-sweep.parquet": 1, f"{LOGS}/bench-check.parquet": 2}


def study_reads(session: Session) -> _Calls:
    """Calls that change nothing."""

    def state(asked: Asked) -> dict[str, Any]:
        """Whether a study was checked as it is now, and what was found."""
        from haptid.app.inputs import digest_of

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

    return {"study/state": state}


def study_changes(session: Session) -> _Calls:
    """Calls that have a body."""
    space, jobs = session.workspace, session.jobs

    def draft(asked: Asked) -> dict[str, Any]:
        """A draft of a study, as `haptid channels --device` writes it."""
        from haptid.device import read_device
        from haptid.study.draft import draft_study

        device, logs = asked.text("device"), asked.texts("logs")
        if not logs:
            raise WorkbenchError(
                "no log is chosen.", advice="Choose one log to identify from, others to validate with."
            )
        paths = [space.inside(log, LOGS) for log in logs]
        place = space.inside(device, DEVICES) if "/" in device else None
        text, found = draft_study(paths, read_device(place or device), str(place or device), space.folder / STUDIES)
        stem = Path(device).stem
        name, count = f"{STUDIES}/{stem}.toml", 2
        while (space.folder / name).exists():
            name, count = f"{STUDIES}/{stem}-{count}.toml", count + 1
        named = [log for log in logs if " " not in log] or logs
        typed = ["haptid", "channels", *named, "--device", device, "--out", name]
        return {"text": text, "path": name, "notes": list(found.notes), "command": shlex.join(typed)}

    def read(asked: Asked) -> dict[str, Any]:
        """The contents of a study's text, as `read_study` reads them."""
        from haptid.study import read_study

        name = asked.text("path")
        with space.beside(name, asked.text("text")) as path:
            try:
                study = read_study(path)
            except HaptidError as error:
                return {"error": str(error).replace(str(path), name).replace(path.name, Path(name).name)}
        logs = [{"path": entry.path, "role": entry.role} for entry in study.logs]
        return {"name": study.name, "device": str(study.device), "logs": logs, "method": study.method.name}

    def start_check(asked: Asked) -> dict[str, Any]:
        name = asked.text("path")
        space.inside(name, STUDIES)
        command = shlex.join(["haptid", "check", name])
        return asdict(jobs.start("check", f"Check of {name}", command, {"study": name}))

    def start_run(asked: Asked) -> dict[str, Any]:
        name, out = asked.text("path"), asked.text("out")
        space.check_name(Path(out).name)
        path = space.inside(out, RESULTS)
        if path.parent != space.folder / RESULTS:
            raise WorkbenchError(f"{out} is no folder right below {RESULTS}/.", where=out)
        found = study_reads(session)["study/state"](Asked({"path": name}))
        if not found["ready"]:
            why = found["error"] or (
                "the check found problems"
                if found["fresh"]
                else "it was not checked as it is now, with its device and logs"
            )
            raise WorkbenchError(f"{name} does not run: {why}.", where=name, advice="Check it first.")
        path.parent.mkdir(exist_ok=True)
        command = shlex.join(["haptid", "identify", name, "--out", out])
        arguments = {"study": name, "out": out, "command": command, "writes": [out]}
        return asdict(jobs.start("identify", f"Identification of {name}", command, arguments))

    def try_out(_: Asked) -> dict[str, Any]:
        """Write the files of the trial, and run it; files that are there are used as they are."""
        study, experiment = f"{STUDIES}/{_TRIED}.toml", f"{EXPERIMENTS}/{_TRIED}.toml"
        shipped = files("haptid.app") / "try_out"
        for name, source in ((study, "study.toml"), (experiment, "experiment.toml")):
            if not space.inside(name).exists():
                space.save_text(name, (shipped / source).read_text(encoding="utf-8"), "")
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
        (space.folder / RESULTS).mkdir(exist_ok=True)
        return asdict(jobs.start("try-out", "Trial on the virtual bench", "\n".join([*benches, command]), arguments))

    return {"study/draft": draft, "study/read": read, "check": start_check, "identify": start_run, "try-out": try_out}
