"""Terms: regressor columns in addition to the links' inertia, each of one parameter, on a joint or a motor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.expressions import CustomColumn
from haptid.device.terms.friction import DRY, PLACES, LoadDependentFriction
from haptid.device.terms.presliding import Presliding
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.warming import Warming
from haptid.errors import DeviceError

# Unit of the parameter of each kind, for a revolute and for a prismatic coordinate.
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


@dataclass(frozen=True)
class Searched:
    """A constant of a term that is estimated (a nonlinear parameter); the term holds its present value.

    Attributes:
        name: of the constant in its term: "velocity", "exponent", "width", or one of an expression.
        unit: of the constant.
        low, high: bounds of the search.
    """

    name: str
    unit: str
    low: float
    high: float

    @property
    def positive(self) -> bool:
        """Whether the search is over its logarithm."""
        return self.low > 0


@dataclass(frozen=True, eq=False)
class TermColumn:
    """One regressor column in addition to the links' inertia.

    Attributes:
        name: of its parameter, such as FV1.
        unit: of its parameter.
        kind: as in the core: rotor viscous coulomb coulomb+ coulomb- stribeck offset spring external.
        on: "joint 3", "cut 10" or "motor 6".
        weights: its coordinate as a combination of the device's coordinates, (na,).
        offset: position of its coordinate where the device's coordinates are zero, rad or m.
        settings: the core's a, b, c: coulomb (width, 0, 0), stribeck (velocity, exponent, width), spring
            (rest, 0, 0).
        shape: how an external column is computed, None for the others.
        joint: index of the joint it acts on if that joint's rates vary with the pose; weights and offset are then
            zero. Else None.
        searched: its constants that are estimated.
    """

    name: str
    unit: str
    kind: str
    on: str
    weights: Array
    offset: float = 0.0
    settings: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shape: Counterbalance | CustomColumn | LoadDependentFriction | Presliding | Warming | None = None
    joint: int | None = None
    searched: tuple[Searched, ...] = ()

    def __post_init__(self) -> None:
        freeze_fields(self, "weights")

    @property
    def nature(self) -> str:
        """Physical kind: that of the term which a custom column is part of, else the kind; presliding is Coulomb's."""
        if isinstance(self.shape, Presliding):
            return "coulomb"
        if isinstance(self.shape, Warming):
            return "viscous"
        return (self.shape.nature if isinstance(self.shape, CustomColumn) else "") or self.kind

    @property
    def resists(self) -> bool:
        """Whether it is friction: it only dissipates energy."""
        return self.nature == "viscous" or self.dry

    @property
    def dry(self) -> bool:
        """Whether it is dry friction: it depends on the sign of a velocity."""
        return self.jumps or self.signed

    @property
    def jumps(self) -> bool:
        """Whether it is dry friction whose whole torque changes at a reversal, but for a smoothing width."""
        return self.kind in DRY or isinstance(self.shape, LoadDependentFriction)

    @property
    def historic(self) -> bool:
        """Whether its column depends on the motion before or on time, and not on the state alone."""
        return isinstance(self.shape, Presliding | Warming)

    @property
    def signed(self) -> bool:
        """Whether it is dry friction of one magnitude, so that only the sign of its velocity matters while sliding."""
        return self.kind in DRY or isinstance(self.shape, Presliding)

    @property
    def side(self) -> int:
        """1 if it acts at positive velocities only, -1 at negative ones only, else 0."""
        of_core = {"coulomb+": 1, "coulomb-": -1}.get(self.kind, 0)
        return self.shape.side if isinstance(self.shape, CustomColumn) else of_core

    def constant(self, name: str) -> float:
        """Present value of a constant, SI."""
        if isinstance(self.shape, LoadDependentFriction):
            return self.shape.width
        if isinstance(self.shape, CustomColumn):
            return self.shape.constants[name]
        if isinstance(self.shape, Presliding | Warming):
            return float(getattr(self.shape, name))
        return self.settings[PLACES[self.kind][name]]

    def with_constant(self, name: str, value: float) -> TermColumn:
        """The same term with another value of a constant."""
        if isinstance(self.shape, LoadDependentFriction):
            return replace(self, shape=replace(self.shape, width=value))
        if isinstance(self.shape, Presliding):
            return replace(self, shape=self.shape.with_constant(name, value))
        if isinstance(self.shape, Warming):
            return replace(self, shape=Warming(value))
        if isinstance(self.shape, CustomColumn):
            return replace(self, shape=replace(self.shape, constants={**self.shape.constants, name: value}))
        place = PLACES[self.kind][name]
        a, b, c = (value if k == place else old for k, old in enumerate(self.settings))
        return replace(self, settings=(a, b, c))

    def sliding(self, v: Array) -> Array:
        """The column of a term of dry friction, as the core computes it, from its velocity, (samples,)."""
        return np.asarray(Sliding((self,))(v[None])[0])

    def moves_as(self, other: TermColumn) -> bool:
        """Whether its velocity is that of another term, or its negative."""
        opposite = any(np.array_equal(self.weights, sign * other.weights) for sign in (1, -1))
        return self.joint == other.joint and opposite

    @property
    def for_core(self) -> tuple[str, Array, float, float, float, float]:
        """The term as `haptid._core.Mechanism` takes it."""
        return (self.kind, self.weights, self.offset, *self.settings)


class Sliding:
    """Columns of several terms of dry friction, as the core computes them, from the velocity of each.

    Called with velocities (terms, ...), it gives the columns in the same shape.
    """

    def __init__(self, terms: Sequence[TermColumn]) -> None:
        found = [_sliding_constants(term) for term in terms]
        self._constants = [np.array(values) for values in zip(*found, strict=True)] or [np.zeros(0)] * 5

    def __call__(self, v: Array) -> Array:
        low, high, width, velocity, exponent = (x.reshape(-1, *[1] * (v.ndim - 1)) for x in self._constants)
        side = np.minimum(np.maximum(v, low), high)
        smooth = np.tanh(side / np.where(width > 0, width, 1.0))
        sign = np.where(width > 0, smooth, np.sign(side))
        return np.asarray(sign * np.exp(-((np.abs(v) / velocity) ** exponent)))


def _sliding_constants(term: TermColumn) -> tuple[float, float, float, float, float]:
    """Bounds of the velocities at which dry friction acts, its width, and what it fades by: nothing where infinite."""
    low, high = (0.0 if term.side == side else side * -np.inf for side in (1, -1))
    if term.kind != "stribeck":
        return low, high, term.constant("width"), np.inf, 1.0
    return low, high, term.constant("width"), term.constant("velocity"), term.constant("exponent")


def external_columns(
    terms: tuple[TermColumn, ...],
    joints: tuple[str, ...],
    motion: tuple[Array, Array, Array],
    columns_given: Mapping[str, Array],
) -> Array:
    """Columns that Python computes for the core, (columns, samples).

    Args:
        terms: the external ones, in the core's order.
        joints: names of all joints.
        motion: position, velocity and acceleration of all joints, each (joints, samples).
        columns_given: columns that are computed before, by name, each (samples,).

    Raises:
        DeviceError: a column is not finite at some sample.
    """
    samples = motion[0].shape[1]
    named = dict(_named(joints, motion))
    columns = np.empty((len(terms), samples))
    for row, term in zip(columns, terms, strict=True):
        if isinstance(term.shape, Counterbalance):
            row[:] = term.shape.values(motion[0])
        elif isinstance(term.shape, CustomColumn):
            row[:] = term.shape.values(named, samples)
        else:
            row[:] = columns_given[term.name]
        if not np.isfinite(row).all():
            sample = int(np.argmin(np.isfinite(row)))
            value = float(row[sample])
            cause = (
                f"its expression is {term.shape.text}"
                if isinstance(term.shape, CustomColumn)
                else "the motion is not finite"
            )
            raise DeviceError(
                f"column {term.name} is {value} at sample {sample}: {cause}.",
                where=(term.name, sample),
                found=value,
                advice="Correct the expression, or keep the motion where it is defined.",
            )
    return columns


def _named(joints: tuple[str, ...], motion: tuple[Array, Array, Array]) -> Iterator[tuple[str, Array]]:
    for letter, values in zip("qva", motion, strict=True):
        for joint, row in zip(joints, values, strict=True):
            yield f"{letter}_{joint}", row
