"""read_device: a device file as a Device, with every name resolved and every number checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from haptid._internal.arrays import Array
from haptid._internal.bounded_files import DEFINITION_FILE, read_bounded
from haptid._internal.late import dataclass
from haptid._internal.toml_tables import Syntax, toml_values
from haptid.device.collision import read_shapes
from haptid.device.device import Device, TorqueRows
from haptid.device.elastic import elastic_motors, with_link_drives, with_rotors
from haptid.device.expressions import RESERVED
from haptid.device.geometry import Reader, frame_on
from haptid.device.loops.chain import Chain
from haptid.device.loops.cut_joint import CutJoint, cut_joints
from haptid.device.loops.formula import AnyClosure
from haptid.device.loops.from_toml import Loops, active_joints, close, read_loops
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parameters import (
    INERTIAL,
    INERTIAL_UNITS,
    StandardParameters,
    Symmetry,
    raw_names,
    read_combinations,
    standard_parameters,
    unsigned,
)
from haptid.device.parts import Gimbal, Handle, Joint, Motor
from haptid.device.priors import read_priors, unused_priors
from haptid.device.terms.build import TermTargets, read_coordinates, read_terms
from haptid.device.terms.term import TermColumn
from haptid.device.toml.ball_joints import with_revolute_joints
from haptid.device.toml.errors_at import Place, first_error
from haptid.device.toml.schema import CONVENTIONS, AnyDevice, AnyJoint, MirrorTable, SymmetryTable
from haptid.device.toml.transmission import free_joints, read_distribution, read_drives, torque_rows, without_rows
from haptid.errors import DeviceFileError, suggestion

# Name of the fixed link.
BASE = "base"


# How loops are closed, from the joints and which are active; and notes.
LoopClosing = Callable[[Sequence[Joint], tuple[int, ...], Loops], tuple[AnyClosure, tuple[str, ...]]]


def read_device(path: str | Path) -> Device:
    """Read a device from a TOML file, or a device that comes with haptid by its name.

    Args:
        path: of the file; a name without suffix that is no file is a shipped device, such as "staubli_tx40".

    Raises:
        DeviceFileError: file, key, what was found and what to write instead.
        LoopClosureError: loops do not close at the start pose.
    """
    return device_of(*read_tables(path))


def shipped_devices() -> tuple[str, ...]:
    """Names of the devices that come with haptid."""
    folder = files("haptid.device") / "library"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def read_tables(path: str | Path) -> tuple[AnyDevice, str]:
    """The checked tables of a device file, or of a shipped device by name; and the name of the file in errors."""
    file, data = file_values(path)
    return checked_tables(data, file)


def file_values(path: str | Path) -> tuple[str, dict[str, Any]]:
    """The name of a TOML file in errors, and its values; also of a shipped device by name."""
    file, content = _content(path)
    return file, _parsed(file, content)


def file_text(path: str | Path) -> tuple[str, str]:
    """The name of a TOML file in errors, and its text, which is UTF-8; also of a shipped device by name."""
    file, content = _content(path)
    return file, _decoded(file, content)


def checked_tables(data: dict[str, Any], file: str) -> tuple[AnyDevice, str]:
    """The checked tables of the data of a device file, and the name of the file in errors.

    Raises:
        DeviceFileError: a key is missing, unknown or has a wrong value.
    """
    convention = data.get("convention", "modified-dh")
    if not isinstance(convention, str) or convention not in CONVENTIONS:
        names = ", ".join(repr(name) for name in CONVENTIONS)
        raise Place(file, "convention").error(f"found {convention!r}", f"Write one of {names}.")
    try:
        return CONVENTIONS[convention].model_validate(data), file
    except ValidationError as error:
        raise first_error(error, file, data, CONVENTIONS[convention]) from None


def _content(path: str | Path) -> tuple[str, bytes]:
    if "\0" in str(path):
        raise _file_error(repr(str(path)), "has a zero byte in it", "Give the path of a device's TOML file.")
    source = Path(path)
    if isinstance(path, str) and not source.exists() and not source.suffix and "/" not in path:
        if path not in shipped_devices():
            found = "there is no such file, nor a shipped device of that name"
            raise _file_error(path, found, suggestion(path, shipped_devices()))
        return path, (files("haptid.device") / "library" / f"{path}.toml").read_bytes()
    try:
        return str(path), read_bounded(source, DEFINITION_FILE)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise _file_error(path, f"cannot be opened ({reason})", "Give the path of a device's TOML file.") from None


def _decoded(file: str, content: bytes) -> str:
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        found = f"byte {error.start} is not UTF-8 text"
        raise _file_error(file, found, "Save the file as UTF-8 in your editor.") from None


def _parsed(file: str, content: bytes) -> dict[str, Any]:
    text = _decoded(file, content)
    try:
        return toml_values(text)
    except (ValueError, RecursionError) as error:
        syntax = Syntax.of(error, text)
        raise DeviceFileError(
            f"{file}, line {syntax.line}, column {syntax.column}: not TOML: {syntax.found}, in `{syntax.text}`.",
            where=(syntax.line, syntax.column),
            found=syntax.text,
            advice="Correct this line; texts and expressions need double quotes.",
        ) from None


def _file_error(path: str | Path, found: str, advice: str) -> DeviceFileError:
    return Place(str(path)).error(found, advice)


def keeping(device: Device, names: Sequence[str]) -> Device:
    """The same device with these parameters preferred as independent columns, replacing those of its file.

    Raises:
        DeviceFileError: no free standard parameter of that name.
    """
    table = device.tables.base_parameters.model_copy(update={"keep": list(names)})
    tables = device.tables.model_copy(update={"base_parameters": table})
    return device_of(tables, device.name).with_gravity(device.gravity)


def device_of(tables: AnyDevice, file: str, closing: LoopClosing = close) -> Device:
    """The device of checked tables; `file` is its name in errors, `closing` closes its loops.

    Raises:
        DeviceError: see `read_device`.
    """
    place = Place(file)
    tables, reader, base, joints, loops = _geometry(tables, place)
    moving = _moving(tables, reader, joints, loops, closing, place)
    joints, terms = moving.joints, moving.terms
    symmetry = _symmetry(tables.symmetry, joints, terms, place)
    parameters = standard_parameters([j.name for j in joints], [j.body for j in joints], terms, symmetry)
    prior = read_priors(tables, joints, parameters.raw, reader, place)
    return Device(
        name=tables.name,
        description=tables.description,
        source=tables.source,
        convention=tables.convention,
        gravity=np.array(reader.triple(tables.gravity, place.at("gravity"))),
        joints=joints,
        active=moving.active,
        closure=moving.closure,
        drives=moving.drives,
        torque_rows=moving.torque_rows,
        terms=terms,
        parameters=parameters,
        symmetry=symmetry,
        lengths=reader.lengths,
        handle=_handle(tables, joints, base, reader, place.at("handle")),
        gimbal=_gimbal(tables, reader, place.at("gimbal")),
        prior=prior,
        keep=_keep(tables, parameters, place.at("base_parameters")),
        base_tolerance=_tolerance(tables, reader, place.at("base_parameters", "tolerance")),
        targets=read_combinations(tables, parameters, reader, place),
        notes=(
            *parameters.leaving,
            *moving.notes,
            *without_rows(moving.drives),
            *unused_priors(prior, parameters.index),
        ),
        tables=tables,
        cut_joints=moving.cut_joints,
        collision=read_shapes(tables.collision, joints, base, reader, place.at("collision")),
        distribution=read_distribution(
            tables.transmission, moving.drives, joints, moving.active, reader, place.at("transmission")
        ),
    )


def reclosed(device: Device, tables: AnyDevice, closing: LoopClosing) -> Device:
    """A device with other loops, as these tables and `closing` have them; joints, bodies and parameters stay.

    Raises:
        DeviceError: see `read_device`.
    """
    place, reader, joints = Place(device.name), Reader(device.lengths), device.joints[: len(tables.joints)]
    base = reader.placement(tables.base, place.at("base"))
    loops = read_loops(tables.loops, joints, base, reader, place.at("loops"))
    moving = _moving(tables, reader, joints, loops, closing, place)
    parts = {part.name: getattr(moving, part.name) for part in fields(moving) if part.name != "notes"}
    return replace(device, tables=tables, distribution=None, **parts)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Joints, loops and what acts on them, as the attributes of a device."""

    joints: tuple[Joint, ...]
    active: tuple[int, ...]
    closure: AnyClosure
    notes: tuple[str, ...]
    drives: tuple[Motor, ...]
    torque_rows: TorqueRows
    cut_joints: tuple[CutJoint, ...]
    terms: tuple[TermColumn, ...]


def _moving(
    tables: AnyDevice, reader: Reader, joints: tuple[Joint, ...], loops: Loops, closing: LoopClosing, place: Place
) -> _Moving:
    active = active_joints(joints, [table.active for table in tables.joints], loops, place.at("joints"))
    closure, notes = closing(joints, active, loops)
    free = free_joints(tables, active, place.at("joints"))
    drives = read_drives(tables.motors, joints, active, free, closure, reader, place.at("motors"))
    if elastic := elastic_motors(tables.terms, drives, place.at("terms")):
        joints, drives = with_rotors(joints, drives, elastic)
        active = (*active, *range(len(tables.joints), len(joints)))
        closure, notes = closing(joints, active, loops)
        drives = with_link_drives(joints, active, drives, closure, elastic)
    rows = torque_rows(tables.transmission, drives, active, place.at("transmission"))
    cuts = cut_joints(joints, active, closure, place.at("loops"))
    sums = read_coordinates(tables.coordinates, joints, reader, place.at("coordinates"))
    targets = TermTargets.of(joints, active, drives, rows == "joint", closure, cuts, sums)
    terms = read_terms(tables.terms, targets, reader, place.at("terms"))
    return _Moving(joints, active, closure, notes, drives, rows, cuts, terms)


def resized(device: Device, lengths: Mapping[str, float]) -> Device:
    """A device whose loops are not linear, with other named lengths; relations of its linear loops stay as they are.

    Args:
        lengths: new values of some named lengths, m; those written as formulas of them follow.

    Raises:
        LoopClosureError, SingularityError: at the start pose the loops do not close any more, or are singular.
    """
    assert isinstance(device.closure, NewtonClosure)
    changed = device.tables.model_copy(update={"lengths": {**device.tables.lengths, **lengths}})
    tables, reader, _, joints, loops = _geometry(changed, Place(device.name))
    joints = (*joints, *device.joints[len(joints) :])  # rotors of elastic motors
    closure = device.closure.moved_to(Chain.of(joints, loops.cuts, device.active))
    return replace(device, joints=joints, closure=closure, lengths=reader.lengths, tables=tables)


def _geometry(tables: AnyDevice, place: Place) -> tuple[AnyDevice, Reader, Array, tuple[Joint, ...], Loops]:
    """Tables with revolute joints only, the reader of their numbers, the base, the joints and the loops."""
    reader = Reader(_lengths(tables, place))
    tables = with_revolute_joints(tables, reader, place.at("joints"))
    base = reader.placement(tables.base, place.at("base"))
    joints = _joints(tables.joints, base, reader, place.at("joints"))
    return tables, reader, base, joints, read_loops(tables.loops, joints, base, reader, place.at("loops"))


def _lengths(tables: AnyDevice, place: Place) -> dict[str, float]:
    """Named lengths; each may use those above it."""
    meaning_of = dict.fromkeys(RESERVED, "arithmetic")
    meaning_of |= {
        prefix + j.name: f"the motion of joint {j.name}" for j in tables.joints for prefix in ("q", "q_", "v_", "a_")
    }
    lengths: dict[str, float] = {}
    for name, value in tables.lengths.items():
        length_place = place.at("lengths", name)
        if name in meaning_of:
            raise length_place.taken("name", name, meaning_of[name])
        lengths[name] = Reader(lengths).number(value, length_place)
    return lengths


def _joints(tables: Sequence[AnyJoint], base: Array, reader: Reader, place: Place) -> tuple[Joint, ...]:
    parents = _parents(tables, place)
    joints: list[Joint] = []
    frames: list[Array] = []
    for k, (table, parent) in enumerate(zip(tables, parents, strict=True)):
        placement, frame = reader.joint(table, place.at(k))
        placement = (base if parent < 0 else frames[parent]) @ placement
        frames.append(frame)
        limits = {
            key: _limit(getattr(table.limits, key), reader, place.at(k, "limits", key))
            for key in ("velocity", "torque")
        }
        joints.append(
            Joint(
                name=table.name,
                parent=parent,
                prismatic=table.type == "prismatic",
                rotation=placement[:3, :3],
                translation=placement[:3, 3],
                body=table.body,
                position_limits=_position_limits(table.limits.position, reader, place.at(k, "limits", "position")),
                velocity_limit=limits["velocity"],
                torque_limit=limits["torque"],
                frame_rotation=frame[:3, :3],
                frame_translation=frame[:3, 3],
                alias=table.alias or "",
            )
        )
    return tuple(joints)


def _parents(tables: Sequence[AnyJoint], place: Place) -> list[int]:
    """Index of each joint's parent, -1 for the base; by default the joint declared before it."""
    names = [table.name for table in tables]
    for k, name in enumerate(names):
        if name in names[:k] or name == BASE:
            first = "the base" if name == BASE else str(place.at(names.index(name)))
            raise place.at(k, "name").taken("joint", name, first)
    named = [table.parent or (names[k - 1] if k else BASE) for k, table in enumerate(tables)]
    _refuse_cycles(names, named, place)
    parents: list[int] = []
    for k, parent in enumerate(named):
        if parent != BASE and parent not in names[:k]:
            known = (BASE, *names[:k])
            if parent in names:
                found = f'its parent "{parent}" is declared further down'
                advice = f'Move it above joint "{names[k]}".'
            else:
                found, advice = f'no joint declared above it is named "{parent}"', suggestion(parent, known)
            raise place.at(k, "parent").error(f'joint "{names[k]}" has no parent yet: {found}', advice)
        parents.append(-1 if parent == BASE else names.index(parent))
    return parents


def _refuse_cycles(names: list[str], parents: list[str], place: Place) -> None:
    above = dict(zip(names, parents, strict=True))
    for start in names:
        trail = [start]
        while (parent := above.get(trail[-1])) is not None:
            if parent in trail:
                ring = trail[trail.index(parent) :]
                raise place.at(names.index(ring[-1]), "parent").error(
                    f"these joints are each other's ancestors: {' -> '.join([*ring, parent])}",
                    "Make the base or a joint outside the ring the parent of one of them, and close the ring with "
                    "[[loops]] and a cut joint.",
                )
            trail.append(parent)


def _position_limits(values: Sequence[float | str] | None, reader: Reader, place: Place) -> tuple[float, float] | None:
    if values is None:
        return None
    low, high = (reader.number(value, place.at(k)) for k, value in enumerate(values))
    if low >= high:
        raise place.error(f"found [{low:g}, {high:g}]", "Write the lower limit first, below the upper.")
    return low, high


def _limit(value: float | str | None, reader: Reader, place: Place) -> float | None:
    return None if value is None else reader.positive(value, place)


def _symmetry(
    tables: Sequence[SymmetryTable], joints: Sequence[Joint], terms: Sequence[TermColumn], place: Place
) -> tuple[Symmetry, ...]:
    names = [joint.name for joint in joints]
    raw = raw_names(names, terms)
    units = dict(zip(raw[10 * len(joints) :], (term.unit for term in terms), strict=True))
    for k, name in enumerate(raw):
        if name in raw[:k]:
            first = f"{raw.index(name) + 1}. of the standard parameters"
            raise place.at("terms").taken("parameter", name, f"the {first}; set prefix or name")
    return tuple(_rule(table, names, raw, units, place.at("symmetry", k)) for k, table in enumerate(tables))


def _rule(
    table: SymmetryTable, links: list[str], raw: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Symmetry:
    zero, equal = list(table.zero), [tuple(group) for group in table.equal]
    named = [(name, place.at("zero", k)) for k, name in enumerate(zero)]
    named += [
        (unsigned(name)[0], place.at("equal", k, i)) for k, group in enumerate(equal) for i, name in enumerate(group)
    ]
    for name, rule_place in named:
        if name not in raw:
            raise rule_place.unknown("parameter", name, raw)
    for k, group in enumerate(equal):
        kinds = {_unit(unsigned(name)[0], raw, units) for name in group}
        if len(kinds) > 1:
            raise place.at("equal", k).error(
                f"{' and '.join(group)} have units {', '.join(sorted(kinds))}", "Equate like with like."
            )
    linked = [(name, place.at("identical", k)) for k, name in enumerate(table.identical)]
    linked += [(table.about.link, place.at("about", "link"))] if table.about else []
    if table.mirror:
        linked += [(table.mirror.link, place.at("mirror", "link")), (table.mirror.of, place.at("mirror", "of"))]
    for name, rule_place in linked:
        if name not in links:
            raise rule_place.unknown("link", name, links)
    if table.about:
        across = [axis for axis in "XYZ" if axis != table.about.axis.upper()]
        zero += [kind + table.about.link for kind in ("XY", "XZ", "YZ", *(f"M{axis}" for axis in across))]
        equal.append(tuple(axis + axis + table.about.link for axis in across))
    if len(table.identical) > 1:
        equal += [tuple(kind + link for link in table.identical) for kind in INERTIAL]
    if table.mirror:
        equal += _mirrored(table.mirror, place.at("mirror"))
    if not zero and not equal:
        raise place.error("this symmetry says nothing", "Add zero, equal, about, identical or mirror.")
    return Symmetry(table.reason, tuple(zero), tuple(equal))


def _mirrored(table: MirrorTable, place: Place) -> list[tuple[str, str]]:
    """Equalities of the ten parameters of a body and of its image: r' = P r, J' = P J P', with P the signed axes."""
    letters = [axis[-1].upper() for axis in table.axes]
    if sorted(letters) != ["X", "Y", "Z"] or table.link == table.of:
        found = "names an axis twice" if sorted(letters) != ["X", "Y", "Z"] else "mirrors a link in itself"
        raise place.error(f"it {found}", 'Name two links, and three axes such as ["x", "-y", "z"].')
    image = {new: (axis[-1].upper(), axis[0] == "-") for new, axis in zip("XYZ", table.axes, strict=True)}
    mirrored = []
    for kind in INERTIAL:
        axes = [image[letter] for letter in kind.removeprefix("M")]
        old = kind[: len(kind) - len(axes)] + "".join(sorted(letter for letter, _ in axes))
        minus = sum(flipped for _, flipped in axes) % 2 == 1
        mirrored.append((old + table.of, ("-" if minus else "") + kind + table.link))
    return mirrored


def _unit(name: str, raw: tuple[str, ...], units: Mapping[str, str]) -> str:
    return units.get(name) or INERTIAL_UNITS[raw.index(name) % 10]


def _handle(tables: AnyDevice, joints: Sequence[Joint], base: Array, reader: Reader, place: Place) -> Handle | None:
    if tables.handle is None:
        return None
    names = [joint.name for joint in joints]
    if tables.handle.link not in names:
        raise place.at("link").unknown("link", tables.handle.link, names)
    frame = frame_on(joints, names.index(tables.handle.link), reader.placement(tables.handle, place), base)
    return Handle(frame.link, frame.rotation, frame.translation)


def _gimbal(tables: AnyDevice, reader: Reader, place: Place) -> Gimbal | None:
    """The gimbal, its numbers positive or zero."""
    table = tables.gimbal
    if table is None:
        return None
    if tables.handle is None:
        raise place.error("a gimbal hangs on the handle, and there is none", "Add [handle] with its link and xyz.")

    def number(key: str, least: float, otherwise: float = 0.0) -> float:
        value = getattr(table, key)
        value_read = otherwise if value is None else reader.number(value, place.at(key))
        if value_read < least:
            raise place.at(key).error(f"is {value_read:g}, below {least:g}", "Write the physical value.")
        return value_read

    mass, radius = number("mass", 0.0), number("com_radius", 0.0)
    inertia = number("inertia", mass * radius**2, mass * radius**2)
    if (table.rate is None) == (table.state == "free"):
        wanted = "Give `rate` for a free gimbal, and for no other."
        raise place.at("rate").error(f"a {table.state} gimbal has {'no' if table.rate is None else 'a'} rate", wanted)
    swing, rate = number("swing", 0.0, 0.5), number("rate", 0.0)
    return Gimbal(table.state, mass, radius, inertia, number("friction", 0.0), swing, rate)


def _keep(tables: AnyDevice, parameters: StandardParameters, place: Place) -> tuple[str, ...]:
    """Names of the free parameters to keep; one that represents several may be named by any of them."""
    for k, name in enumerate(tables.base_parameters.keep):
        if name not in parameters.index:
            raise place.at("keep", k).unknown("free parameter", name, parameters.index)
    return tuple(parameters.names[parameters.index[name]] for name in tables.base_parameters.keep)


def _tolerance(tables: AnyDevice, reader: Reader, place: Place) -> float:
    tolerance = reader.number(tables.base_parameters.tolerance, place)
    if not 0 < tolerance < 1:
        raise place.error(f"found {tolerance:g}", "Write a number between 0 and 1, such as 1e-9.")
    return tolerance
