"""Quasi-Newton descent of a motion's cost with the penalties of its joints' limits in the model of every step.

In a Fourier series positions, velocities and accelerations are affine in the coefficients, so that the penalties, the
squares of what is beyond a limit, are known for every step in advance. A step minimises them and a quadratic model of
the rest of the cost; only that has its curvature from differences of slopes. So a descent of an arm's 77 coefficients
is at its end after a hundred evaluations; with all of the curvature from slopes, as in L-BFGS, it is not after a
thousand, as the penalties are much steeper than the criterion and begin and end with every step.

Source: Nocedal and Wright (2006), Numerical Optimization, sections 7.3 and 18.3 (damped BFGS, procedure 18.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.experiment.excitation.families import Basis
from haptid.experiment.excitation.limits import MotionBounds

# Curvature of the cost at first, per square of the unit cube's side; a first step is not longer than _FIRST of it.
CURVED, _FIRST = 10.0, 0.3
# Newton steps of a model, those along a line, and the share of its slope at which they end.
_NEWTON, _ALONG, _FLAT = 4, 12, 3e-2
# Share of the predicted decrease that a step has to reach, and of a step that is too long.
_ARMIJO, _SHORTER = 1e-4, 0.4
# Share of a step below which a descent is at its end: rows jump where the sign of a velocity changes.
_LEAST_STEP = 0.02
# Decrease of a step, in those that are worth one, at which a descent is at its end too.
_LITTLE = 0.3
# Damping of the update of the curvature (Powell 1978), and smallest curvature relative to the mean.
_DAMPED, _LEAST_CURVATURE = 0.2, 1e-9
# Distance in the unit cube below which two motions are in the same valley of the cost.
_VALLEY = 0.3


@dataclass(frozen=True, eq=False)
class Start:
    """A point in the unit cube, the seed of its phases, and where a descent ended its cost and its curvature."""

    x: Array
    seed: int
    cost: float = np.inf
    curvature: Array | None = None


def apart(found: list[Start]) -> list[Start]:
    """The best of those that are near to each other: they are in the same valley."""
    made: list[Start] = []
    for start in found:
        if all(start.seed != one.seed or np.linalg.norm(start.x - one.x) > _VALLEY for one in made):
            made.append(start)
    return made


@dataclass(frozen=True, eq=False)
class Penalties:
    """Sums of squares of what is beyond the limits of a motion, as a function of its point in a family.

    Limits of positions, velocities and accelerations are exact, those of other states linear about a point.

    Attributes:
        own: which entries of the point move each joint, (k,) for each.
        rows: states relative to their limits by these entries, (3 n, k) for each joint; zero without a limit.
        low, high: limits of these, then of the others, (joints * 3 n + m,).
        weight: of the squares.
        others: excesses of other limits by the point, (m, size).
    """

    own: tuple[np.ndarray, ...]
    rows: tuple[Array, ...]
    low: Array
    high: Array
    weight: float
    others: Array

    @staticmethod
    def of(bounds: MotionBounds, basis: Basis, size: int, margin: float) -> Penalties:
        """Those of the joints' limits, within them by a margin relative to their size; their mean, of unit weight."""
        (below, above), n = bounds.position.T, basis.offset.shape[2]
        units = np.array([above - below, bounds.speed, bounds.acceleration])
        limited = np.isfinite(units)
        units = np.where(limited, units, 1.0)
        offset = basis.offset / units[:, :, None] * limited[:, :, None]
        high = np.array([above / units[0], *np.ones((2, len(above)))])[:, :, None] - offset - margin
        low = np.array([below / units[0], *-np.ones((2, len(above)))])[:, :, None] - offset + margin
        scale = np.repeat(limited / units, n, axis=0).T[:, :, None]
        rows = tuple(np.ascontiguousarray(own * by) for own, by in zip(basis.functions, scale, strict=True))
        low, high = (x.transpose(1, 0, 2).ravel() for x in (low, high))
        return Penalties(basis.own, rows, low, high, 1.0 / n, np.zeros((0, size)))

    def about(self, others: Array, weight: float) -> Penalties:
        """With other limits, whose excesses have the derivatives `others` by the point, (m, size), and a weight."""
        n, m = len(self.low) - len(self.others), len(others)
        low, high = np.r_[self.low[:n], np.full(m, -np.inf)], np.r_[self.high[:n], np.zeros(m)]
        return replace(self, low=low, high=high, weight=weight * self.weight, others=others)

    def along(self, x: Array) -> Array:
        """What is limited, relative to its limits, changes by so much with a change of the point, (size,)."""
        return np.concatenate(
            [*(rows @ x[own] for own, rows in zip(self.own, self.rows, strict=True)), self.others @ x]
        )

    def beyond(self, state: Array) -> Array:
        """How far what is limited is beyond its limits; below zero beyond the lower ones."""
        return np.asarray(state - np.clip(state, self.low, self.high))

    def cost(self, beyond: Array) -> float:
        """The penalty."""
        return self.weight * float(beyond @ beyond)

    def gradient(self, beyond: Array) -> Array:
        """Its gradient, (size,)."""
        made = beyond[len(beyond) - len(self.others) :] @ self.others
        for own, rows, over in zip(self.own, self.rows, self._by_joint(beyond), strict=True):
            made[own] += over @ rows
        return np.asarray(2 * self.weight * made)

    def curvature(self, beyond: Array) -> Array:
        """Its second derivatives, (size, size)."""
        there = self.others[beyond[len(beyond) - len(self.others) :] != 0]
        made = there.T @ there
        for own, rows, over in zip(self.own, self.rows, self._by_joint(beyond), strict=True):
            there = rows[over != 0]
            made[own[:, None], own] += there.T @ there
        return np.asarray(2 * self.weight * made)

    def _by_joint(self, beyond: Array) -> Array:
        """Of the joints' states, (joints, 3 n)."""
        return beyond[: len(beyond) - len(self.others)].reshape(len(self.own), -1)


@dataclass(frozen=True, eq=False)
class Costs:
    """A point's cost in parts.

    Attributes:
        value: what is smooth, without the penalties of limits of single samples.
        slope: its gradient, (size,).
        over: excesses of limits other than those of joints, (m,).
        others: their derivatives by the point, (m, size).
    """

    value: float
    slope: Array
    over: Array
    others: Array


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent ends.

    Attributes:
        x: the point, (size,).
        cost: with the penalties.
        curvature: second derivatives of the cost without the joints' penalties, positive definite, (size, size).
        used: number of evaluations.
    """

    x: Array
    cost: float
    curvature: Array
    used: int


def descend(
    costs: Callable[[Array], Costs],
    joints: Penalties,
    x: Array,
    weight: float,
    *,
    most: int,
    enough: float,
    curvature: Array | None = None,
) -> Descent:
    """Descend from a point until no step is predicted to lower the cost by more than `enough`.

    Args:
        costs: of a point.
        joints: penalties of the joints' limits.
        x: the point, (size,).
        weight: of the penalties.
        most: largest number of evaluations.
        enough: least decrease that is worth a step.
        curvature: of an earlier descent near the point, (size, size).
    """
    found, used = costs(x), 1
    state = joints.along(x)
    penalties, whole, penalty = _penalised(joints, state, found, weight)
    if curvature is None:
        curvature = max(CURVED, float(np.linalg.norm(found.slope)) / _FIRST) * np.eye(len(x))
    while used < most:
        step, along, predicted = _model_step(penalties, found.slope, curvature, whole)
        if not predicted < -enough:
            break
        length, lower = 1.0, False
        while used < most and length > _LEAST_STEP and not lower:
            new, new_state = costs(x + length * step), state + length * along[: len(state)]
            made, used = _penalised(joints, new_state, new, weight), used + 1
            gain = found.value + penalty - new.value - made[2]
            lower = gain >= -_ARMIJO * length * predicted
            tried, length = length, length if lower else _SHORTER * length
        curvature = _updated(curvature, tried * step, new.slope - found.slope)
        if not lower:
            break
        x, state, found, (penalties, whole, penalty) = x + tried * step, new_state, new, made
        if gain < _LITTLE * enough:
            break
    return Descent(x, found.value + penalty, curvature, used)


def _penalised(joints: Penalties, state: Array, found: Costs, weight: float) -> tuple[Penalties, Array, float]:
    """Penalties about a point, what is limited there, and their cost."""
    penalties, whole = joints.about(found.others, weight), np.r_[state, found.over]
    return penalties, whole, penalties.cost(penalties.beyond(whole))


def _model_step(penalties: Penalties, slope: Array, curvature: Array, state: Array) -> tuple[Array, Array, float]:
    """Step to the least of a model, how what is limited changes along it, and the change of the model.

    The model is quadratic but for the penalties, convex and piecewise quadratic: Newton steps with line searches.
    """
    step, along, bent, steep = np.zeros_like(slope), np.zeros_like(state), np.zeros_like(slope), np.inf
    beyond, least = penalties.beyond(state), _LEAST_CURVATURE * np.trace(curvature) / len(slope)
    before, curvature = penalties.cost(beyond), curvature + least * np.eye(len(slope))
    for k in range(_NEWTON):
        gradient = slope + bent + penalties.gradient(beyond)
        now = float(np.linalg.norm(gradient))
        steep = now if k == 0 else steep
        if k and now < _FLAT * steep:
            break
        direction = linalg.lapack.dposv(curvature + penalties.curvature(beyond), -gradient)[1]
        by, more = penalties.along(direction), curvature @ direction
        slopes = float(gradient @ direction), float((slope + bent) @ direction), float(direction @ more)
        t = _least_along(penalties, state + along, by, slopes)
        step, along, bent = step + t * direction, along + t * by, bent + t * more
        beyond = penalties.beyond(state + along)
    return step, along, float(slope @ step + 0.5 * step @ bent) + penalties.cost(beyond) - before


def _least_along(penalties: Penalties, state: Array, by: Array, slopes: tuple[float, float, float]) -> float:
    """Where a model is least along a direction: the zero of its slope, which grows piecewise linearly, by Newton.

    Args:
        state: where the direction begins.
        by: how it changes along the direction.
        slopes: of the model there, and slope and curvature of the model without the penalties.
    """
    steep, slope, curvature = slopes
    low, high, t, scale = 0.0, np.inf, 1.0, 2 * penalties.weight
    for _ in range(_ALONG):
        beyond = penalties.beyond(state + t * by)
        now = slope + t * curvature + scale * float(beyond @ by)
        if abs(now) <= _FLAT * abs(steep):
            break
        low, high = (low, t) if now > 0 else (t, high)
        newton = t - now / (curvature + scale * float(np.square(by) @ (beyond != 0)))
        t = newton if low < newton < high else (0.5 * (low + high) if np.isfinite(high) else 2 * t)
    return t


def _updated(curvature: Array, step: Array, change: Array) -> Array:
    """Damped BFGS update: it stays positive definite."""
    bent = curvature @ step
    had, found = float(step @ bent), float(step @ change)
    if not had > 0 or not np.isfinite(found):
        return curvature
    if found < _DAMPED * had:
        share = (1 - _DAMPED) * had / (had - found)
        change = share * change + (1 - share) * bent
    return np.asarray(curvature - np.outer(bent, bent) / had + np.outer(change, change) / float(step @ change))
