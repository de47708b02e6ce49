"""`variable_projection`: what was found, with intervals that take the constants' own doubt in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import UnsearchableError
from haptid.estimation.estimate import fitted
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.spread import Intervals, Spread
from haptid.estimation.method import Method, Reduced, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.estimation.nonlinear.copies import Copied, Copy, Sought, copied
from haptid.estimation.nonlinear.search import Place, coordinate, scanned, search, slopes, standing, value_of

# Weights of the start stand for a model that does not fit yet: search with them, then once more with better ones.
SEARCHES = 2
# Points of a profile, and how many deviations it looks to either side.
POINTS, FAR = 41, 6.0
# A constant is at a limit of its range when it is this near, in units of its coordinate.
AT_LIMIT = 1e-3


@dataclass(frozen=True)
class Constant:
    """A constant as found.

    Attributes:
        name: "FS1.velocity": the parameter of its term, and its own name.
        unit: of the constant.
        value: SI.
        se: deviation of its linearised fit, honest; NaN where no torque shows it.
        interval: 95 % by profile likelihood, its width that of the honest deviation; an end at a limit of the range
            means that the log does not bound it.
        low, high: the range in which it was searched.
    """

    name: str
    unit: str
    value: float
    se: float
    interval: tuple[float, float]
    low: float
    high: float

    @property
    def bounded(self) -> bool:
        """Whether the log bounds it on both sides."""
        return self.low < self.interval[0] and self.interval[1] < self.high


@dataclass(frozen=True, eq=False)
class Joint:
    """Intervals of a fit whose constants were searched: how far these may be off is in them.

    Attributes:
        inner: intervals of a fit that is linear in everything.
        fit: of the rows with one more column for each constant.
        own: how the base parameters are combined of its parameters, (p, columns).
    """

    inner: Intervals
    fit: Fit
    own: Array

    @property
    def name(self) -> str:
        return f"{self.inner.name}; searched constants among the parameters"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """As of every kind of interval; `fit` is the one with the constants held, and is not asked."""
        del fit
        return self.inner.spread(self.fit, self.own if combinations is None else combinations @ self.own)


@dataclass(frozen=True, eq=False)
class VariableProjection:
    """Searched constants, and the device that has them.

    Attributes:
        model: linear in all other parameters.
        constants: in the order of the device's terms.
        intervals: to be handed to `estimate`.
        notes: sentences a user should read.
    """

    model: DynamicModel
    constants: tuple[Constant, ...]
    intervals: Joint
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> Constant:
        return next(constant for constant in self.constants if constant.name == name)


def variable_projection(
    model: DynamicModel,
    motions: Sequence[Sought],
    method: Method | None = None,
    intervals: Intervals | None = None,
    progress: Callable[[float], None] | None = None,
) -> VariableProjection:
    """Search the constants that a device file leaves open: Stribeck velocities, exponents, widths, a user's own.

    Args:
        model: with searched constants.
        motions: treated, or every other block of one.
        method: of estimation, `WLS()` where None; the search weighs motors as it does.
        intervals: `ClusterRobust()` where None.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        UnsearchableError: the device has none, or one whose term shares its parameter with another term.
        MethodSettingError: the method does more than weigh, reduce or hold.
        HaptidError: as `observe` and `estimate`.
    """
    weighting = getattr(method, "weighting", method) or WLS()
    expect_weighting("variable projection", weighting)
    _check(model)
    tell = progress or (lambda _: None)
    start = [model.terms[k].constant(constant.name) for k, constant in model.device.searched]
    weights = weighting.weights(standing(model, motions, np.ones(len(model.device.measured)), start).rows.observation)
    values = scanned(model, motions, weights)
    for many in range(SEARCHES):
        place = search(model, motions, weights, values)
        values, weights = place.values, weighting.weights(place.rows.observation)
        tell((many + 1) / (SEARCHES + 1))
    zero = method.zero(place.rows.observation) if isinstance(method, Reduced) else ()
    fit = fitted(place.rows.observation, weighting, zero)
    inner = intervals or ClusterRobust()
    constants = tuple(_constant(place, motions, fit, inner, k) for k in range(len(start)))
    tell(1.0)
    made = Joint(inner, fit, _own(place.rows))
    return VariableProjection(place.rows.model, constants, made, tuple(_notes(constants)))


def _check(model: DynamicModel) -> None:
    if not model.device.searched:
        raise UnsearchableError(model.device.name, "no term of it has a constant to be searched")
    kept = [model.device.parameters.members[k] for k in model.base.independent_columns]
    for k, constant in model.device.searched:
        name = model.terms[k].name
        members = next((names for names in kept if name in names), ())
        if len(members) != 1:
            why = (
                f"{name} is one parameter with {', '.join(n for n in members if n != name)}"
                if members
                else "no torque shows it apart"
            )
            raise UnsearchableError(
                model.device.name, f"{name}.{constant.name} belongs to no parameter of its own: {why}"
            )


def _own(rows: Copied) -> Array:
    """Base parameters from those of the rows with copies, (p, columns): a term's is the sum of all of its own."""
    made = np.eye(rows.own, rows.own + len(rows.copies))
    made[list(rows.term), rows.own + np.arange(len(rows.term))] = 1.0
    return made


def _constant(place: Place, motions: Sequence[Sought], fit: Fit, intervals: Intervals, k: int) -> Constant:
    rows = place.rows
    term, searched = rows.model.device.searched[k]
    name, value = f"{rows.model.terms[term].name}.{searched.name}", place.values[k]
    ends = searched.low, searched.high
    beta = place.beta[rows.term[k]]
    if not beta:
        return Constant(name, searched.unit, value, float("nan"), ends, *ends)
    # The copy's parameter is that of the term times the move, as a share of the step between both.
    row = np.zeros((1, len(rows.observation.base)))
    row[0, rows.own + k] = place.step[k] / beta
    spread = intervals.spread(fit, row)
    honest = float(np.sqrt(spread.covariance[0, 0]))
    classical = float(np.sqrt((row @ fit.solution.classical_covariance(fit.unit_residual) @ row.T)[0, 0]))
    noise = 1.0 if fit.unit_residual else fit.solution.rest**2 / fit.solution.dof
    most = stats.t.ppf(0.975, spread.dof[0]) ** 2 * noise * (honest / classical) ** 2
    interval = _profile(place, motions, fit.weights, k, honest, float(most))
    slope = value if searched.positive else searched.high - searched.low
    return Constant(name, searched.unit, value, honest * slope, interval, *ends)


def _profile(
    place: Place, motions: Sequence[Sought], weights: Array, k: int, se: float, most: float
) -> tuple[float, float]:
    """Where the squared residual has grown by `most`, all else fitted anew, the other constants to first order."""
    model = place.rows.model
    constant = model.device.searched[k][1]
    x, ends = coordinate(constant, place.values[k]), [coordinate(constant, e) for e in (constant.low, constant.high)]
    grid = np.linspace(max(x - FAR * se, ends[0]), min(x + FAR * se, ends[1]), POINTS)
    tried = [Copy(k, value_of(constant, at)) for at in grid.tolist()]
    rows = copied(model, motions, [*place.rows.copies, *tried])
    first = len(place.rows.copies)
    others = np.delete(slopes(rows, place.step, place.beta), k, axis=1)
    squares = [rows.left(weights, {k: first + number}, others).square for number in range(POINTS)]
    grown = np.array(squares) - rows.left(weights, beside=others).square
    low, high = (x + side * _crossing(side * (grid - x), grown, float(np.sqrt(most))) for side in (-1, 1))
    return value_of(constant, low), value_of(constant, high)


def _crossing(away: Array, grown: Array, limit: float) -> float:
    """How far away from the least the root of a profile first passes a limit; the farthest point where it does not."""
    order = np.argsort(away)
    order = order[away[order] > 0]
    distance = np.append(0.0, away[order])
    root = np.append(0.0, np.sqrt(np.maximum(grown[order], 0.0)))
    beyond = np.flatnonzero(root > limit)
    if not len(beyond):
        return float(distance[-1])
    k = int(beyond[0])
    share = (limit - root[k - 1]) / (root[k] - root[k - 1])
    return float(distance[k - 1] + share * (distance[k] - distance[k - 1]))


def _notes(constants: Sequence[Constant]) -> Iterator[str]:
    """What a user should know of the constants."""
    for c in constants:
        (low, high), unit = c.interval, f" {c.unit}" if c.unit else ""
        ends = [end for end in (c.low, c.high) if np.isclose(c.value, end, rtol=AT_LIMIT)]
        if np.isnan(c.se):
            yield f"{c.name}: the log tells nothing of it, as its term adds no torque here."
        elif ends:
            yield f"{c.name} is at the end of its range, {ends[0]:g}{unit}: widen the range, or give the constant."
        elif not c.bounded:
            yield f"{c.name} is hardly told by this log: it may be anything from {low:.3g} to {high:.3g}{unit}."
