"""Term columns from a file's [[terms]]: whom each acts on, its names, units and settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Joint, Motor
from haptid.device.expressions import RESERVED, Column, column
from haptid.device.geometry import Reader
from haptid.device.loops.cut_joint import CutJoint
from haptid.device.loops.linear import Closure
from haptid.device.loops.newton import NewtonClosure
from haptid.device.terms.term import PLACES, UNITS, Counterbalance, LoadDependentFriction, Searched, TermColumn
from haptid.device.toml.place import Place
from haptid.device.toml.schema import (
    AnyTerm,
    ColumnTerm,
    CoulombTerm,
    CounterbalanceTerm,
    LoadTerm,
    PlainTerm,
    SearchedTable,
    SpringTerm,
    StribeckTerm,
    TermTable,
)
from haptid.errors import DeviceKeyError, DeviceValueError, DuplicateNameError, UnknownDeviceNameError

# Stem of the parameter's name, by kind.
STEMS = {
    "rotor": "IA",
    "viscous": "FV",
    "viscous-by-direction": "FV",
    "coulomb": "FC",
    "coulomb-by-direction": "FC",
    "load": "FL",
    "stribeck": "FS",
    "offset": "OFF",
    "spring": "K",
    "counterbalance": "CB",
}
# Unit of a velocity, for a turning and for a sliding coordinate.
SPEED = ("rad/s", "m/s")
# A searched constant without limits stays within its start times this, either way.
RANGE = 100.0


@dataclass(frozen=True, eq=False)
class Target:
    """What a term acts on: a joint, a joint that was cut, or a motor's joint-side coordinate.

    Attributes:
        what: "joint", "cut" or "motor".
        name: of the joint, cut or motor.
        joint: index of the joint, None for a cut or a motor.
        prismatic: whether the coordinate is a length.
        weights: the target's position as a combination of the coordinates, (na,).
        offset: its position where the coordinates are zero.
        speed: its velocity in the symbols of column expressions, "v_2" or "1*v_1 - 0.5*v_2".
        varies: whether it is a joint whose rates vary with the pose; weights and offset are then zero.
    """

    what: str
    name: str
    joint: int | None
    prismatic: bool
    weights: Array
    offset: float
    speed: str
    varies: bool = False

    @property
    def moved(self) -> int | None:
        """As in TermColumn.joint."""
        return self.joint if self.varies else None

    @property
    def on(self) -> str:
        """As in TermColumn.on."""
        return f"{self.what} {self.name}"

    def column(
        self,
        name: str,
        kind: str,
        unit: str | None = None,
        settings: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> TermColumn:
        """A column on this target that the core computes, its unit by its kind."""
        unit = unit or UNITS[kind][self.prismatic]
        return TermColumn(name, unit, kind, self.on, self.weights, self.offset, settings, joint=self.moved)

    def external(self, name: str, unit: str, shape: Counterbalance | object) -> TermColumn:
        """A column on this target that Python computes."""
        return TermColumn(
            name,
            unit,
            "external",
            self.on,
            self.weights,
            self.offset,
            shape=shape,  # type: ignore[arg-type]
            joint=self.moved,
        )


@dataclass(frozen=True, eq=False)
class Targets:
    """Every joint, named cut and motor that a term may act on."""

    joints: tuple[Target, ...]
    cuts: tuple[Target, ...]
    active: tuple[str, ...]
    motorised: tuple[str, ...]
    motors: tuple[Target, ...]

    @staticmethod
    def of(
        joints: Sequence[Joint],
        active: Sequence[int],
        drives: Sequence[Motor],
        joint_rows: bool,
        closure: Closure | NewtonClosure,
        cuts: Sequence[CutJoint] = (),
    ) -> Targets:
        """From joints, drives, closure and cuts; the coordinates are the active joints', or else the drives'."""
        coupling = np.array([drive.row for drive in drives])
        frame = np.eye(len(drives)) if joint_rows else coupling
        rates, motors = (np.linalg.solve(frame.T, x.T).T for x in (closure.constant, coupling))
        varies = [bool(row.any()) for row in closure.varying]
        moved = np.any([drive.row != 0 for drive in drives if drive.motorised], axis=0)
        names = [joints[j].name for j in active]
        first = [joints[active[int(np.argmax(drive.row != 0))]] for drive in drives]
        return Targets(
            tuple(
                Target(
                    "joint",
                    joint.name,
                    j,
                    joint.prismatic,
                    rates[j],
                    float(closure.offset[j]),
                    f"v_{joint.name}",
                    varies[j],
                )
                for j, joint in enumerate(joints)
            ),
            tuple(
                Target(
                    "cut",
                    cut.name,
                    None,
                    cut.prismatic,
                    np.linalg.solve(frame.T, cut.row),
                    cut.offset,
                    _speed(cut.row, names),
                )
                for cut in cuts
            ),
            tuple(names),
            tuple(name for name, driven in zip(names, np.atleast_1d(moved), strict=True) if driven),
            tuple(
                Target("motor", drive.name, None, first[k].prismatic, motors[k], 0.0, _speed(drive.row, names))
                for k, drive in enumerate(drives)
                if drive.motorised
            ),
        )

    def chosen(self, table: TermTable, place: Place) -> list[Target]:
        """The targets that a term names, in the device's order.

        Raises:
            DeviceKeyError: it names none.
            UnknownDeviceNameError: it names one that is not there.
        """
        if table.joints is None and table.motors is None:
            found = "the term acts on nothing"
            raise DeviceKeyError(str(place), found, 'Add joints = "all", joints = ["1"] or motors = ["1"].')
        words = {
            "all": [t.name for t in (*self.joints, *self.cuts)],
            "active": self.active,
            "motorised": self.motorised,
            None: (),
        }
        joints = table.joints if isinstance(table.joints, list) else words[table.joints]
        motors = table.motors if isinstance(table.motors, list) else [t.name for t in self.motors if table.motors]
        made: list[Target] = []
        every = (*self.joints, *self.cuts)
        for what, wanted, known in (("joint", joints, every), ("motor", motors, self.motors)):
            names = [target.name for target in known]
            for k, name in enumerate(wanted):
                if name not in names:
                    raise UnknownDeviceNameError(str(place.at(f"{what}s", k)), what, name, names)
            made += [target for target in known if target.name in wanted]
        return made


def read_terms(tables: Sequence[AnyTerm], targets: Targets, reader: Reader, place: Place) -> tuple[TermColumn, ...]:
    """All columns beside link inertia, in declared order, by joint within each table."""
    made: list[TermColumn] = []
    for k, table in enumerate(tables):
        here = place.at(k)
        for target in targets.chosen(table, here):
            made += _columns(table, target, targets, reader, here)
    return tuple(made)


def _columns(table: AnyTerm, target: Target, targets: Targets, reader: Reader, place: Place) -> list[TermColumn]:
    if isinstance(table, ColumnTerm):
        return [_own_column(table, target, targets, reader, place)]
    motor = table.prefix is None and target.what == "motor"
    stem = table.prefix or STEMS[table.kind]

    def name(suffix: str = "") -> str:
        return f"{stem}{suffix}{'M' if motor else ''}{target.name}"

    match table:
        case CoulombTerm(kind=kind):
            signs = (("", kind),) if kind == "coulomb" else (("P", "coulomb+"), ("N", "coulomb-"))
            made = [target.column(name(suffix), sign) for suffix, sign in signs]
            return [_with_constants(column, {"width": table.width}, reader, place) for column in made]
        case LoadTerm():
            width = _not_negative(table.width, reader, place.at("width"))
            return [target.external(name(), "1", LoadDependentFriction(_row(target, place), width))]
        case StribeckTerm():
            given = {key: getattr(table, key) for key in PLACES["stribeck"]}
            return [_with_constants(target.column(name(), "stribeck"), given, reader, place)]
        case SpringTerm():
            return [target.column(name(), "spring", settings=(reader.number(table.rest, place.at("rest")), 0.0, 0.0))]
        case PlainTerm(kind="viscous-by-direction"):
            unit = UNITS["viscous"][target.prismatic]
            return [
                target.external(name(suffix), unit, _half(target, sign, targets, place))
                for suffix, sign in (("P", "+"), ("N", "-"))
            ]
        case CounterbalanceTerm():
            _alone(table, targets, place)
            suffixes = {"spring": (("F", "constant"), ("K", "linear")), "gas": (("", "gas"),)}[table.law]
            return [
                target.external(name(suffix), "N/m" if force == "linear" else "N", shape)
                for suffix, force in suffixes
                for shape in [_counterbalance(table, target, force, reader, place)]
            ]
        case _:
            return [target.column(name(), table.kind)]


def _row(target: Target, place: Place) -> int:
    """The coordinate that a target is; its torque is then a row of the model.

    Raises:
        DeviceValueError: it is a combination of several, or moves as the pose has it.
    """
    moved = np.flatnonzero(target.weights)
    if len(moved) != 1 or target.varies:
        found = f"{target.on} is not one of the coordinates that torque rows are of"
        raise DeviceValueError(str(place), found, 'Name a motor, or an active joint where torque_rows = "joint".')
    return int(moved[0])


def _speed(row: Array, names: Sequence[str]) -> str:
    """A combination of the active joints' velocities, as column expressions have them."""
    return " + ".join(f"{weight!r}*v_{name}" for weight, name in zip(row.tolist(), names, strict=True) if weight)


def _half(target: Target, sign: str, targets: Targets, place: Place) -> Column:
    """The velocity where it is forward ("+") or backward ("-"), else zero."""
    joints = [joint.name for joint in targets.joints]
    made = column(f"0.5*({target.speed} {sign} abs({target.speed}))", joints, {}, place)
    return replace(made, nature="viscous", side=1 if sign == "+" else -1)


def _own_column(table: ColumnTerm, target: Target, targets: Targets, reader: Reader, place: Place) -> TermColumn:
    _alone(table, targets, place)
    for name in table.constants:
        if name in reader.lengths or name in RESERVED:
            known = "a named length" if name in reader.lengths else "arithmetic"
            raise DuplicateNameError(str(place.at("constants", name)), "constant", name, known)
    joints = [joint.name for joint in targets.joints]
    named = {**reader.lengths, **dict.fromkeys(table.constants, 0.0)}
    shape = column(table.expression, joints, named, place.at("expression"))
    made = target.external(table.name, table.unit, shape)
    return _with_constants(made, table.constants, reader, place.at("constants"))


def _with_constants(term: TermColumn, given: Mapping[str, Any], reader: Reader, place: Place) -> TermColumn:
    """The term with its constants; those that the file gives a range for are searched."""
    searched = []
    for name, value in given.items():
        here = place.at(name)
        if isinstance(value, SearchedTable):
            start, made = _searched(term, name, value, reader, here)
            searched.append(made)
        else:
            start = reader.number(value, here)
        if term.kind != "external":
            start = _positive(start, reader, here) if name != "width" else _not_negative(start, reader, here)
        term = term.with_constant(name, start)
    return replace(term, searched=tuple(searched))


def _searched(
    term: TermColumn, name: str, table: SearchedTable, reader: Reader, place: Place
) -> tuple[float, Searched]:
    """Where the search of a constant starts, and its range: a hundredth to a hundred times where none is given."""
    start = reader.number(table.start, place.at("start"))
    ends = []
    for key, factor in (("low", 1 / RANGE), ("high", RANGE)):
        given = getattr(table, key)
        if given is None and start <= 0:
            found = f"start is {start:g}, from which no range follows"
            raise DeviceKeyError(str(place.at(key)), found, f"Write {key} = ... beside start.")
        ends.append(start * factor if given is None else reader.number(given, place.at(key)))
    low, high = ends
    if not low <= start <= high or low == high:
        found = f"start is {start:g}, low {low:g}, high {high:g}"
        raise DeviceValueError(str(place), found, "Let low be below high, and start between them.")
    if term.kind != "external" and low <= 0:
        raise DeviceValueError(str(place.at("low")), f"found {low:g}", "Write a number above zero.")
    unit = {"velocity": SPEED, "width": SPEED}.get(name, ("", ""))[term.unit == "N"] if term.kind != "external" else ""
    return start, Searched(name, unit, low, high)


def _alone(table: TermTable, targets: Targets, place: Place) -> None:
    if len(targets.chosen(table, place)) != 1:
        raise DeviceValueError(
            str(place),
            "this term acts on more than one joint or motor",
            "Name one, and repeat the term for the others.",
        )


def _counterbalance(
    table: CounterbalanceTerm, target: Target, force: str, reader: Reader, place: Place
) -> Counterbalance:
    if target.joint is None or target.prismatic:
        raise DeviceValueError(
            str(place), f"a counterbalance cannot act on {target.on}", "Name one revolute joint in joints."
        )
    crank, base = (_positive(getattr(table, key), reader, place.at(key)) for key in ("crank", "base"))
    if crank == base:
        raise DeviceValueError(
            str(place.at("crank")),
            f"crank and base are both {crank:g} m",
            "Make them differ: the strut would vanish.",
        )
    stroke = np.inf
    if table.law == "gas":
        if table.stroke is None:
            raise DeviceKeyError(
                str(place.at("stroke")), "this key is missing", "Write stroke = ... (m) for a gas law."
            )
        stroke, most = reader.number(table.stroke, place.at("stroke")), 2 * min(crank, base)
        if stroke <= most:
            raise DeviceValueError(
                str(place.at("stroke")),
                f"found {stroke:g} m, but the strut lengthens by up to {most:g} m",
                f"Write a stroke above {most:g}.",
            )
    elif table.stroke is not None:
        raise DeviceKeyError(
            str(place.at("stroke")), "stroke has no meaning for a spring", 'Remove it, or write law = "gas".'
        )
    angle = reader.angle(table.angle, place.at("angle"))
    return Counterbalance(target.joint, crank, base, angle, float(table.sign), force, float(stroke))


def _positive(value: float | str, reader: Reader, place: Place) -> float:
    made = reader.number(value, place)
    if made <= 0:
        raise DeviceValueError(str(place), f"found {made:g}", "Write a number above zero.")
    return made


def _not_negative(value: float | str, reader: Reader, place: Place) -> float:
    made = reader.number(value, place)
    if made < 0:
        raise DeviceValueError(str(place), f"found {made:g}", "Write zero or a number above it.")
    return made
