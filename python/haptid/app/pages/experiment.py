"""The experiment page: the search for an exciting motion as a job, its playback, and its rehearsal."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

from haptid._internal.numerals import whole_number
from haptid.app.answers import Asked
from haptid.app.pages.device import shipped_text
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import DEVICES, EXPERIMENTS, LOGS, free_name
from haptid.errors import WorkbenchError

# Limits that a page may give: names of options of `haptid excite`, and of the work.
_LIMITS = ("speed", "acceleration", "torque", "centre", "stroke")
_SEARCHED, _SECONDS = ("evaluations", 1, 100_000), ("seconds", 1, 3600)


def _experiment(session: Session, asked: Asked) -> dict[str, Any]:
    """An experiment file, whether its samples are beside it, and the last search that wrote it."""
    name = asked.text("path")
    path = session.workspace.inside(name, EXPERIMENTS)
    text, sha256 = session.workspace.read_text(name)
    samples = path.with_suffix(".csv")
    columns = samples.open(encoding="utf-8").readline().strip().split(",") if samples.is_file() else []
    made = next(
        (one for one in session.jobs.recent(200) if one.kind == "excite" and one.arguments["out"] == name), None
    )
    return {
        "text": text,
        "sha256": sha256,
        "samples": f"{EXPERIMENTS}/{samples.name}" if columns else "",
        "columns": columns,
        "job": made and asdict(made),
    }


def _search(session: Session, asked: Asked) -> dict[str, Any]:
    """A search for an exciting motion begins."""
    device, name = _device(session, asked.text("device")), f"{asked.text('name')}.toml"
    session.workspace.check_name(name, ".toml")
    out = f"{EXPERIMENTS}/{name}"
    if (session.workspace.folder / out).exists():
        raise WorkbenchError(f"{out} is there already.", where=name, advice="Give another name.")
    given = {key: value for key in _LIMITS if (value := asked.text(key, "").replace(" ", ""))}
    evaluations, seconds = (_whole(asked, *each) for each in (_SEARCHED, _SECONDS))
    (session.workspace.folder / EXPERIMENTS).mkdir(exist_ok=True)
    options = [f"--{key}={value}" for key, value in given.items()]
    wanted = ["--max-evaluations", str(evaluations), "--seconds", str(seconds)]
    command = shlex.join(["haptid", "excite", device, *options, *wanted, "--out", out])
    arguments = {"device": device, "out": out, "limits": given, "evaluations": evaluations, "seconds": seconds}
    writes = [out, str(Path(out).with_suffix(".csv"))]
    return asdict(
        session.jobs.start("excite", f"Search for a motion of {device}", command, arguments | {"writes": writes})
    )


def _rehearse(session: Session, asked: Asked) -> dict[str, Any]:
    """The virtual bench in place of the device."""
    device, name = _device(session, asked.text("device")), _file(session, asked.text("path"), EXPERIMENTS)
    path = session.workspace.folder / name
    (session.workspace.folder / LOGS).mkdir(exist_ok=True)
    log = session.workspace.name_of(free_name(session.workspace.folder / LOGS, f"{path.stem}.parquet"))
    command = shlex.join(["haptid", "bench", device, name, "--out", log])
    arguments = {"device": device, "experiment": name, "log": log, "writes": [log]}
    return asdict(session.jobs.start("bench", f"Rehearsal of {name}", command, arguments))


def _device(session: Session, name: str) -> str:
    """A device's name, or its path in the folder, of a file that is there."""
    if "/" in name:
        return _file(session, name, DEVICES)
    shipped_text(name)
    return name


def _file(session: Session, name: str, folder: str) -> str:
    """The path of a TOML file right in a folder, checked."""
    path = session.workspace.edited(name)
    if not (name.startswith(f"{folder}/") and path.is_file()):
        raise WorkbenchError(f"{name[:200]!r} is no file in {folder}/.", where=name[:200])
    return name


def _whole(asked: Asked, name: str, low: int, high: int) -> int:
    text = asked.text(name)
    number = whole_number(text)
    if number is None or not low <= number <= high:
        raise WorkbenchError(f"{name} is {text[:40]!r}; write a whole number from {low} to {high}.", where=name)
    return number


EXPERIMENT_CALLS = PageCalls(
    reads={"experiment": _experiment},
    changes={"experiment/search": _search, "experiment/rehearse": _rehearse},
)
