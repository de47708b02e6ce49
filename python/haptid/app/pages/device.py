"""The device page: shipped devices, and the model of a device text that is being edited."""

from __future__ import annotations

import shlex
import tempfile
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

from haptid.app.answers import Asked
from haptid.app.session import PageCalls, Session
from haptid.app.workspace import DEVICES, free_name
from haptid.errors import HaptidError, WorkbenchError

# Robot descriptions that are read here; one text at a time, so that what it includes is not there and is named. Xacro,
# whose expressions are run, is left to the command.
_DESCRIPTIONS = (".urdf", ".sdf", ".xml", ".par")


def _checked_text(session: Session, asked: Asked) -> dict[str, Any]:
    """What a device's text means, or the sentence of its error; nothing is written."""
    name = asked.text("path")
    with session.workspace.beside(name, asked.text("text")) as path:
        try:
            return _described(path)
        except HaptidError as error:
            said = str(error).replace(str(path), name).replace(path.name, name)
            return {"error": said, "where": error.where if isinstance(error.where, tuple) else None}


def _imported_text(session: Session, asked: Asked) -> dict[str, Any]:
    """A robot description as the text of a device file; nothing is written."""
    from haptid.robot_files import import_robot

    name, stem = asked.text("name"), Path(asked.text("name")).stem
    session.workspace.check_name(name, *_DESCRIPTIONS)
    with tempfile.TemporaryDirectory(prefix="haptid-import-") as folder:
        path = Path(folder) / name
        path.write_text(asked.text("text"), encoding="utf-8", errors="backslashreplace")
        try:
            made = import_robot(path)
        except HaptidError as error:
            raise WorkbenchError(str(error).replace(str(path), name), where=name) from error
    notes = [{"grade": note.grade, "text": note.text, "line": note.line} for note in made.notes]
    place = free_name(session.workspace.folder / DEVICES, f"{stem}.toml")
    command = shlex.join(["haptid", "import", name, "--out", f"{DEVICES}/{place.name}"])
    said = (
        f"Torques at {made.check.states} random states differ from the description's by "
        f"{made.check.torque:.1e} of the greatest."
    )
    text = made.text.replace(str(path), name)
    return {"text": text, "path": f"{DEVICES}/{place.name}", "notes": notes, "check": said, "command": command}


def _shipped_device(_session: Session, asked: Asked) -> dict[str, str]:
    """The text of a shipped device."""
    return {"text": shipped_text(asked.text("name"))}


def shipped_text(name: str) -> str:
    """The file of a shipped device.

    Raises:
        UnknownNameError: there is none of that name.
    """
    from haptid.device import shipped_devices
    from haptid.errors import index_of

    index_of(name, shipped_devices(), "shipped device")
    return (files("haptid.device") / "library" / f"{name}.toml").read_text(encoding="utf-8")


def _shipped(_session: Session, _asked: Asked) -> list[dict[str, str]]:
    import tomllib

    found = []
    for entry in sorted((files("haptid.device") / "library").iterdir(), key=lambda one: one.name):
        if entry.name.endswith(".toml"):
            values = tomllib.loads(entry.read_text(encoding="utf-8"))
            description = str(values.get("description", ""))
            found.append({"name": entry.name.removesuffix(".toml"), "description": description})
    return found


def _described(path: Any) -> dict[str, Any]:
    """The device of a file: tables, base parameters, and the drawing with its sliders."""
    from haptid.device import read_device
    from haptid.device.toml.summary import summary_tables
    from haptid.dynamics.model import DynamicModel
    from haptid.report.page import page_parts
    from haptid.report.sections.mechanism import MechanismSection

    device = read_device(path)
    model = DynamicModel(device)
    base = model.base
    return {
        "name": device.name,
        "about": [text for text in (device.description, device.source) if text],
        "tables": [asdict(table) for table in summary_tables(device)],
        "notes": list(device.notes),
        "count": len(base),
        "standard": len(base.standard),
        "base": [
            {"name": name, "unit": unit, "grouping": grouping}
            for name, unit, grouping in zip(base.names, base.units, base.groupings, strict=True)
        ],
        "no_effect": list(base.no_effect),
        "loops": list(device.closure.relations),
        **page_parts((MechanismSection.undriven(model),)),
    }


DEVICE_CALLS = PageCalls(
    reads={"shipped": _shipped, "shipped/{name}": _shipped_device},
    changes={"device/check": _checked_text, "import": _imported_text},
)
