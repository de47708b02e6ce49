"""Variable projection: least squares in which constants of friction enter nonlinearly (Stribeck velocities, exponents).

For given constants the torque is linear in its parameters, which are eliminated by QR. What remains is a function of
the constants alone, and its Gauss-Newton step is that of a fit with one more column for each constant: the difference
of the term's column at two neighbouring values (Golub and Pereyra 1973, SIAM J. Numer. Anal. 10(2); Kaufman 1975, BIT
15). Every evaluation is one pass over the motions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.terms.term import Searched
from haptid.dynamics.model import DynamicModel
from haptid.errors import EstimationError, SettingError, index_of
from haptid.estimation.estimate import fitted
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.covariance import Intervals, Spread
from haptid.estimation.method import Fit, Method, Reduced, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.estimation.nonlinear.candidate_columns import (
    Candidate,
    CandidateRows,
    RowSource,
    candidate_rows,
    observed_candidates,
)
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import LEVEL, half_width

# Weights at the start belong to a model that does not fit yet: search with them, then again with better ones.
SEARCHES = 2
# Values of each constant in the initial grid search.
GRID_POINTS = 11
# Difference step, in units of `coordinate`: small compared with any interval, large compared with rounding.
_STEP = 1e-4
# Largest step, and largest step at convergence, in the same units.
LONGEST_STEP, _CONVERGED = 0.7, 1e-6
_MOST_STEPS = 60
# Levenberg-Marquardt damping at the start, and where the search stops.
_DAMPING, MOST_DAMPING = 1e-4, 1e6
# Points of a likelihood profile, and its extent to either side in standard errors.
PROFILE_POINTS, PROFILE_EXTENT = 41, 6.0
# A constant is at a limit of its range when it is this near, relative to the limit.
_AT_LIMIT = 1e-3


@dataclass(frozen=True, eq=False)
class _Profile:
    """Likelihood profile of one constant: increase of the squared residual, all other parameters fitted again.

    Attributes:
        name: of the constant.
        searched: the constant and its range.
        x: its estimate, in units of `coordinate`.
        grid: values of the profile, in the same units, (points,).
        increase: of the weighted squared residual over its minimum, (points,).
        noise: variance of the weighted residual.
        ratio: cluster-robust over classical standard error.
        dof: degrees of freedom.
    """

    name: str
    searched: Searched
    x: float
    grid: Array
    increase: Array
    noise: float
    ratio: float
    dof: float

    def conf_int(self, level: float) -> tuple[float, float]:
        """Where the increase is t^2 times the noise variance and the squared ratio; at most the ends of the grid.

        Raises:
            SettingError: the profile does not extend to this level.
        """
        t = float(half_width(1.0, self.dof, level))
        ends = [coordinate(self.searched, end) for end in (self.searched.low, self.searched.high)]
        if level > LEVEL and t > PROFILE_EXTENT and (self.grid[0] > ends[0] or self.grid[-1] < ends[1]):
            most = float(1 - 2 * t_tail(PROFILE_EXTENT, self.dof))
            raise SettingError(
                f"{self.name}: the likelihood profile extends to {PROFILE_EXTENT:g} standard errors, too little "
                f"for the level {level:g} (at most {most:.4g}).",
                where="level",
                found=level,
                limit=most,
                advice="Record longer, so that there are more degrees of freedom, or use a lower level.",
            )
        limit = float(np.sqrt(t**2 * self.noise * self.ratio**2))
        low, high = (self.x + side * _crossing(side * (self.grid - self.x), self.increase, limit) for side in (-1, 1))
        return value_of(self.searched, low), value_of(self.searched, high)


def _crossing(away: Array, increase: Array, limit: float) -> float:
    """Distance at which the root of a profile first exceeds a limit; that of the last point where it does not."""
    order = np.argsort(away)
    order = order[away[order] > 0]
    distance = np.append(0.0, away[order])
    root = np.append(0.0, np.sqrt(np.maximum(increase[order], 0.0)))
    beyond = np.flatnonzero(root > limit)
    if not len(beyond):
        return float(distance[-1])
    k = int(beyond[0])
    share = (limit - root[k - 1]) / (root[k] - root[k - 1])
    return float(distance[k - 1] + share * (distance[k] - distance[k - 1]))


@dataclass(frozen=True)
class SearchedConstant:
    """An estimated nonlinear constant.

    Attributes:
        name: "FS1.velocity": the parameter of its term, and its own name.
        unit: of the constant.
        value: SI.
        se: cluster-robust standard error of its linearised fit; NaN where it has no effect on torque.
        low, high: the range in which it was searched.
        profile: its likelihood profile; None where it has no effect on torque.
    """

    name: str
    unit: str
    value: float
    se: float
    low: float
    high: float
    profile: _Profile | None = field(default=None, repr=False, compare=False)

    def conf_int(self, level: float = LEVEL) -> tuple[float, float]:
        """Confidence interval by profile likelihood, scaled to the cluster-robust standard error.

        An end at a limit of the range means that the log does not bound it.

        Raises:
            SettingError: the profile does not extend to this level.
        """
        return (self.low, self.high) if self.profile is None else self.profile.conf_int(level)

    @property
    def bounded(self) -> bool:
        """Whether the interval is bounded by the log on both sides."""
        low, high = self.conf_int()
        return self.low < low and high < self.high


@dataclass(frozen=True, eq=False)
class _Joint:
    """Intervals of a fit with searched constants, which include the uncertainty of these constants.

    Attributes:
        inner: covariance estimator of a fit that is linear in all parameters.
        fit: of the rows with one more column for each constant.
        own: the base parameters as combinations of the parameters of that fit, (p, columns).
    """

    inner: Intervals
    fit: Fit
    own: Array

    @property
    def name(self) -> str:
        return f"{self.inner.name}; searched constants among the parameters"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of combinations of base parameters; `fit`, which has the constants fixed, is not used."""
        del fit
        return self.inner.spread(self.fit, self.own if combinations is None else combinations @ self.own)


@dataclass(frozen=True, eq=False)
class VariableProjection:
    """Estimated nonlinear constants, and the model with their values.

    Attributes:
        model: linear in all other parameters.
        constants: in the order of the device's terms.
        intervals: for `estimate`.
        notes: for the user.
    """

    model: DynamicModel
    constants: tuple[SearchedConstant, ...]
    intervals: _Joint
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> SearchedConstant:
        return self.constants[index_of(name, [constant.name for constant in self.constants], "nonlinear constant")]


def variable_projection(
    model: DynamicModel,
    motions: Sequence[RowSource],
    method: Method | None = None,
    intervals: Intervals | None = None,
    progress: Callable[[float], None] | None = None,
) -> VariableProjection:
    """Estimate the constants that a device file leaves open: Stribeck velocities, exponents, widths, user-defined ones.

    Args:
        model: with searched constants.
        motions: treated, or every other block of one.
        method: of estimation, `WLS()` where None; the search weights motors as it does.
        intervals: `ClusterRobust()` where None.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        EstimationError: the device has none, or one whose term is regrouped with another term.
        SettingError: the method does more than weight rows, fix parameters at zero or constrain them.
        HaptidError: as `observe` and `estimate`.
    """
    weighting = getattr(method, "weighting", method) or WLS()
    expect_weighting("variable projection", weighting)
    _check_searchable(model)
    report = progress or (lambda _: None)
    weights = weighting.weights(observed_candidates(model, motions))  # where a constant may have no effect yet
    values = grid_search(model, motions, weights)
    for search_number in range(SEARCHES):
        iterate = search(model, motions, weights, values)
        values, weights = iterate.values, weighting.weights(iterate.rows.observation)
        report((search_number + 1) / (SEARCHES + 1))
    zero = method.zero(iterate.rows.observation) if isinstance(method, Reduced) else ()
    fit = fitted(iterate.rows.observation, weighting, zero)
    inner = intervals or ClusterRobust()
    constants = tuple(_constant(iterate, motions, fit, inner, k) for k in range(len(values)))
    report(1.0)
    joint = _Joint(inner, fit, _own_parameters(iterate.rows))
    return VariableProjection(iterate.rows.model, constants, joint, tuple(_notes(constants)))


def _check_searchable(model: DynamicModel) -> None:
    """Raise EstimationError where there is no constant to search, or where its term is regrouped."""
    why = "no term of it has a constant to be searched"
    kept = [model.device.parameters.members[k] for k in model.base.independent_columns]
    for k, constant in model.device.searched:
        name = model.terms[k].name
        members = next((names for names in kept if name in names), ())
        if len(members) != 1:
            others = ", ".join(n for n in members if n != name)
            why = f"{name}.{constant.name} belongs to no parameter of its own: "
            why += f"{name} is one parameter with {others}" if members else "it has no separate effect on torque"
            break
    else:
        if model.device.searched:
            return
    raise EstimationError(
        f"{model.device.name}: {why}.",
        where=model.device.name,
        advice="Write a constant as velocity = { start = 0.05, low = 0.005, high = 0.5 }, each term on its own.",
    )


def coordinate(constant: Searched, value: float) -> float:
    """The variable of the search: the logarithm of a positive constant, else the constant relative to its range."""
    return float(np.log(value)) if constant.positive else value / (constant.high - constant.low)


def value_of(constant: Searched, x: float) -> float:
    """The inverse of `coordinate`, limited to the constant's range."""
    value = np.exp(x) if constant.positive else x * (constant.high - constant.low)
    return float(np.clip(value, constant.low, constant.high))


def _coordinates(model: DynamicModel, values: Sequence[float]) -> Array:
    """Of all searched constants, (constants,)."""
    return np.array([coordinate(constant, x) for (_, constant), x in zip(model.device.searched, values, strict=True)])


@dataclass(frozen=True, eq=False)
class Iterate:
    """The model evaluated at values of its constants, an iterate of the search.

    Attributes:
        values: of the constants, SI.
        rows: with each constant's term at a neighbouring value as candidates.
        step: distance of that value, in units of `coordinate`, (constants,).
        square: sum of squares of the weighted residual.
        beta: parameters of the model's own columns, (p,).
    """

    values: tuple[float, ...]
    rows: CandidateRows
    step: Array
    square: float
    beta: Array


def evaluated(model: DynamicModel, motions: Sequence[RowSource], weights: Array, values: Sequence[float]) -> Iterate:
    """The rows at given values, and their least-squares fit."""
    model_here = model.at_constants(values)
    constants = [constant for _, constant in model_here.device.searched]
    coordinates = _coordinates(model_here, values)
    # A neighbour inside the range.
    away = [
        x + _STEP if value_of(constant, x + _STEP) < constant.high else x - _STEP
        for constant, x in zip(constants, coordinates.tolist(), strict=True)
    ]
    neighbours = [Candidate(k, value_of(c, x)) for k, (c, x) in enumerate(zip(constants, away, strict=True))]
    rows = candidate_rows(model_here, motions, neighbours)
    fit = rows.fit(weights)
    return Iterate(tuple(values), rows, np.subtract(away, coordinates), fit.square, fit.beta)


def derivatives(rows: CandidateRows, step: Array, beta: Array) -> Array:
    """Derivative of torque by each constant, as combinations of the rows' columns, (columns, constants).

    Args:
        rows: whose first candidates are those of each constant's neighbouring value.
        step: distance of that value, (constants,).
        beta: parameters of the model's own columns, (p,).
    """
    combinations = np.zeros((len(rows.observation.base), len(step)))
    for k, term in enumerate(rows.term):
        size = beta[term] / step[k]
        combinations[rows.own + k, k], combinations[term, k] = size, -size
    return combinations


def grid_search(model: DynamicModel, motions: Sequence[RowSource], weights: Array) -> tuple[float, ...]:
    """The best of a grid of values of each constant, the others at their start: one pass over the motions."""
    best = [model.terms[k].constant(constant.name) for k, constant in model.device.searched]
    candidates = [
        Candidate(k, value_of(constant, float(x)))
        for k, (_, constant) in enumerate(model.device.searched)
        for x in np.linspace(coordinate(constant, constant.low), coordinate(constant, constant.high), GRID_POINTS)
    ]
    rows = candidate_rows(model, motions, candidates)
    least = dict.fromkeys(range(len(best)), rows.fit(weights).square)
    for number, candidate in enumerate(candidates):
        square = rows.fit(weights, {candidate.constant: number}).square
        if square < least[candidate.constant]:
            least[candidate.constant], best[candidate.constant] = square, candidate.value
    return tuple(best)


def search(model: DynamicModel, motions: Sequence[RowSource], weights: Array, values: Sequence[float]) -> Iterate:
    """Levenberg-Marquardt minimisation of the weighted squared residual over the constants.

    Args:
        model: with searched constants.
        motions: treated.
        weights: of each motor's rows, (motors,).
        values: initial ones, SI.
    """
    iterate = evaluated(model, motions, weights, values)
    damping = _DAMPING
    for _ in range(_MOST_STEPS):
        columns, torque = iterate.rows.projected(weights, derivatives(iterate.rows, iterate.step, iterate.beta))
        while damping < MOST_DAMPING:
            x = (_coordinates(iterate.rows.model, iterate.values) + _damped_step(columns, torque, damping)).tolist()
            searched = iterate.rows.model.device.searched
            values = tuple(
                value_of(constant, coordinate) for (_, constant), coordinate in zip(searched, x, strict=True)
            )
            tried = evaluated(model, motions, weights, values)
            if tried.square < iterate.square:
                break
            damping *= 10
        else:
            break
        moved = np.abs(_coordinates(model, values) - _coordinates(model, iterate.values)).max()
        iterate, damping = tried, damping / 10
        if moved < _CONVERGED:
            break
    return iterate


def _damped_step(columns: Array, torque: Array, damping: float) -> Array:
    """The Levenberg-Marquardt step; zero for a constant without effect on torque."""
    sizes = np.linalg.norm(columns, axis=0)
    safe = np.where(sizes > 0, sizes, 1.0)
    A = columns / safe
    step = np.linalg.solve(A.T @ A + damping * np.eye(len(safe)), A.T @ torque) / safe
    return np.asarray(np.where(sizes > 0, np.clip(step, -LONGEST_STEP, LONGEST_STEP), 0.0))


def _own_parameters(rows: CandidateRows) -> Array:
    """Base parameters from those of the rows with candidates, (p, columns): a term's is the sum of its columns'."""
    combinations = np.eye(rows.own, rows.own + len(rows.candidates))
    combinations[list(rows.term), rows.own + np.arange(len(rows.term))] = 1.0
    return combinations


def _constant(
    iterate: Iterate, motions: Sequence[RowSource], fit: Fit, intervals: Intervals, k: int
) -> SearchedConstant:
    """A constant with its standard error and likelihood profile."""
    rows = iterate.rows
    term, searched = rows.model.device.searched[k]
    name, value = f"{rows.model.terms[term].name}.{searched.name}", iterate.values[k]
    beta = iterate.beta[rows.term[k]]
    if not beta:
        return SearchedConstant(name, searched.unit, value, float("nan"), searched.low, searched.high)
    # The candidate's parameter is that of the term times the change of the constant, relative to the difference step.
    row = np.zeros((1, len(rows.observation.base)))
    row[0, rows.own + k] = iterate.step[k] / beta
    spread = intervals.spread(fit, row)
    robust = float(np.sqrt(spread.covariance[0, 0]))
    classical = float(np.sqrt((row @ fit.classical_covariance @ row.T)[0, 0]))
    noise = 1.0 if fit.unit_residual else fit.solution.rest**2 / fit.solution.dof
    x, grid, increase = _profile(iterate, motions, fit.weights, k, robust)
    profile = _Profile(name, searched, x, grid, increase, noise, robust / classical, float(spread.dof[0]))
    slope = value if searched.positive else searched.high - searched.low
    return SearchedConstant(name, searched.unit, value, robust * slope, searched.low, searched.high, profile)


def _profile(
    iterate: Iterate, motions: Sequence[RowSource], weights: Array, k: int, se: float
) -> tuple[float, Array, Array]:
    """Estimate, grid and increase of the squared residual, the other constants fitted to first order."""
    model = iterate.rows.model
    constant = model.device.searched[k][1]
    x, ends = coordinate(constant, iterate.values[k]), [coordinate(constant, e) for e in (constant.low, constant.high)]
    grid = np.linspace(max(x - PROFILE_EXTENT * se, ends[0]), min(x + PROFILE_EXTENT * se, ends[1]), PROFILE_POINTS)
    tried = [Candidate(k, value_of(constant, at)) for at in grid.tolist()]
    rows = candidate_rows(model, motions, [*iterate.rows.candidates, *tried])
    first = len(iterate.rows.candidates)
    others = np.delete(derivatives(rows, iterate.step, iterate.beta), k, axis=1)
    squares = [rows.fit(weights, {k: first + number}, others).square for number in range(PROFILE_POINTS)]
    return x, grid, np.array(squares) - rows.fit(weights, extra=others).square


def _notes(constants: Sequence[SearchedConstant]) -> Iterator[str]:
    """Notes for the user on the constants."""
    for c in constants:
        (low, high), unit = c.conf_int(), f" {c.unit}" if c.unit else ""
        ends = [end for end in (c.low, c.high) if np.isclose(c.value, end, rtol=_AT_LIMIT)]
        if np.isnan(c.se):
            yield f"{c.name} is not identifiable: its term has no effect on torque in this log."
        elif ends:
            yield f"{c.name} is at the end of its range, {ends[0]:g}{unit}: widen the range, or give the constant."
        elif not c.bounded:
            yield f"{c.name} is poorly identifiable from this log: its interval is {low:.3g} to {high:.3g}{unit}."
