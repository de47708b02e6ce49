"""Constants that the torque is not linear in, by variable projection: all other parameters are taken out first.

For given constants the torque is linear in its parameters, and the triangle tells the best of them at once. What is
left is a function of the constants alone, and its Gauss-Newton step is that of a fit with one more column for each
constant: the difference of the term's column at two neighbouring values (Golub and Pereyra 1973, SIAM J. Numer. Anal.
10(2); Kaufman 1975, BIT 15). Every evaluation is one pass over the motions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.term import Searched
from haptid.dynamics.model import DynamicModel
from haptid.estimation.nonlinear.copies import Copied, Copy, Sought, copied

# Values at which each constant is tried first.
POINTS = 11
# Between neighbouring values, in units of `coordinate`: small beside any interval, large beside rounding.
STEP = 1e-4
# A step is cut to this, in the same units, and small enough to stop below the other.
LONGEST, SETTLED = 0.7, 1e-6
MOST_STEPS = 60
# Levenberg's damping where the search starts, and where it gives up.
DAMPING, HOPELESS = 1e-4, 1e6


def coordinate(constant: Searched, value: float) -> float:
    """By what a constant is searched: its logarithm where it is positive, else its share of its range."""
    return float(np.log(value)) if constant.positive else value / (constant.high - constant.low)


def value_of(constant: Searched, x: float) -> float:
    """The other way round, held to the constant's range."""
    value = np.exp(x) if constant.positive else x * (constant.high - constant.low)
    return float(np.clip(value, constant.low, constant.high))


def coordinates(model: DynamicModel, values: Sequence[float]) -> Array:
    """Of all searched constants, (constants,)."""
    return np.array([coordinate(constant, x) for (_, constant), x in zip(model.device.searched, values, strict=True)])


@dataclass(frozen=True, eq=False)
class Place:
    """Where the search stands.

    Attributes:
        values: of the constants, SI.
        rows: with a copy of each constant's term at a neighbouring value.
        step: how far away that value is, in units of `coordinate`, (constants,).
        square: of the weighted residual.
        beta: parameters of the device's own columns, (p,).
    """

    values: tuple[float, ...]
    rows: Copied
    step: Array
    square: float
    beta: Array


def slopes(rows: Copied, step: Array, beta: Array) -> Array:
    """Change of torque by each constant, as combinations of the rows' columns, (columns, constants).

    Args:
        rows: whose first copies are those of each constant's neighbouring value.
        step: how far away that value is, (constants,).
        beta: parameters of the device's own columns, (p,).
    """
    made = np.zeros((len(rows.observation.base), len(step)))
    for k, term in enumerate(rows.term):
        size = beta[term] / step[k]
        made[rows.own + k, k], made[term, k] = size, -size
    return made


def standing(model: DynamicModel, motions: Sequence[Sought], weights: Array, values: Sequence[float]) -> Place:
    """The rows at given values, and what they leave."""
    here = model.at_constants(values)
    constants = [constant for _, constant in here.device.searched]
    at = coordinates(here, values)
    away = [_neighbour(constant, x) for constant, x in zip(constants, at.tolist(), strict=True)]
    copies = [Copy(k, value_of(constant, x)) for k, (constant, x) in enumerate(zip(constants, away, strict=True))]
    rows = copied(here, motions, copies)
    left = rows.left(weights)
    return Place(tuple(values), rows, np.subtract(away, at), left.square, left.beta)


def _neighbour(constant: Searched, x: float) -> float:
    """A coordinate beside another, inside the range."""
    return x + STEP if value_of(constant, x + STEP) < constant.high else x - STEP


def search(
    model: DynamicModel,
    motions: Sequence[Sought],
    weights: Array,
    values: Sequence[float],
) -> Place:
    """The values that leave least of the torque.

    Args:
        model: with searched constants.
        motions: treated.
        weights: of each motor's rows, (motors,).
        values: where the search starts, SI.
    """
    place = standing(model, motions, weights, values)
    damping = DAMPING
    for _ in range(MOST_STEPS):
        columns, torque = place.rows.taken_out(weights, slopes(place.rows, place.step, place.beta))
        while damping < HOPELESS:
            values = _moved(place, _damped(columns, torque, damping))
            tried = standing(model, motions, weights, values)
            if tried.square < place.square:
                break
            damping *= 10
        else:
            break
        moved = np.abs(coordinates(model, values) - coordinates(model, place.values)).max()
        place, damping = tried, damping / 10
        if moved < SETTLED:
            break
    return place


def _damped(columns: Array, torque: Array, damping: float) -> Array:
    """Levenberg's and Marquardt's step; zero for a constant that changes no torque."""
    sizes = np.linalg.norm(columns, axis=0)
    safe = np.where(sizes > 0, sizes, 1.0)
    A = columns / safe
    step = np.linalg.solve(A.T @ A + damping * np.eye(len(safe)), A.T @ torque) / safe
    return np.asarray(np.where(sizes > 0, np.clip(step, -LONGEST, LONGEST), 0.0))


def _moved(place: Place, step: Array) -> tuple[float, ...]:
    model = place.rows.model
    x = (coordinates(model, place.values) + step).tolist()
    return tuple(value_of(constant, at) for (_, constant), at in zip(model.device.searched, x, strict=True))


def scanned(model: DynamicModel, motions: Sequence[Sought], weights: Array) -> tuple[float, ...]:
    """The best of some values of each constant, the others where they start: one pass over the motions."""
    start = [model.terms[k].constant(constant.name) for k, constant in model.device.searched]
    copies = [
        Copy(k, value_of(constant, float(x)))
        for k, (_, constant) in enumerate(model.device.searched)
        for x in np.linspace(coordinate(constant, constant.low), coordinate(constant, constant.high), POINTS)
    ]
    rows = copied(model, motions, copies)
    best, found = dict.fromkeys(range(len(start)), rows.left(weights).square), list(start)
    for number, copy in enumerate(copies):
        square = rows.left(weights, {copy.constant: number}).square
        if square < best[copy.constant]:
            best[copy.constant], found[copy.constant] = square, copy.value
    return tuple(found)
