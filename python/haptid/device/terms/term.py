"""Terms beside link inertia: each a column of one parameter, acting on a joint or on a motor's coordinate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.device.expressions import Column
from haptid.errors import ColumnValueError

# Unit of a column's parameter, for a turning and for a sliding coordinate.
UNITS: Mapping[str, tuple[str, str]] = {
    "rotor": ("kg m^2", "kg"),
    "viscous": ("N m s/rad", "N s/m"),
    "coulomb": ("N m", "N"),
    "coulomb+": ("N m", "N"),
    "coulomb-": ("N m", "N"),
    "stribeck": ("N m", "N"),
    "offset": ("N m", "N"),
    "spring": ("N m/rad", "N/m"),
}
# Kinds in which the sign of a velocity matters.
DRY = ("coulomb", "coulomb+", "coulomb-", "stribeck")
# Place of each constant in a kind's settings.
PLACES: Mapping[str, Mapping[str, int]] = {
    "coulomb": {"width": 0},
    "coulomb+": {"width": 0},
    "coulomb-": {"width": 0},
    "stribeck": {"velocity": 0, "exponent": 1, "width": 2},
}


@dataclass(frozen=True)
class Searched:
    """A constant of a term that is not known beforehand; the term itself holds its present value.

    Attributes:
        name: of the constant in its term: "velocity", "exponent", "width", or one of an expression.
        unit: of the constant.
        low, high: between what it is searched.
    """

    name: str
    unit: str
    low: float
    high: float

    @property
    def positive(self) -> bool:
        """Whether it is searched by its logarithm."""
        return self.low > 0


@dataclass(frozen=True)
class Counterbalance:
    """A strut between link and parent that pulls on a crank: torque per unit of its parameter.

    With delta = q + angle, the strut is sqrt(base^2 + crank^2 - 2 base crank cos delta) long, has lengthened
    by dl from its shortest, and pulls with the lever arm base crank sin(delta) / length.

    Attributes:
        joint: index of the joint it turns about.
        crank, base: distances of its two ends from the joint axis, m.
        angle: added to the joint position, rad.
        sign: 1 or -1.
        force: "constant" (parameter N), "linear" in dl (N/m), or "gas", 1 / (1 - dl / stroke) (N).
        stroke: lengthening at which the gas volume would vanish, m.
    """

    joint: int
    crank: float
    base: float
    angle: float
    sign: float
    force: str
    stroke: float = np.inf

    def values(self, q: Array) -> Array:
        """The column, (samples,), from the positions of all joints, (joints, samples)."""
        delta = q[self.joint] + self.angle
        length = np.sqrt(self.base**2 + self.crank**2 - 2 * self.base * self.crank * np.cos(delta))
        lengthening = length - abs(self.base - self.crank)
        lever = self.sign * self.base * self.crank * np.sin(delta) / length
        if self.force == "linear":
            return np.asarray(lever * lengthening)
        if self.force == "gas":
            return np.asarray(lever / (1 - lengthening / self.stroke))
        return np.asarray(lever)


@dataclass(frozen=True, eq=False)
class LoadDependentFriction:
    """Dry friction in proportion to the load that a coordinate carries: sgn(v) |torque of the bodies on it|.

    The bodies are those of an estimate: see `Device.loaded`. Before there is one they are like one another, so that
    the term is told from others and no more.

    Source: Hamon, Gautier and Garrec (2010), Proc. IEEE/RSJ IROS, 6187-6193, where friction is (alpha |tau| + beta)
    sgn(v).

    Attributes:
        row: index of the coordinate.
        width: tanh(v / width) in place of sgn v, rad/s or m/s; 0 is sgn.
        bodies: parameters of links, then of rotors, (r,), SI; None where there is no estimate yet.
    """

    row: int
    width: float
    bodies: Array | None = None

    @property
    def text(self) -> str:
        """In words."""
        turning = f"tanh(v / {self.width})" if self.width else "sgn(v)"
        return f"{turning} |torque of the bodies| on coordinate {self.row + 1}"

    def values(self, torque: Array, speed: Array) -> Array:
        """The column, (samples,), from torque of the bodies and velocity of the coordinates, (active, samples)."""
        return np.asarray(np.abs(torque[self.row]) * self.side(speed))

    def side(self, speed: Array) -> Array:
        """sgn v, or what is in its place, (samples,), from velocity of the coordinates, (active, samples)."""
        v = speed[self.row]
        return np.asarray(np.tanh(v / self.width) if self.width else np.sign(v))


@dataclass(frozen=True, eq=False)
class TermColumn:
    """One column of the regressor beside link inertia.

    Attributes:
        name: of its parameter, such as FV1.
        unit: of its parameter.
        kind: the core's: rotor viscous coulomb coulomb+ coulomb- stribeck offset spring external.
        on: what it acts on: "joint 3", "cut 10" or "motor 6".
        weights: its coordinate as a combination of the device's coordinates, (na,).
        offset: position of its coordinate where the device's coordinates are zero, rad or m.
        settings: the core's a, b, c: coulomb (width, 0, 0), stribeck (velocity, exponent, width), spring
            (rest, 0, 0).
        shape: how an external column is computed, None for the others.
        joint: index of the joint it acts on where that joint's rates vary with the pose: in place of weights, which
            are then zero, and offset.
        searched: its constants that are not known.
    """

    name: str
    unit: str
    kind: str
    on: str
    weights: Array
    offset: float = 0.0
    settings: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shape: Counterbalance | Column | LoadDependentFriction | None = None
    joint: int | None = None
    searched: tuple[Searched, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", read_only(self.weights))

    @property
    def nature(self) -> str:
        """What it is physically: its kind, but for a column that is a part of another kind."""
        return (self.shape.nature if isinstance(self.shape, Column) else "") or self.kind

    @property
    def resists(self) -> bool:
        """Whether it is friction: it takes energy out of a motion, and nothing else."""
        return self.nature == "viscous" or self.dry

    @property
    def dry(self) -> bool:
        """Whether it is friction in which the sign of a velocity matters."""
        return self.kind in DRY or isinstance(self.shape, LoadDependentFriction)

    @property
    def side(self) -> int:
        """1 where it acts forward only, -1 backward only, and another term the other way; else 0."""
        of_core = {"coulomb+": 1, "coulomb-": -1}.get(self.kind, 0)
        return self.shape.side if isinstance(self.shape, Column) else of_core

    def constant(self, name: str) -> float:
        """Present value of a constant, SI."""
        if isinstance(self.shape, LoadDependentFriction):
            return self.shape.width
        if isinstance(self.shape, Column):
            return self.shape.constants[name]
        return self.settings[PLACES[self.kind][name]]

    def with_constant(self, name: str, value: float) -> TermColumn:
        """The same term with another value of a constant."""
        if isinstance(self.shape, LoadDependentFriction):
            return replace(self, shape=replace(self.shape, width=value))
        if isinstance(self.shape, Column):
            return replace(self, shape=replace(self.shape, constants={**self.shape.constants, name: value}))
        place = PLACES[self.kind][name]
        a, b, c = (value if k == place else old for k, old in enumerate(self.settings))
        return replace(self, settings=(a, b, c))

    def moves_as(self, other: TermColumn) -> bool:
        """Whether its velocity is another's, or the opposite."""
        opposite = any(np.array_equal(self.weights, sign * other.weights) for sign in (1, -1))
        return self.joint == other.joint and opposite

    @property
    def for_core(self) -> tuple[str, Array, float, float, float, float]:
        """The term as `haptid._core.Mechanism` takes it."""
        return (self.kind, self.weights, self.offset, *self.settings)


def external_columns(
    terms: tuple[TermColumn, ...],
    joints: tuple[str, ...],
    motion: tuple[Array, Array, Array],
    loads: Mapping[str, Array],
) -> Array:
    """Columns that Python computes for the core, (columns, samples).

    Args:
        terms: the external ones, in the core's order.
        joints: names of all joints.
        motion: position, velocity and acceleration of all joints, each (joints, samples).
        loads: columns of friction by load, by name, each (samples,).

    Raises:
        ColumnValueError: a column is not finite somewhere.
    """
    samples = motion[0].shape[1]
    named = dict(_named(joints, motion))
    made = np.empty((len(terms), samples))
    for row, term in zip(made, terms, strict=True):
        if isinstance(term.shape, Counterbalance):
            row[:] = term.shape.values(motion[0])
        elif isinstance(term.shape, LoadDependentFriction):
            row[:] = loads[term.name]
        elif term.shape is not None:
            row[:] = term.shape.values(named, samples)
        if not np.isfinite(row).all():
            sample = int(np.argmin(np.isfinite(row)))
            cause = f"its expression is {term.shape.text}" if isinstance(term.shape, Column) else "the motion is not"
            raise ColumnValueError(term.name, sample, float(row[sample]), cause)
    return made


def _named(joints: tuple[str, ...], motion: tuple[Array, Array, Array]) -> Iterator[tuple[str, Array]]:
    for letter, values in zip("qva", motion, strict=True):
        for joint, row in zip(joints, values, strict=True):
            yield f"{letter}_{joint}", row
