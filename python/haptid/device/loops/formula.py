"""Loop closure by polynomials: passive joints at positions that are polynomials of the active ones, without cuts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.expressions import JointPolynomial
from haptid.device.loops.linear import Closure, Followed
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parts import Cut, Joint

# Random poses of a joint without limits are drawn from this range about zero, rad or m.
_RANGE = 1.0


@dataclass(frozen=True, eq=False)
class FormulaClosure:
    """Passive joints as polynomials of the active ones; some of the rates vary with the pose.

    Attributes:
        symbols: of the active joints in the polynomials, (active,).
        polynomials: positions of the joints whose rates vary, by index.
        constant: constant rates, of the other joints, (joints, active); rows of the former are zero.
        offset: of the same joints, (joints,), rad or m.
        varying: which rates vary with the pose, (joints, active).
        ranges: limits of the active joints, (active, 2), rad or m.
        relations: as text, one for each passive joint.
    """

    symbols: tuple[str, ...]
    polynomials: Mapping[int, JointPolynomial]
    constant: Array
    offset: Array
    varying: np.ndarray
    ranges: Array
    relations: tuple[str, ...]

    def __post_init__(self) -> None:
        joints, active = self.constant.shape
        freeze_fields(self, "constant", offset=(joints,), ranges=(active, 2))
        expect("varying", self.varying.shape, (joints, active))
        self.varying.flags.writeable = False

    @property
    def cuts(self) -> tuple[Cut, ...]:
        """The joints that were cut: none."""
        return ()

    @property
    def error(self) -> float:
        """Greatest closure error, m: there are no cuts."""
        return 0.0

    @property
    def unknown(self) -> tuple[int, ...]:
        """Indices of the joints whose rates vary."""
        return tuple(self.polynomials)

    @property
    def units(self) -> Array:
        """Scale of each joint's position, (joints,), rad or m."""
        return np.ones(len(self.offset))

    @cached_property
    def _slopes(self) -> dict[tuple[int, int], tuple[JointPolynomial, tuple[JointPolynomial, ...]]]:
        """Rate of each joint by each active one that it depends on, and the derivatives of that rate by all of them."""
        slopes = {}
        for j, polynomial in self.polynomials.items():
            for a in np.flatnonzero(self.varying[j]).tolist():
                slope = polynomial.slope(self.symbols[a])
                slopes[j, a] = slope, tuple(slope.slope(symbol) for symbol in self.symbols)
        return slopes

    def positions(self, qa: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples), rad or m."""
        values = dict(zip(self.symbols, qa, strict=True))
        q = np.asarray(self.constant @ qa + self.offset[:, None])
        for j, polynomial in self.polynomials.items():
            q[j] = polynomial.value(values)
        return q

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities.

        Args:
            qa: (active, samples), rad or m.
            qda: the same, per second; at rest where None.
        """
        values = dict(zip(self.symbols, qa, strict=True))
        G = np.repeat(self.constant[None], qa.shape[1], axis=0)
        Gd = np.zeros_like(G)
        for (j, a), (slope, bends) in self._slopes.items():
            G[:, j, a] = slope.value(values)
            if qda is not None:
                Gd[:, j, a] = sum(bend.value(values) * rate for bend, rate in zip(bends, qda, strict=True))
        return Followed(freeze(self.positions(qa)), freeze(G), freeze(Gd))

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close, (samples,): at every pose."""
        return np.ones(qa.shape[1], dtype=bool)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random poses of the active joints within their limits, (active, count)."""
        low, high = self.ranges.T
        return rng.uniform(low[:, None], high[:, None], (len(low), count))


AnyClosure = Closure | NewtonClosure | FormulaClosure


def formula_closure(
    joints: Sequence[Joint], active: Sequence[int], polynomials: Mapping[int, JointPolynomial], relations: Sequence[str]
) -> FormulaClosure:
    """The closure by polynomials of the passive joints in the symbols of the active ones, `q` and the joint's name."""
    symbols = tuple(f"q{joints[k].name}" for k in active)
    constant, offset = np.zeros((len(joints), len(active))), np.zeros(len(joints))
    constant[list(active), np.arange(len(active))] = 1.0
    varying = np.zeros(constant.shape, dtype=bool)
    for j, polynomial in polynomials.items():
        linear = polynomial.linear
        if linear is None:
            varying[j] = [symbol in polynomial.symbols for symbol in symbols]
        else:
            constant[j] = [linear.factors.get(symbol, 0.0) for symbol in symbols]
            offset[j] = linear.constant
    bent = {j: polynomial for j, polynomial in sorted(polynomials.items()) if varying[j].any()}
    limits = [joints[k].position_limits or (-_RANGE, _RANGE) for k in active]
    return FormulaClosure(symbols, bent, constant, offset, varying, np.array(limits, dtype=float), tuple(relations))
