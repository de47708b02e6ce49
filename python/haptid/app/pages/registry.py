"""The registry page: devices by serial number, their results over time, what is removed to a trash."""

from __future__ import annotations

import os
import shlex
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid.app.answers import Asked
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import LOGS, RESULTS, free_name
from haptid.errors import WorkbenchError

if TYPE_CHECKING:
    from haptid.registry import Indexed

# Entries that are listed.
_MOST = 2000


def _registry(session: Session, asked: Asked) -> dict[str, Any]:
    """Devices by serial number, or by name where they have none, with their files and results, oldest first."""
    index, words = session.index, asked.text("words", "")
    logs = {entry.path: entry for entry in index.search("log", limit=_MOST)}
    found: dict[tuple[str, str], dict[str, Any]] = {}

    def of(name: str, serial: str) -> dict[str, Any]:
        new = {"name": name, "serial": serial, "files": [], "results": []}
        return found.setdefault((name, serial), new)

    for entry in index.search("device", words, _MOST):
        of(entry.title, str(entry.about.get("serial", "")))["files"].append(entry.path)
    for entry in index.search("result", words, _MOST):
        if "unreadable" not in entry.about:
            made = of(str(entry.about.get("device", "")), str(entry.about.get("serial", "")))
            made["results"].append(asdict(entry) | {"date": _recorded(entry, logs)})
    for made in found.values():
        made["results"].sort(key=lambda one: one["date"])
        times = ",".join(one["date"] for one in made["results"])
        paths = [one["path"] for one in made["results"]]
        made["command"] = shlex.join(["haptid", "compare", *paths, "--times", times]) if len(paths) > 1 else ""
    unused = [asdict(entry) for entry in logs.values() if not entry.results]
    order = sorted(found.values(), key=lambda made: (made["name"].lower(), made["serial"]))
    return {"devices": order, "unused": unused}


def _remove(session: Session, asked: Asked) -> dict[str, Any]:
    """A log or a result goes to `.haptid/trash`; nothing is erased.

    Raises:
        WorkbenchError: it is none, or a job is about it.
    """
    name = asked.text("path")
    path = session.workspace.inside(name, LOGS, RESULTS)
    if name.count("/") != 1 or not os.path.lexists(path) or path.name.startswith("."):
        raise WorkbenchError(f"{name[:200]!r} is no log or result of this folder.", where=name[:200])
    if session.jobs.running() is not None:
        raise WorkbenchError("a job is running.", advice="Wait for its end, or cancel it.")
    trash = session.workspace.own() / "trash"
    trash.mkdir(exist_ok=True)
    place = free_name(trash, path.name)
    os.replace(path, place)
    session.changed()
    return {"path": place.relative_to(session.workspace.folder).as_posix()}


def _recorded(result: Indexed, logs: dict[str, Indexed]) -> str:
    """When a result's first log was last written, else when the result was, as a date and time of UTC."""
    times = [logs[path].modified for path in result.logs if path in logs and Path(path).suffix]
    made = datetime.fromtimestamp(min(times, default=result.modified), UTC)
    return made.strftime("%Y-%m-%dT%H:%M:%S")


REGISTRY_CALLS = PageCalls(reads={"registry": _registry}, changes={"registry/remove": _remove})
