"""Edits: the changes of a study or device file that carry an action out, as plain data; and the files with them."""

from __future__ import annotations

import copy
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from haptid._internal.late import dataclass
from haptid.advice.columns import POWERS_OF_POSITION
from haptid.advice.contact import BY_RESIDUAL
from haptid.advice.recorder import faults
from haptid.advice.search import Proven, Trials, TriedChange
from haptid.device import Device
from haptid.device.toml.reader import checked_tables, file_text
from haptid.device.toml.terms import PlainTerm
from haptid.errors import OutputFolderError
from haptid.motion.treatment import Treatment
from haptid.observation.geometry_slopes import horizontal_axes
from haptid.study import Study
from haptid.study.identify import Identification
from haptid.study.read import read_study

# Kinds that are a term of a device file by themselves.
_TERMS = {
    "coulomb": "coulomb",
    "viscous": "viscous",
    "offset": "offset",
    "stribeck": "stribeck",
    "presliding": "dahl",
    "spring": "spring",
    "load friction": "load-friction",
    "rotor inertia": "rotor-inertia",
}
# Custom columns by kind: stem of the name, unit over the torque's, and expression of position x and velocity v.
_CUSTOM = {
    "viscosity by direction": (("FA", "*s/", "abs({v})"),),
    "bent viscosity": (("FQ", "*s^2/", "({v})*abs({v})"),),
    "degressive friction": (("FD", "", "sign({v})*(1 - exp(-(({v})/{s})**2))"),),
    "torque by position": tuple((f"KP{n}", f"/^{n}", f"({{x}})**{n}") for n in (1, *POWERS_OF_POSITION)),
    "ripple": (("RS", "", "sin({w}*({x}))"), ("RC", "", "cos({w}*({x}))")),
}


@dataclass(frozen=True)
class Edit:
    """One change of a file.

    Attributes:
        file: which file.
        operation: append to a list, set, add to a number, multiply it, exchange two channels (of positions with their
            velocities), exclude ranges of time, or remove a log.
        path: keys from the top of the file; "channels" is every table of channels, "logs" are those of the fit, "all
            logs" all of them.
        value: what is appended, set, added, multiplied by; indices of the entries; ranges, s.
        index: entry of a list of numbers, one for each channel; None for all.
    """

    file: Literal["study", "device"]
    operation: Literal["append", "set", "add", "multiply", "exchange", "exclude", "remove"]
    path: tuple[str | int, ...]
    value: Any
    index: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return {
            "file": self.file,
            "operation": self.operation,
            "path": list(self.path),
            "index": self.index,
            "value": self.value,
        }


def edits_of(search: Trials, found: Proven, treatment: Treatment) -> tuple[Edit, ...]:
    """The edits that carry out a proven candidate; none where files cannot say it."""
    return tuple(_edits(search, found, treatment))


def _edits(search: Trials, found: Proven, treatment: Treatment) -> Iterator[Edit]:
    one, device, values = found.candidate, search.model.device, found.values
    match one.kind:
        case kind if kind in _TERMS or kind in _CUSTOM:
            for place, settings in zip(one.places, found.settings, strict=True):
                yield from (
                    Edit("device", "append", ("terms",), table) for table in _terms(device, kind, place, settings)
                )
        case "gain" | "torque sign" as kind:
            factor = -1.0 if kind == "torque sign" else 1.0 / float(found.trial.whole.factors[one.indices[0]])
            yield from gain_edits(search, one.indices[0], factor)
        case "torque swap":
            yield Edit("study", "exchange", ("channels", "torque"), [search.torques.of(k) for k in one.indices])
        case "position swap":
            yield Edit("study", "exchange", ("channels", "position"), list(one.indices))
        case "position unit":
            yield Edit("study", "set", ("channels", "position", "unit"), one.places[0].split()[0])
        case "position sign":
            for key in ("gain", "offset"):
                yield Edit("study", "multiply", ("channels", "position", key), -1.0, one.indices[0])
        case "time shift" if not one.seconds:
            now = np.broadcast_to(treatment.torque_delay_s, search.motions[0].tau.shape[1]).astype(float)
            for k, value in zip(one.indices, values, strict=True):
                now[search.torques.of(k)] += float(value[0])
            yield Edit("study", "set", ("treatment", "torque_delay_s"), [float(f"{d:.5g}") for d in now])
        case "common delay" | "time shift":
            now = np.array(np.atleast_1d(treatment.torque_delay_s), dtype=float)
            if one.kind == "time shift":
                now = np.broadcast_to(now, search.motions[0].tau.shape[1]).copy()
                now[search.torques.of(one.indices[0])] += one.seconds
            else:
                now += one.seconds
            delays = [float(f"{d:.5g}") for d in now]
            yield Edit("study", "set", ("treatment", "torque_delay_s"), delays if len(delays) > 1 else delays[0])
        case "zero offset":
            log = search.motions[0].log
            if log is not None and log.channels.position.side == "joint":
                shift = float(f"{values[0][0]:.5g}")
                yield Edit("study", "add", ("channels", "position", "offset"), shift, one.indices[0])
        case "length":
            if one.geometry is not None:
                yield Edit("device", "add", one.geometry.key, float(f"{values[0][0]:.5g}"))
        case "gravity direction":
            down = np.asarray(device.gravity)
            axes = [axis for _, axis in horizontal_axes(search.model)]
            tilt = sum(float(v[0]) * axes[k] for k, v in zip(one.indices, values, strict=True))
            there = down + np.linalg.norm(down) * tilt
            there = there * np.linalg.norm(down) / np.linalg.norm(there)
            yield Edit("device", "set", ("gravity",), [float(f"{x:.6g}") for x in there])
        case kind if kind in ("clipped torque", "stuck position", "slip", "limit cycle", *BY_RESIDUAL):
            for number, ranges in excluded(search, found).items():
                yield Edit("study", "exclude", ("logs", number), ranges)
        case "other log":
            yield Edit("study", "remove", ("logs", one.indices[0]), one.places[0])


def elastic_edits(device: Device, motors: Sequence[str]) -> Iterator[Edit]:
    """Terms that put motors behind springs, and give their rotors the inertia that they need then."""
    inert = set[str]()
    for term in device.tables.terms:
        if isinstance(term, PlainTerm) and term.kind == "rotor-inertia" and term.motors is not None:
            inert |= {motor.name for motor in device.motors} if term.motors == "all" else set(term.motors)
    tables: list[dict[str, Any]] = [{"kind": "elastic", "motors": list(motors)}]
    if bare := [name for name in motors if name not in inert]:
        tables.insert(0, {"kind": "rotor-inertia", "motors": bare, "prefix": "IROTOR"})
    yield from (Edit("device", "append", ("terms",), table) for table in tables)


def gain_edits(search: Trials, motor: int, factor: float) -> Iterator[Edit]:
    """The edit that multiplies the torque channel of a motor, by number; none where it has none of its own."""
    channel = search.torques.of(motor)
    if channel is not None:
        yield Edit("study", "multiply", ("channels", "torque", "gain"), float(f"{factor:.6g}"), channel)


def excluded(search: Trials, found: Proven) -> dict[int, list[list[float]]]:
    """Ranges of time, s, that a fault, a contact, slip or a limit cycle spoils, by log of the fit."""
    made: dict[int, list[list[float]]] = {}
    if found.candidate.kind in BY_RESIDUAL:
        flagged = search.contact
        for k in np.unique(search.rows.log[flagged]):
            made[int(k)] = _ranges(search.rows.t, flagged & (search.rows.log == k))
        return made
    for part in search.spoiled:
        log = search.motions[part.log].log
        if part.kind == found.candidate.kind and part.log in found.candidate.indices and log is not None:
            made[part.log] = _ranges(np.asarray(log.t), part.samples)
    for k, fault in search.faults:
        log = search.motions[k].log
        places = set(search.places_of(fault)) & set(found.candidate.indices)
        if fault.kind == found.candidate.kind and places and log is not None:
            made[k] = _ranges(np.asarray(log.t), fault.samples)
    return made


def edits_in_validation_logs(found: Identification, one: TriedChange) -> Iterator[Edit]:
    """Edits that leave out of validation logs what the same fault of a channel spoils there, which is no error of a
    model; none of what only a model shows, as a contact."""
    for number, run in enumerate(found.runs):
        log = run.motion.log
        if run.entry.role != "validate" or log is None or one.fault is None:
            continue
        for fault in faults(log):
            same = (fault.kind, fault.channel) == (one.fault.kind, one.fault.channel)
            if same and fault.kind in ("stuck position", "clipped torque"):
                ranges = _ranges(np.asarray(log.t), fault.samples)
                yield Edit("study", "exclude", ("all logs", number), ranges)


def _ranges(t: np.ndarray, true: np.ndarray) -> list[list[float]]:
    """First and last time of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], true.astype(int), [0]]))).reshape(-1, 2)
    return [[float(f"{t[a]:.6g}"), float(f"{t[b - 1]:.6g}")] for a, b in edges]


def _terms(device: Device, kind: str, place: str, settings: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Tables of [[terms]] for one coordinate."""
    what, name = place.split(" ", 1)
    on = {"motors" if what == "motor" else "joints": [name]}
    if kind in _TERMS:
        yield {"kind": _TERMS[kind], **on, **{key: float(f"{value:.5g}") for key, value in settings.items()}}
        return
    x, v, unit, torque = _coordinate(device, what, name)
    w = f"{2 * np.pi / settings['period']:.6g}" if "period" in settings else ""
    s = f"{settings['velocity']:.5g}" if "velocity" in settings else ""
    for stem, per, expression in _CUSTOM[kind]:
        made = torque + (per + unit if per and not per.startswith("/^") else f"/{unit}{per[1:]}" if per else "")
        yield {
            "kind": "custom",
            **on,
            "name": _free_name(device, stem, name),
            "unit": made,
            "expression": expression.format(x=x, v=v, w=w, s=s),
        }


def _free_name(device: Device, stem: str, name: str) -> str:
    """Name of a custom column that no parameter has: FD_1, or FD2_1 beside that."""
    names = [f"{stem}_{name}", *(f"{stem}{k}_{name}" for k in range(2, len(device.parameters.names) + 3))]
    return next(one for one in names if one not in device.parameters.names)


def _coordinate(device: Device, what: str, name: str) -> tuple[str, str, str, str]:
    """Position and velocity of a joint or motor coordinate as expressions, its unit and that of its torque."""
    if what != "motor":
        joint = next((j for j in device.joints if j.name == name), None)
        unit = "m" if joint is not None and joint.prismatic else "rad"
        return f"q_{name}", f"v_{name}", unit, "N" if unit == "m" else "N*m"
    drive = next(d for d in device.drives if d.name == name)
    parts = [(w, n) for w, n in zip(drive.row.tolist(), device.joint_names, strict=True) if w]
    unit = "m" if device.joints[drive.first].prismatic else "rad"

    def combined(symbol: str) -> str:
        return " + ".join(f"{symbol}_{n}" if w == 1 else f"({w!r})*{symbol}_{n}" for w, n in parts)

    return combined("q"), combined("v"), unit, "N" if unit == "m" else "N*m"


def written(study: Study, data: Path | None, edits: Sequence[Edit], out: Path, title: str = "") -> Path:
    """Write study and device files with the edits into a folder; returns the path of the study file.

    What is not edited stays as it is written, comments too. Paths of logs are relative to the new study. The device
    file is written where it is edited, or is a file.

    Raises:
        OutputFolderError: the folder cannot be written, or holds the study or its device file themselves.
    """
    from haptid._internal.toml_edit import rewritten  # only this needs a TOML library that keeps comments

    for own, name in ((study.path, "study.toml"), (study.device, "device.toml")):
        if isinstance(own, Path) and (out / name).exists() and (out / name).samefile(own):
            raise OutputFolderError(
                f"{out / name} is what is to be changed; it would be overwritten.", where=out,
                advice="Choose another folder.",
            )  # fmt: skip
    study_text, (name, device_text) = study.path.read_text(encoding="utf-8"), file_text(study.device)
    plan, device = tomllib.loads(study_text), tomllib.loads(device_text)
    root = data or study.path.parent
    for log in plan["logs"]:
        log["path"] = os.path.relpath(root / log["path"], out)
    fitted = study.of_fit(range(len(study.logs)))
    gone: list[int] = []
    for edit in edits:
        if edit.file == "device":
            _apply(device, edit.path, edit)
        elif edit.operation == "remove":
            gone.append(fitted[int(edit.path[1])])
        elif edit.operation == "exclude":
            number = int(edit.path[1])
            log = plan["logs"][fitted[number] if edit.path[0] == "logs" else number]
            log["exclude"] = sorted([*log.get("exclude", []), *edit.value])
        elif edit.path[0] == "channels":
            for table in [plan, *plan["logs"]]:
                if edit.path[1] in table.get("channels", ()):
                    signal = table["channels"][edit.path[1]]
                    _apply(table, edit.path, edit, len(signal.get("channels") or signal.get("joints") or ()))
                    if edit.operation == "exchange" and edit.path[1] == "position" and "velocity" in table["channels"]:
                        _apply(table, ("channels", "velocity"), edit)
        else:
            _apply(plan, edit.path, edit)
    plan["logs"] = [log for k, log in enumerate(plan["logs"]) if k not in gone]
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(edit.file == "device" for edit in edits) or not isinstance(study.device, str):
            checked_tables(copy.deepcopy(device), name)
            plan["device"] = "device.toml"
            (out / "device.toml").write_text(_commented(rewritten(device_text, device), title), encoding="utf-8")
        path = out / "study.toml"
        path.write_text(_commented(rewritten(study_text, plan), title), encoding="utf-8")
    except OSError as error:
        raise OutputFolderError(
            f"cannot write into {out}: {error.strerror}.", where=out, advice="Choose a writable folder."
        ) from error
    read_study(path)
    return path


def _commented(text: str, title: str) -> str:
    return "".join(f"# {line}\n" for line in title.splitlines()) + text


def _apply(table: dict[str, Any], path: Sequence[str | int], edit: Edit, channels: int = 0) -> None:
    """Carry an edit out on parsed tables."""
    at: Any = table
    for key in path[:-1]:
        at = at.setdefault(key, {}) if isinstance(at, dict) else at[key]
    last = path[-1]
    match edit.operation:
        case "append":
            at.setdefault(last, []).append(edit.value)
        case "set":
            at[last] = edit.value
        case "exchange":
            i, j = edit.value
            for every in at[last].values():  # names, gains, units: one for each channel
                if isinstance(every, list):
                    every[i], every[j] = every[j], every[i]
        case "add" | "multiply":
            neutral = 1.0 if last == "gain" else 0.0
            now = at.get(last, neutral) if isinstance(at, dict) else at[last]
            if edit.index is None:
                at[last] = _combined(float(now), edit)
            else:
                every = list(now) if isinstance(now, list) else [now] * channels
                every[edit.index] = _combined(float(every[edit.index]), edit)
                at[last] = every


def _combined(now: float, edit: Edit) -> float:
    return now + float(edit.value) if edit.operation == "add" else now * float(edit.value)
