"""The [[terms]] of a device file as regressor columns: targets, names, units and settings."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from string import ascii_uppercase

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.elastic import SENSOR, row_map
from haptid.device.expressions import column
from haptid.device.geometry import Reader
from haptid.device.loops.cut_joint import CutJoint
from haptid.device.loops.formula import AnyClosure
from haptid.device.parts import Joint, Motor
from haptid.device.terms.custom import custom_column, with_constants
from haptid.device.terms.extension import extension_columns
from haptid.device.terms.friction import PLACES, LoadDependentFriction, load_row, one_direction
from haptid.device.terms.presliding import LAWS, Presliding
from haptid.device.terms.spring import Counterbalance, beyond_play, read_counterbalance
from haptid.device.terms.term import UNITS, TermColumn
from haptid.device.terms.warming import Warming
from haptid.device.toml.errors_at import Place
from haptid.device.toml.terms import (
    AnyTerm,
    CoordinateTable,
    CoulombTerm,
    CounterbalanceTerm,
    CustomTerm,
    DahlTerm,
    ElasticTerm,
    ExtensionTerm,
    LoadFrictionTerm,
    LuGreTerm,
    MaxwellSlipTerm,
    PlainTerm,
    RippleTerm,
    SpringTerm,
    StribeckTerm,
    TermTable,
    WarmingTerm,
)

# Stem of the parameter's name, by kind of term.
STEMS = {
    "rotor-inertia": "IA",
    "viscous": "FV",
    "viscous-by-direction": "FV",
    "coulomb": "FC",
    "coulomb-by-direction": "FC",
    "load-friction": "FL",
    "stribeck": "FS",
    "dahl": "FD",
    "maxwell-slip": "FM",
    "lugre": "FG",
    "warming": "FT",
    "ripple": "R",
    "offset": "OFF",
    "spring": "K",
    "counterbalance": "CB",
}


@dataclass(frozen=True, eq=False)
class Target:
    """What a term acts on: a joint, a joint that was cut, a motor's joint-side coordinate, or a sum of joints.

    Attributes:
        what: "joint", "cut", "motor", "coordinate", or "elastic" for the torsion of an elastic motor.
        name: of the joint, cut, motor or coordinate.
        joint: index of the joint; None for a cut, and for a motor whose rates are constant.
        prismatic: whether the coordinate is a length.
        weights: the target's position as a combination of the coordinates, (na,).
        offset: its position where the coordinates are zero.
        speed: its velocity in the symbols of expressions, "v_2" or "1*v_1 - 0.5*v_2".
        varies: whether its rates vary with the pose; weights and offset are then zero.
        mixed: whether it is a motor whose rates vary, and not those of one joint: no term can act on it.
    """

    what: str
    name: str
    joint: int | None
    prismatic: bool
    weights: Array
    offset: float
    speed: str
    varies: bool = False
    mixed: bool = False

    @property
    def position(self) -> str:
        """Its position in the symbols of expressions."""
        return re.sub(r"(?<!\w)v_", "q_", self.speed)

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
        """A column on this target that the core computes; its unit follows from its kind."""
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
class TermTargets:
    """Every joint, named cut, motor and coordinate that a term may act on, and the torsions of elastic motors."""

    joints: tuple[Target, ...]
    cuts: tuple[Target, ...]
    active: tuple[str, ...]
    motorised: tuple[str, ...]
    motors: tuple[Target, ...]
    coordinates: tuple[Target, ...]
    torsions: tuple[Target, ...]
    sensors: tuple[Target, ...]
    rotors: tuple[str, ...]

    @staticmethod
    def of(
        joints: Sequence[Joint],
        active: Sequence[int],
        drives: Sequence[Motor],
        joint_rows: bool,
        closure: AnyClosure,
        cuts: Sequence[CutJoint] = (),
        sums: Mapping[str, Array] | None = None,
    ) -> TermTargets:
        """From joints, drives, closure, cuts, and sums of joints; rates are by the active joints, or by the drives."""
        rows = np.array([drive.row for drive in drives])
        coupling = rows @ closure.constant
        frame = row_map(drives, active, closure, joint_rows)
        rates, motors = (
            np.asarray(np.linalg.solve(frame.T, x.T).T, dtype=np.float64) for x in (closure.constant, coupling)
        )
        varies = [bool(row.any()) for row in closure.varying]
        moved = np.any([drive.row != 0 for drive in drives if drive.motorised and not drive.sensor], axis=0)
        names, behind = [joints[j].name for j in active], [d for d in drives if d.load_side is not None]
        own = [row for drive in behind for row in (drive.row, drive.sensed) if row is not None]
        rotors = tuple(joints[int(np.argmax(row))].name for row in own)
        of_joints = (
            Target("joint", j.name, k, j.prismatic, rates[k], float(closure.offset[k]), f"v_{j.name}", varies[k])
            for k, j in enumerate(joints)
        )
        of_cuts = (
            Target("cut", c.name, None, c.prismatic, row, c.offset, _speed(c.row, names))
            for c in cuts
            for row in [np.asarray(np.linalg.solve(frame.T, c.row))]
        )
        of_motors = (
            _motor(drive, joints, motors[k], float(drive.row @ closure.offset), varies)
            for k, drive in enumerate(drives)
            if drive.motorised and not drive.sensor
        )
        return TermTargets(
            joints=tuple(of_joints),
            cuts=tuple(of_cuts),
            active=tuple(name for name in names if name not in rotors),
            motorised=tuple(j.name for j, on in zip(joints, moved, strict=True) if on and j.name not in rotors),
            motors=tuple(of_motors),
            coordinates=tuple(_sum(name, row, joints, rates, closure, varies) for name, row in (sums or {}).items()),
            torsions=tuple(_torsion(d, joints, frame, closure, varies) for d in behind),
            sensors=tuple(
                replace(_motor(d, joints, motors[k], 0.0, varies), what="sensor")
                for k, d in enumerate(drives)
                if d.sensor
            ),
            rotors=rotors,
        )

    def chosen(self, table: TermTable, place: Place) -> list[Target]:
        """The targets that a term names, in the device's order.

        Raises:
            DeviceFileError: it names none, or one that does not exist.
        """
        if isinstance(table, ElasticTerm):
            return [t for t in self.torsions if table.motors == "all" or t.name in (table.motors or ())]
        if table.joints is None and table.motors is None and table.coordinates is None:
            found = "the term acts on nothing"
            raise place.error(found, 'Add joints = "all", joints = ["1"] or motors = ["1"].')
        words = {
            "all": [t.name for t in (*self.joints, *self.cuts) if t.name not in self.rotors],
            "active": self.active,
            "motorised": self.motorised,
            None: (),
        }
        joints = table.joints if isinstance(table.joints, list) else words[table.joints]
        motors = table.motors if isinstance(table.motors, list) else [t.name for t in self.motors if table.motors]
        made: list[Target] = []
        every = (*self.joints, *self.cuts)
        named = (("joint", joints, every), ("motor", motors, self.motors))
        for what, wanted, known in (*named, ("coordinate", table.coordinates or [], self.coordinates)):
            names = [target.name for target in known]
            for k, name in enumerate(wanted):
                if name not in names:
                    raise place.at(f"{what}s", k).unknown(what, name, names)
            made += [target for target in known if target.name in wanted]
        for target in made:
            if target.mixed:
                raise place.error(
                    f"{target.on} is not one joint, and its rates vary with the pose",
                    "Let the term act on its joints; a motor may also drive one joint with factor 1.",
                )
        return made

    def sensor_of(self, torsion: Target) -> list[Target]:
        """The torque sensor of an elastic motor's spring, if it has one."""
        return [sensor for sensor in self.sensors if sensor.name == f"{SENSOR}{torsion.name}"]

    def expect_one(self, table: TermTable, place: Place) -> None:
        """Raise DeviceFileError unless a term names a single target."""
        if len(self.chosen(table, place)) != 1:
            found = "this term acts on more than one joint or motor"
            raise place.error(found, "Name one, and repeat the term for the others.")


def read_coordinates(
    tables: Sequence[CoordinateTable], joints: Sequence[Joint], reader: Reader, place: Place
) -> dict[str, Array]:
    """Sums of joints' positions by name, each with a factor for every joint, (joints,).

    Raises:
        DeviceFileError: a name is used twice, a joint does not exist, or all factors are zero.
    """
    names = [joint.name for joint in joints]
    made: dict[str, Array] = {}
    for k, table in enumerate(tables):
        here, row = place.at(k), np.zeros(len(names))
        if table.name in made:
            raise here.at("name").taken("coordinate", table.name, "an earlier one")
        for name, factor in table.joints.items():
            if name not in names:
                raise here.at("joints", name).unknown("joint", name, names)
            row[names.index(name)] = reader.number(factor, here.at("joints", name))
        if not row.any():
            raise here.at("joints").error("all factors are zero", "Name joints with factors that are not.")
        made[table.name] = row
    return made


def read_terms(tables: Sequence[AnyTerm], targets: TermTargets, reader: Reader, place: Place) -> tuple[TermColumn, ...]:
    """All terms as columns, in declared order, by joint within each table."""
    made: list[TermColumn] = []
    for k, table in enumerate(tables):
        here = place.at(k)
        for target in targets.chosen(table, here):
            made += _columns(table, target, targets, reader, here)
    return tuple(made)


def _columns(table: AnyTerm, target: Target, targets: TermTargets, reader: Reader, place: Place) -> list[TermColumn]:
    if isinstance(table, CustomTerm):
        return [custom_column(table, target, targets, reader, place)]
    if isinstance(table, ExtensionTerm):
        return extension_columns(table, target, targets, reader, place)
    motor = table.prefix is None and target.what == "motor"
    stem = table.prefix or STEMS.get(table.kind, "")

    def name(suffix: str = "") -> str:
        return f"{stem}{suffix}{'M' if motor else ''}{target.name}"

    match table:
        case CoulombTerm(kind=kind):
            signs = (("", kind),) if kind == "coulomb" else (("P", "coulomb+"), ("N", "coulomb-"))
            made = [target.column(name(suffix), sign) for suffix, sign in signs]
            return [with_constants(column, {"width": table.width}, reader, place) for column in made]
        case LoadFrictionTerm():
            width = reader.not_negative(table.width, place.at("width"))
            return [target.external(name(), "1", LoadDependentFriction(load_row(target, place), width))]
        case StribeckTerm():
            given = {key: getattr(table, key) for key in PLACES["stribeck"]}
            return [with_constants(target.column(name(), "stribeck"), given, reader, place)]
        case DahlTerm() | LuGreTerm():
            given = {key: getattr(table, key) for key in LAWS[table.kind]}
            return [with_constants(_presliding(table.kind, target, name()), given, reader, place)]
        case MaxwellSlipTerm():
            letters = ascii_uppercase[: len(table.distances)] if len(table.distances) > 1 else " "
            made = [_presliding(table.kind, target, name(letter.strip())) for letter in letters]
            return [
                with_constants(column, {"distance": distance}, reader, place.at("distances", k), nested=False)
                for k, (column, distance) in enumerate(zip(made, table.distances, strict=True))
            ]
        case WarmingTerm():
            column = target.external(name(), UNITS["viscous"][target.prismatic], Warming(1.0))
            return [with_constants(column, {"time": table.time}, reader, place)]
        case RippleTerm():
            return _ripple(table, target, stem, targets, reader, place)
        case SpringTerm():
            return [target.column(name(), "spring", settings=(reader.number(table.rest, place.at("rest")), 0.0, 0.0))]
        case ElasticTerm(damping=damping):
            spring, damper = (f"{letter}{table.prefix or 'E'}{target.name}" for letter in "KD")
            own = target.column(spring, "spring")
            if given := {name: value for name in ("play", "rest") if (value := getattr(table, name)) != 0.0}:
                loose = target.external(spring, own.unit, beyond_play(target, targets, place))
                own = with_constants(loose, given, reader, place)
            bias = [sensor.column(f"OS{target.name}", "offset") for sensor in targets.sensor_of(target)]
            return [own, *([target.column(damper, "viscous")] if damping else []), *bias]
        case PlainTerm(kind="viscous-by-direction"):
            unit = UNITS["viscous"][target.prismatic]
            return [
                target.external(name(suffix), unit, one_direction(target, sign, targets, place))
                for suffix, sign in (("P", "+"), ("N", "-"))
            ]
        case CounterbalanceTerm():
            targets.expect_one(table, place)
            suffixes = {"spring": (("F", "constant"), ("K", "linear")), "gas": (("", "gas"),)}[table.law]
            return [
                target.external(name(suffix), "N/m" if force == "linear" else "N", shape)
                for suffix, force in suffixes
                for shape in [read_counterbalance(table, target, force, reader, place)]
            ]
        case PlainTerm(kind="rotor-inertia"):
            return [target.column(name(), "rotor")]
        case _:
            return [target.column(name(), table.kind)]


def _presliding(law: str, target: Target, name: str) -> TermColumn:
    """Dry friction with presliding, before its constants are known."""
    return target.external(name, UNITS["coulomb"][target.prismatic], Presliding(law, 1.0))


def _ripple(
    table: RippleTerm, target: Target, stem: str, targets: TermTargets, reader: Reader, place: Place
) -> list[TermColumn]:
    """Sine and cosine of every harmonic of a torque that repeats with the target's position."""
    if target.varies or target.what in ("cut", "coordinate"):
        found = f"{target.on} has no position that is a combination of the joints'"
        raise place.error(found, "Name a joint of the tree, or a motor with constant rates.")
    period = reader.positive(table.period, place.at("period"))
    joints = [joint.name for joint in targets.joints]
    motor = "M" if target.what == "motor" and table.prefix is None else ""
    made = []
    for n in range(1, table.harmonics + 1):
        for letter, function in (("S", "sin"), ("C", "cos")):
            text = f"{function}({2 * np.pi * n / period!r}*({target.position}))"
            shape = column(text, joints, {}, place)
            suffix = str(n) if n > 1 else ""
            made.append(
                target.external(
                    f"{stem}{letter}{suffix}{motor}_{target.name}", UNITS["offset"][target.prismatic], shape
                )
            )
    return made


def _motor(drive: Motor, joints: Sequence[Joint], weights: Array, offset: float, varies: Sequence[bool]) -> Target:
    """A motor as a target; its rates vary with the pose where those of a joint that it drives do."""
    moved = np.flatnonzero(drive.row).tolist()
    varying = any(varies[j] for j in moved)
    joint = moved[0] if varying else None
    mixed = varying and (len(moved) > 1 or drive.row[moved[0]] != 1.0)
    weights, offset = (np.zeros_like(weights), 0.0) if varying else (weights, offset)
    speed = _speed(drive.row, [j.name for j in joints])
    prismatic = joints[drive.first].prismatic
    return Target("motor", drive.name, joint, prismatic, weights, offset, speed, varying, mixed)


def _sum(
    name: str, row: Array, joints: Sequence[Joint], rates: Array, closure: AnyClosure, varies: Sequence[bool]
) -> Target:
    """A sum of joints' positions as a target."""
    used = np.flatnonzero(row).tolist()
    speed, offset = _speed(row, [joint.name for joint in joints]), float(row @ closure.offset)
    mixed = any(varies[j] for j in used)
    return Target("coordinate", name, None, joints[used[0]].prismatic, row @ rates, offset, speed, mixed=mixed)


def _torsion(
    drive: Motor, joints: Sequence[Joint], frame: Array, closure: AnyClosure, varies: Sequence[bool]
) -> Target:
    """The torsion of an elastic motor as a target."""
    weights = np.asarray(np.linalg.solve(frame.T, drive.torsion @ closure.constant), dtype=np.float64)
    acts, bent = replace(drive, row=drive.torsion), replace(drive, sensed=None).torsion
    return replace(_motor(acts, joints, weights, float(bent @ closure.offset), varies), what="elastic")


def _speed(row: Array, names: Sequence[str]) -> str:
    """A combination of joints' velocities in the symbols of expressions."""
    return " + ".join(f"{weight!r}*v_{name}" for weight, name in zip(row.tolist(), names, strict=True) if weight)
