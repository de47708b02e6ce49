"""read_device: a device file to a Device, every name resolved and every number checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.combinations import read_combinations
from haptid.device.device import Device, Handle, Joint, Prior
from haptid.device.expressions import RESERVED
from haptid.device.geometry import Reader, frame_on
from haptid.device.loops.cut_joint import cut_joints
from haptid.device.loops.from_toml import active_joints, close, read_loops
from haptid.device.parameters import (
    INERTIAL,
    INERTIAL_UNITS,
    StandardParameters,
    Symmetry,
    raw_names,
    standard_parameters,
)
from haptid.device.priors import Body, body_prior, tensor
from haptid.device.terms.build import Targets, read_terms
from haptid.device.terms.term import TermColumn
from haptid.device.toml.place import Place
from haptid.device.toml.schema import AnyDevice, AnyJoint, PriorBodyTable, PriorTable, SymmetryTable
from haptid.device.toml.tables import read_tables
from haptid.device.toml.transmission import read_drives
from haptid.errors import (
    CycleError,
    DeviceValueError,
    DuplicateNameError,
    MissingParentError,
    UnknownDeviceNameError,
)

# Name of the fixed link.
BASE = "base"


def read_device(path: str | Path) -> Device:
    """Read a device from a TOML file, or a device that comes with haptid by its name.

    Args:
        path: of the file; a name without suffix that is no file is a shipped device, such as "staubli_tx40".

    Raises:
        DeviceError: in one of its kinds, naming file, key, what was found and what to write instead.
    """
    return device_of(*read_tables(path))


def keeping(device: Device, names: Sequence[str]) -> Device:
    """The same device, with these parameters preferred as base parameters in place of those of its file.

    Raises:
        UnknownDeviceNameError: no free standard parameter of that name.
    """
    table = device.tables.base_parameters.model_copy(update={"keep": list(names)})
    tables = device.tables.model_copy(update={"base_parameters": table})
    return device_of(tables, device.name).with_gravity(device.gravity)


def device_of(tables: AnyDevice, file: str) -> Device:
    """The device of checked tables; errors call its file by the name given.

    Raises:
        DeviceError: see `read_device`.
    """
    place = Place(file)
    reader = Reader(_lengths(tables, place))
    base = reader.placement(tables.base, place.at("base"))
    joints = _joints(tables.joints, base, reader, place.at("joints"))
    loops = read_loops(tables.loops, joints, base, reader, place.at("loops"))
    active = active_joints(joints, [table.active for table in tables.joints], loops, place.at("joints"))
    closure, notes = close(joints, active, loops)
    drives = read_drives(tables.motors, joints, active, reader, place.at("motors"))
    rows = tables.transmission.torque_rows
    cuts = cut_joints(joints, active, closure, place.at("loops"))
    targets = Targets.of(joints, active, drives, rows == "joint", closure, cuts)
    terms = read_terms(tables.terms, targets, reader, place.at("terms"))
    symmetry = _symmetry(tables.symmetry, joints, terms, place)
    parameters = standard_parameters([j.name for j in joints], [j.body for j in joints], terms, symmetry)
    prior = _prior(tables, joints, parameters.raw, reader, place)
    return Device(
        name=tables.name,
        description=tables.description,
        source=tables.source,
        convention=tables.convention,
        gravity=np.array(reader.triple(tables.gravity, place.at("gravity"))),
        joints=joints,
        active=active,
        closure=closure,
        drives=drives,
        torque_rows=rows,
        terms=terms,
        parameters=parameters,
        symmetry=symmetry,
        lengths=reader.lengths,
        handle=_handle(tables, joints, base, reader, place.at("handle")),
        prior=prior,
        keep=_keep(tables, parameters, place.at("base_parameters")),
        base_tolerance=_tolerance(tables, reader, place.at("base_parameters", "tolerance")),
        targets=read_combinations(tables, parameters, reader, place),
        notes=(
            *parameters.leaving,
            *notes,
            *_contradictions(prior, parameters.index),
        ),
        tables=tables,
        cut_joints=cuts,
    )


def _lengths(tables: AnyDevice, place: Place) -> dict[str, float]:
    """Named lengths, each of which may use those above it."""
    taken = dict.fromkeys(RESERVED, "arithmetic")
    taken |= {
        prefix + j.name: f"the motion of joint {j.name}" for j in tables.joints for prefix in ("q", "q_", "v_", "a_")
    }
    made: dict[str, float] = {}
    for name, value in tables.lengths.items():
        here = place.at("lengths", name)
        if name in taken:
            raise DuplicateNameError(str(here), "name", name, taken[name])
        made[name] = Reader(made).number(value, here)
    return made


def _joints(tables: Sequence[AnyJoint], base: Array, reader: Reader, place: Place) -> tuple[Joint, ...]:
    parents = _parents(tables, place)
    made: list[Joint] = []
    frames: list[Array] = []
    for k, (table, parent) in enumerate(zip(tables, parents, strict=True)):
        placement, frame = reader.joint(table, place.at(k))
        placement = (base if parent < 0 else frames[parent]) @ placement
        frames.append(frame)
        limits = {
            key: _limit(getattr(table.limits, key), reader, place.at(k, "limits", key))
            for key in ("velocity", "torque")
        }
        made.append(
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
            )
        )
    return tuple(made)


def _parents(tables: Sequence[AnyJoint], place: Place) -> list[int]:
    """Index of each joint's parent, -1 for the base; by default the joint declared before it."""
    names = [table.name for table in tables]
    for k, name in enumerate(names):
        if name in names[:k] or name == BASE:
            first = "the base" if name == BASE else str(place.at(names.index(name)))
            raise DuplicateNameError(str(place.at(k, "name")), "joint", name, first)
    named = [table.parent or (names[k - 1] if k else BASE) for k, table in enumerate(tables)]
    _refuse_cycles(names, named, place)
    made: list[int] = []
    for k, parent in enumerate(named):
        if parent != BASE and parent not in names[:k]:
            where = str(place.at(k, "parent"))
            raise MissingParentError(where, names[k], parent, [BASE, *names[:k]], later=parent in names)
        made.append(-1 if parent == BASE else names.index(parent))
    return made


def _refuse_cycles(names: list[str], parents: list[str], place: Place) -> None:
    above = dict(zip(names, parents, strict=True))
    for start in names:
        trail = [start]
        while (parent := above.get(trail[-1])) is not None:
            if parent in trail:
                ring = trail[trail.index(parent) :]
                raise CycleError(str(place.at(names.index(ring[-1]), "parent")), [*ring, parent])
            trail.append(parent)


def _position_limits(values: Sequence[float | str] | None, reader: Reader, place: Place) -> tuple[float, float] | None:
    if values is None:
        return None
    low, high = (reader.number(value, place.at(k)) for k, value in enumerate(values))
    if low >= high:
        raise DeviceValueError(
            str(place), f"found [{low:g}, {high:g}]", "Write the lower limit first, below the upper."
        )
    return low, high


def _limit(value: float | str | None, reader: Reader, place: Place) -> float | None:
    if value is None:
        return None
    made = reader.number(value, place)
    if made <= 0:
        raise DeviceValueError(str(place), f"found {made:g}", "Write a number above zero.")
    return made


def _symmetry(
    tables: Sequence[SymmetryTable], joints: Sequence[Joint], terms: Sequence[TermColumn], place: Place
) -> tuple[Symmetry, ...]:
    names = [joint.name for joint in joints]
    raw = raw_names(names, terms)
    units = dict(zip(raw[10 * len(joints) :], (term.unit for term in terms), strict=True))
    for k, name in enumerate(raw):
        if name in raw[:k]:
            first = f"{raw.index(name) + 1}. of the standard parameters"
            raise DuplicateNameError(str(place.at("terms")), "parameter", name, f"the {first}; set prefix or name")
    return tuple(_rule(table, names, raw, units, place.at("symmetry", k)) for k, table in enumerate(tables))


def _rule(
    table: SymmetryTable, links: list[str], raw: tuple[str, ...], units: Mapping[str, str], place: Place
) -> Symmetry:
    zero, equal = list(table.zero), [tuple(group) for group in table.equal]
    named = [(name, place.at("zero", k)) for k, name in enumerate(zero)]
    named += [(name, place.at("equal", k, i)) for k, group in enumerate(equal) for i, name in enumerate(group)]
    for name, at in named:
        if name not in raw:
            raise UnknownDeviceNameError(str(at), "parameter", name, raw)
    for k, group in enumerate(equal):
        kinds = {_unit(name, raw, units) for name in group}
        if len(kinds) > 1:
            raise DeviceValueError(
                str(place.at("equal", k)),
                f"{' and '.join(group)} have units {', '.join(sorted(kinds))}",
                "Equate like with like.",
            )
    linked = [(name, place.at("identical", k)) for k, name in enumerate(table.identical)]
    linked += [(table.about.link, place.at("about", "link"))] if table.about else []
    for name, at in linked:
        if name not in links:
            raise UnknownDeviceNameError(str(at), "link", name, links)
    if table.about:
        across = [axis for axis in "XYZ" if axis != table.about.axis.upper()]
        zero += [kind + table.about.link for kind in ("XY", "XZ", "YZ", *(f"M{axis}" for axis in across))]
        equal.append(tuple(axis + axis + table.about.link for axis in across))
    if len(table.identical) > 1:
        equal += [tuple(kind + link for link in table.identical) for kind in INERTIAL]
    if not zero and not equal:
        raise DeviceValueError(str(place), "this symmetry says nothing", "Add zero, equal, about or identical.")
    return Symmetry(table.reason, tuple(zero), tuple(equal))


def _unit(name: str, raw: tuple[str, ...], units: Mapping[str, str]) -> str:
    return units.get(name) or INERTIAL_UNITS[raw.index(name) % 10]


def _handle(tables: AnyDevice, joints: Sequence[Joint], base: Array, reader: Reader, place: Place) -> Handle | None:
    if tables.handle is None:
        return None
    names = [joint.name for joint in joints]
    if tables.handle.link not in names:
        raise UnknownDeviceNameError(str(place.at("link")), "link", tables.handle.link, names)
    frame = frame_on(joints, names.index(tables.handle.link), reader.placement(tables.handle, place), base)
    return Handle(frame.link, frame.rotation, frame.translation)


def _prior(
    tables: AnyDevice, joints: Sequence[Joint], raw: tuple[str, ...], reader: Reader, place: Place
) -> dict[str, Prior]:
    made: dict[str, Prior] = {}
    links = [joint.name for joint in joints]
    for k, body in enumerate(tables.prior_bodies):
        here = place.at("prior_bodies", k)
        if body.link not in links:
            raise UnknownDeviceNameError(str(here.at("link")), "link", body.link, links)
        if f"M{body.link}" in made:
            raise DuplicateNameError(str(here.at("link")), "prior body of link", body.link, "an earlier one")
        percent = None if body.sd_percent is None else reader.number(body.sd_percent, here.at("sd_percent"))
        made |= body_prior(_body(body, reader, here), joints[links.index(body.link)], percent)
    for name, value in tables.prior.items():
        here = place.at("prior", name)
        if name not in raw:
            raise UnknownDeviceNameError(str(here), "parameter", name, raw)
        made[name] = _named_prior(value, reader, here)
    return made


def _named_prior(value: PriorTable | float | str, reader: Reader, place: Place) -> Prior:
    if not isinstance(value, PriorTable):
        return Prior(reader.number(value, place))
    std = None if value.std is None else reader.number(value.std, place.at("sd"))
    if std is not None and std <= 0:
        raise DeviceValueError(str(place.at("sd")), f"found {std:g}", "Write a standard deviation above zero, or none.")
    return Prior(reader.number(value.value, place.at("value")), std)


def _body(table: PriorBodyTable, reader: Reader, place: Place) -> Body:
    """A CAD body, refused where no body can have such a mass or inertia."""
    mass = reader.number(table.mass, place.at("mass"))
    if mass < 0:
        raise DeviceValueError(str(place.at("mass")), f"found {mass:g} kg", "Write zero or a number above it.")
    inertia = None
    if table.inertia is not None:
        inertia = tensor(np.array([reader.number(v, place.at("inertia", k)) for k, v in enumerate(table.inertia)]))
        least = float(np.linalg.eigvalsh(inertia)[0])
        if least < -1e-9 * float(np.trace(np.abs(inertia))):
            found = f"the least principal moment is {least:.3g} kg m^2"
            raise DeviceValueError(
                str(place.at("inertia")),
                found,
                "Write XX YY ZZ XY XZ YZ of the tensor about the centre of mass.",
            )
    return Body(mass, np.array(reader.triple(table.com, place.at("com"))), inertia)


def _keep(tables: AnyDevice, parameters: StandardParameters, place: Place) -> tuple[str, ...]:
    """Names of the free parameters to keep; one that stands for several may be called by any of them."""
    for k, name in enumerate(tables.base_parameters.keep):
        if name not in parameters.index:
            raise UnknownDeviceNameError(str(place.at("keep", k)), "free parameter", name, parameters.index)
    return tuple(parameters.names[parameters.index[name]] for name in tables.base_parameters.keep)


def _tolerance(tables: AnyDevice, reader: Reader, place: Place) -> float:
    made = reader.number(tables.base_parameters.tolerance, place)
    if not 0 < made < 1:
        raise DeviceValueError(str(place), f"found {made:g}", "Write a number between 0 and 1, such as 1e-9.")
    return made


def _contradictions(prior: Mapping[str, Prior], index: Mapping[str, int]) -> list[str]:
    """Priors of parameters that symmetry or massless links say are zero."""
    lost = [name for name, known in prior.items() if name not in index and known.value]
    return [f"prior of {', '.join(lost)} is not used: these parameters are zero in this device"] if lost else []
