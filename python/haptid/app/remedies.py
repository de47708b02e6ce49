"""Remedies of a study's logs: changes of the study's text with which a log that is refused can be read.

Each is tried on the log before it is offered, so that a button does what it says.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid._internal.toml_edit import TomlEditError, with_value
from haptid.app.answers import Asked
from haptid.errors import HaptidError

if TYPE_CHECKING:
    from haptid.app.pages import Session

_Calls = dict[str, Callable[[Asked], Any]]
# Changes of a text: keys and value of each.
_Edits = tuple[tuple[tuple[str | int, ...], Any], ...]
# Channels of a kind that are exchanged in pairs; bytes of a log that is read again for every remedy; left out around a
# time, s.
_MOST_CHANNELS, _LARGEST, _AROUND = 10, 64 * 2**20, 0.05
_UNITS = {"rad": ("deg",), "deg": ("rad",), "m": ("mm",), "mm": ("m",)}


def remedy_changes(session: Session) -> _Calls:
    """Calls of remedies; nothing is written."""

    def remedies(asked: Asked) -> dict[str, Any]:
        """What is said of each log of a study's text, and what would mend it."""
        name, text = asked.text("path"), asked.text("text")

        def read(changed: str) -> list[tuple[str, list[str], HaptidError | None]]:
            with session.workspace.beside(name, changed) as path:
                return list(_read(path))

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

    return {"study/remedies": remedies}


def _read(path: Path) -> Iterator[tuple[str, list[str], HaptidError | None]]:
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
        ranges = [*values.get("logs", [{}])[k].get("exclude", []), [round(at - _AROUND, 6), round(at + _AROUND, 6)]]
        yield f"Leave out {at - _AROUND:.3f} to {at + _AROUND:.3f} s", ((("logs", k, "exclude"), ranges),)
    for kind in ("position", "torque"):
        yield f"A {kind} may be constant", ((("channels", kind, "constant_ok"), True),)
    yield "Torques may stay at their limit", ((("channels", "torque", "allow_saturation"), True),)


def _time(error: HaptidError) -> float | None:
    """The time that an error is about, s."""
    where = error.where if isinstance(error.where, tuple) else (error.where,)
    return next((float(part) for part in where if isinstance(part, float)), None)
