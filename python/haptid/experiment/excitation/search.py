"""Search for an exciting motion within limits: descents, random moves from the best, and sharper descents."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field
from functools import cached_property

import numpy as np
from scipy import optimize

from haptid._internal.arrays import Array
from haptid._internal.blas_threads import on_one_blas_thread
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.errors import LoopClosureError, SettingError, SingularityError, TrajectoryError
from haptid.estimation.methods.constrained import indices
from haptid.experiment.bench.trajectories import Figures, Trajectory, per_coordinate, plan
from haptid.experiment.collision import Clearance, clearance_along
from haptid.experiment.collision.clearance import LEAST_TOLERANCE
from haptid.experiment.excitation.criteria import (
    Criterion,
    Information,
    Quality,
    ScaledCondition,
    observed_motion,
    quality,
)
from haptid.experiment.excitation.descent import CURVED, Costs, Penalties, Start, apart, descend
from haptid.experiment.excitation.families import Basis, Family, FourierSeries
from haptid.experiment.excitation.gradients import Evaluation, Gradients
from haptid.experiment.excitation.limits import Limits, MotionBounds
from haptid.experiment.excitation.planned import CHECK_STEP, Excitation, PlannedMotion, phases

# Upper bound of a motion's cost; that of a singular W is unbounded.
_WORST = 50.0
# Cost of a motion whose loops do not close, above that of any other.
_OUTSIDE = 1e9
# Descents from random points; then the best motion so far is moved at random and descended from again and again. Share
# of the evaluations for both; power of the smooth criterion, weight of the penalties, and decrease of the cost that is
# worth a step; a random move of a joint, per side of the unit cube.
STARTS = 4
_SEEK, _SEEKING, _KICK = 0.82, (4, 3e2, 1e-3), 1.5
# Moves without a better motion after which the search restarts from random ones; evaluations kept for sharper rounds.
_IDLE, _SHARPEN = 20, 30
# Sharper rounds for the motions found, the best first: one row of how many, where the least rows of the family times a
# factor remain; power, weight and decrease.
_ROUNDS = (((2, 2), 16, 1e4, 5e-4), ((1, 1), 60, 1e5, 1e-4))
# Excess of a limit between rows that a larger margin mends.
_MENDED = 0.1
# What is so near to a limit, relative to it, is in the model of a step.
_REACH = 0.1
# Descents of families that bend, by L-BFGS-B: least number of their evaluations, share of all; memory, steps.
_SHORT, _SHARE, MEMORY = 40, 1 / 16, 30
# Relative decrease of the cost in a step below which a descent has converged.
CONVERGED = 1e-7
# Safety margin to every limit, relative to its size, so that the search ends on the feasible side.
LEAST_MARGIN = 0.004
# Step of the finite differences of a motion by its parameters.
DIFFERENCE = 1e-6
# How many motions found are checked for collisions and between their rows, the best first.
_LOOKED_AT = 10
# Rows per second at which a motion is evaluated: several in the shortest period of any family's default.
ROWS_HZ = 25.0
# A motion that would be kept is checked again between its rows, and the one that is returned once more: how many times
# the rows of the search, and at least this number a second; relative distance to every limit. Of a sine of 2 Hz, peaks
# between rows at 25 Hz are 3 % above those at rows, at 200 Hz 0.05 %, and of 14 Hz between rows at 1 kHz 0.1 %.
_DENSER, _DENSE_HZ, _INSIDE = 8.0, 1000.0, 1e-3


@dataclass(frozen=True)
class Search:
    """Settings of the search.

    Attributes:
        tries: largest number of motions evaluated.
        seed: of the search, and of the phases of a motion.
        rows_hz: rows per second at which a motion is evaluated.
    """

    tries: int = 1000
    seed: int = 0
    rows_hz: float = ROWS_HZ

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise SettingError(
                f"Search: tries is {self.tries!r}; write a whole number, 1 or more.",
                where="tries",
                found=self.tries,
            )


@on_one_blas_thread
def design_excitation(
    model: DynamicModel,
    family: Family,
    limits: Limits | None = None,
    *,
    criterion: Criterion | None = None,
    columns: tuple[str, ...] | None = None,
    beta: Array | None = None,
    noise: Figures = (0.01,),
    search: Search | None = None,
    information: Array | None = None,
    covariance: Array | None = None,
    rank: Callable[[PlannedMotion], float] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Excitation:
    """Optimal excitation: search a family of motions for the one of least cost within limits.

    Quasi-Newton descents from random points, then from the best motion so far, moved at random, with exact gradients of
    the criterion and the limits as penalties; the best motions are descended from once more with sharper ones.

    Args:
        family: `FourierSeries()` or `TrianglesWithSines()`.
        limits: of positions, speeds, torques, couplings, loops; default: those of the device file.
        criterion: to be minimised; default: the volume of the common interval, `Information()`.
        columns: names of the base parameters in the criterion, such as essential ones; default: all.
        beta: base parameters for torques and relative standard errors, (p,), SI; default: the prior, with zero for
            parameters without one.
        noise: standard deviation of a torque row, N m or N; one for all motors or one for each.
        search: number of evaluations and seed.
        information: of logs that there are already, rows in units of their noise, (p, p), SI: the criterion is that of
            them and the motion together. For criteria in units of the noise: not the condition numbers.
        covariance: of the base parameters' errors, (p, p), SI, for `Limits.torque_confidence`; default: the prior's.
        rank: cost of a motion, the least is best, that takes longer than the criterion, such as its largest interval
            behind a treatment: chooses among the motions that the search ends with, one of each valley of the cost.
        progress: called with the share of the search done, 0 to 1, and the least cost so far.

    Raises:
        SettingError: the rows of the search are too few for the harmonics, or a condition number with `information`.
        IncompleteDeviceError: a joint has no limits.
        UnknownNameError: no base parameter of that name.
        TrajectoryError: no motion within the limits was found, or the start pose is outside them.
        MissingDependencyError: the device has collision shapes, and MuJoCo is not installed.
    """
    search = search or Search()
    if isinstance(family, FourierSeries) and search.rows_hz < 2.5 * family.highest_hz:
        raise SettingError(
            f"{search.rows_hz:g} rows per second are too few for harmonics up to {family.highest_hz:g} Hz; at least "
            f"{2.5 * family.highest_hz:g} are needed.",
            where="rows_hz",
            found=search.rows_hz,
            limit=2.5 * family.highest_hz,
            advice="Raise the rows per second, or take fewer harmonics or a lower fundamental frequency.",
        )
    if information is not None and isinstance(criterion, ScaledCondition):
        raise SettingError(
            "the condition number has no unit of noise, so that it does not continue earlier logs.",
            where="criterion",
            advice="Take LargestDeviation(), Information() or AverageVariance().",
        )
    beta = model.prior_beta if beta is None else np.asarray(beta, dtype=float)
    picked = indices(model.base.names, columns if columns is not None else model.base.names)
    motors = [name for name, known in zip(model.device.row_names, model.device.measured, strict=True) if known]
    state = _Search(
        MotionBounds.of(model, limits or Limits(), beta, covariance),
        family,
        criterion or Information(),
        picked,
        per_coordinate("noise", noise, motors),
        search,
        progress,
        information,
        rank,
    )
    if isinstance(family, FourierSeries) and family.start_pose is not None:
        state.bounds.check_start(per_coordinate("start_pose", family.start_pose, state.bounds.names))
    state.run()
    if not state.kept or state.first is None:
        raise state.outside
    best, clearance = state.checked()
    kind, before, after = family.kind(best.x, state.bounds), state.found(state.first), state.found(best)
    history = tuple(state.history)
    return Excitation(model, kind, best.seed, state.bounds, clearance, before, after, state.tried, state.noise, history)


class _EvaluationsUsedError(Exception):
    """All evaluations are used."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows at which motions are evaluated.

    Attributes:
        dt: sampling period, s.
        basis: the states as an affine function of the point, in families that have it.
        gradients: of the criterion and the limits.
        penalties: of the limits of joints, in the families that have a basis.
    """

    dt: float
    basis: Basis | None
    gradients: Gradients
    penalties: Penalties | None


@dataclass(eq=False)
class _Search:
    """State of a search: evaluations so far and the best feasible motion.

    Attributes:
        bounds, family, criterion, columns, noise, search, progress, information, rank: of the search.
        tried: number of motions evaluated so far.
        first: the first feasible motion; None before there is one.
        kept: motions within the limits at the rows of the search, each better than those before it; of those of a
            descent the best between these rows too.
        finalists: motions of sharpened descents that are within the limits between the rows too.
        least: cost of the last of those that are kept.
        history: number of motions evaluated, and least cost, at each improvement.
        nearest: the limits that the best motion outside of them exceeds, and by how much, the worst first.
        made: rows of the search, by how many of them one is taken and the margin.
        margin: relative, to every limit, so that peaks between rows are within it too.
        noted: penalised costs and motions of a descent within the limits at its rows, each better than those before.
    """

    bounds: MotionBounds
    family: Family
    criterion: Criterion
    columns: tuple[int, ...]
    noise: Array
    search: Search
    progress: Callable[[float, float], None] | None
    information: Array | None = None
    rank: Callable[[PlannedMotion], float] | None = None
    tried: int = 0
    first: Start | None = None
    kept: list[Start] = field(default_factory=list)
    finalists: list[Start] = field(default_factory=list)
    least: float = np.inf
    nearest: tuple[tuple[float, str], ...] = ((np.inf, "a limit"),)
    history: list[tuple[int, float]] = field(default_factory=list)
    made: dict[tuple[int, float], _Rows] = field(default_factory=dict)
    noted: list[tuple[float, Start]] = field(default_factory=list)
    margin: float = field(init=False)

    def __post_init__(self) -> None:
        self.margin = LEAST_MARGIN + self.family.peaks(1.0 / self.search.rows_hz)

    def run(self) -> None:
        """Descend from random points, then from the best motion so far, moved at random; sharpen the best."""
        rng, (power, weight, enough) = np.random.default_rng(self.search.seed), _SEEKING
        tries = self.search.tries
        rows, seeking = self._rows(4, 2), max(1, min(round(_SEEK * tries), tries - _SHARPEN))
        found, chain, idle = list[Start](), list[Start](), 0
        try:
            while self.tried < seeking:
                if idle == _IDLE:
                    chain, idle = [], 0
                start = self._start(rng) if len(chain) < STARTS else self._moved(chain[0], rng)
                found.append(self._descend(rows, start, power, weight, enough, seeking - self.tried))
                chain = sorted([*chain, found[-1]], key=lambda one: one.cost)
                idle = idle + 1 if len(chain) > STARTS and chain[0] is not found[-1] else 0
            found.sort(key=lambda one: one.cost)
            for start in apart(found):
                self._sharpen(start)
        except _EvaluationsUsedError:
            pass
        if self.progress:
            self.progress(1.0, self.least)

    def _sharpen(self, start: Start) -> None:
        """Sharper rounds, and where a limit is exceeded between the rows again with a larger margin."""
        for k, (every, power, weight, enough) in enumerate(_ROUNDS):
            left = math.ceil((self.search.tries - self.tried) / (len(_ROUNDS) - k))
            start = self._descend(self._rows(*every), start, power, weight, enough, left)
        while (beyond := self._between(start, 1.0 / (_DENSER * self.search.rows_hz), 2 * _INSIDE)[0][0]) > 0:
            if beyond > _MENDED:
                return
            self.margin += beyond
            start = self._descend(self._rows(), start, power, weight, enough, self.search.tries - self.tried)
        every_row = self._rows()
        if every_row.gradients.at(self._states(every_row, start.x, start.seed)).worst <= 0:
            self.finalists.append(start)

    def _moved(self, start: Start, rng: np.random.Generator) -> Start:
        """A motion near another."""
        size, bent = len(start.x), CURVED
        if start.curvature is not None:
            bent = float(np.trace(start.curvature)) / size
        kick = _KICK * 2 ** rng.uniform(-1, 1) * math.sqrt(len(self.bounds.names) / size / bent)
        return Start(np.clip(start.x + kick * rng.standard_normal(size), 0.0, 1.0), start.seed)

    def _rows(self, every: int = 1, factor: int = 1) -> _Rows:
        """Every fourth or second of the rows of the search, if `factor` times the least of the family remain."""
        while every > 1 and self.search.rows_hz / every < factor * self.family.least_rows_hz:
            every //= 2
        if (every, self.margin) not in self.made:
            dt = every / self.search.rows_hz
            there = None if self.information is None else self.information / every
            gradients = Gradients.of(self.bounds, self.criterion, self.columns, self.noise, there, dt, self.margin)
            basis, size = self.family.basis(self.bounds, dt), self.family.size(len(self.bounds.names))
            penalties = None if basis is None else Penalties.of(self.bounds, basis, size, self.margin)
            self.made[every, self.margin] = _Rows(dt, basis, gradients, penalties)
        return self.made[every, self.margin]

    @cached_property
    def dense_basis(self) -> Basis | None:
        """States at the rows at which a motion that would be kept is checked."""
        return self.family.basis(self.bounds, 1.0 / (_DENSER * self.search.rows_hz))

    def checked(self) -> tuple[Start, Clearance | None]:
        """The best motion that keeps limits and clearance between the rows of the search too, and its least distance.

        Raises:
            TrajectoryError: none does.
        """
        dt, last = 1.0 / max(_DENSE_HZ, self.search.rows_hz), self._ranked()[:_LOOKED_AT]
        collision, least = self.bounds.collision, self.bounds.limits.clearance
        best: Clearance | None = None
        for start in last:
            exceeded = self._between(start, dt, _INSIDE)
            if exceeded[0][0] > 0:
                self.nearest = exceeded
                continue
            if collision is None:
                return start, None
            kind = self.family.kind(start.x, self.bounds)
            made = plan(kind, self.bounds.model, CHECK_STEP, phases(start.seed))
            found = clearance_along(collision, made.q, made.dt)
            if found.bound > 0 and found.distance >= least - max(0.1 * least, LEAST_TOLERANCE):
                return start, found
            best = found if best is None or found.distance > best.distance else best
        if best is None:
            raise self.outside
        raise TrajectoryError(
            f"between the rows of the search {best.pair} come to {1e3 * best.distance:.4g} mm at {best.time:.3f} s; "
            f"the limit is {1e3 * least:.4g} mm.",
            where=best.pair,
            found=best.distance,
            limit=least,
            advice="Raise the rows per second of the search, or the clearance.",
        )

    def _ranked(self) -> list[Start]:
        """The motions that may be returned, the best first."""
        last = self.kept[::-1]
        if self.rank is None or len(self.finalists) < 2:
            return last
        finalists = [*self.finalists, *last[:1]]
        costs = [self.rank(self.planned(start, None)) for start in finalists]
        return [finalists[k] for k in np.argsort(costs, kind="stable")] + last[1:]

    def planned(self, start: Start, clearance: Clearance | None) -> PlannedMotion:
        """A motion as it is handed on."""
        kind = self.family.kind(start.x, self.bounds)
        return PlannedMotion(self.bounds.model, kind, start.seed, self.bounds, clearance)

    def found(self, start: Start) -> Quality:
        """Quality of a motion."""
        made = plan(
            self.family.kind(start.x, self.bounds), self.bounds.model, 1.0 / self.search.rows_hz, phases(start.seed)
        )
        observed = observed_motion(self.bounds.model, made)
        return quality(observed, self.columns, self.bounds.beta, self.noise)

    def _start(self, rng: np.random.Generator) -> Start:
        return Start(self.family.start(self.bounds, rng), int(rng.integers(2**31)))

    def _descend(self, rows: _Rows, start: Start, power: float, weight: float, enough: float, most: int) -> Start:
        """Descent with a limit on evaluations."""
        try:
            if rows.penalties is None:
                most = min(most, max(_SHORT, round(_SHARE * self.search.tries)))
                settings = {"maxfun": most, "maxiter": most, "maxcor": MEMORY, "ftol": CONVERGED}
                found = optimize.minimize(
                    self._gradient,
                    start.x,
                    args=(rows, start.seed, power, weight),
                    jac=True,
                    method="L-BFGS-B",
                    bounds=[(0.0, 1.0)] * len(start.x),
                    options=settings,
                )
                return Start(found.x, start.seed, float(found.fun))
            made = descend(
                lambda x: self._costs(x, rows, start.seed, power, weight),
                rows.penalties,
                start.x,
                weight,
                most=most,
                enough=enough,
                curvature=start.curvature,
            )
            return Start(made.x, start.seed, made.cost, made.curvature)
        finally:
            self._keep_noted()

    def _gradient(self, x: Array, rows: _Rows, seed: int, power: float, weight: float) -> tuple[float, Array]:
        """Smooth cost with penalties and its gradient, (size,); a large cost where loops do not close."""
        try:
            made = self.evaluate(rows, x, seed)
            cost, by_state = made.slopes(power, weight)
        except (LoopClosureError, SingularityError):  # a step beyond the limits: the line search shortens it
            return _OUTSIDE, np.zeros(len(x))
        self._note(made, cost, x, seed)
        return cost, np.tensordot(self._jacobian(rows, x, seed), by_state, axes=3)

    def _costs(self, x: Array, rows: _Rows, seed: int, power: float, weight: float) -> Costs:
        """Smooth cost of a family with a basis, its gradient, and what is beyond limits; else the same."""
        assert rows.basis is not None
        try:
            made = self.evaluate(rows, x, seed)
            cost, by_state = made.slopes_of_whole(power, weight)
            found = made.beyond(joints=False, reach=_REACH)
        except (LoopClosureError, SingularityError):
            return Costs(_OUTSIDE, np.zeros(len(x)), np.zeros(0), np.zeros((0, len(x))))
        self._note(made, cost, x, seed)
        others = rows.basis.rows(found.sample, found.slopes, len(x))
        return Costs(cost, rows.basis.gradient(by_state, len(x)), found.over, others)

    def _note(self, made: Evaluation, cost: float, x: Array, seed: int) -> None:
        """Note a motion that is within the limits at its rows, and the best of its descent."""
        if made.worst <= 0 and cost < (self.noted[-1][0] if self.noted else np.inf):
            self.noted.append((cost, Start(x.copy(), seed)))
            if self.first is None:
                self._keep_noted()

    def _jacobian(self, rows: _Rows, x: Array, seed: int) -> Array:
        """Jacobian of the states by the parameters of the motion, (size, 3, active, n), by differences."""
        made, here = [], self._states(rows, x, seed)
        for k in range(len(x)):
            step = DIFFERENCE if x[k] < 0.5 else -DIFFERENCE
            moved = x.copy()
            moved[k] += step
            made.append((self._states(rows, moved, seed) - here) / step)
        return np.array(made)

    def _states(self, rows: _Rows, x: Array, seed: int) -> Array:
        if rows.basis is not None:
            return rows.basis.states(x)
        return _stacked(plan(self.family.kind(x, self.bounds), self.bounds.model, rows.dt, phases(seed)))

    def evaluate(self, rows: _Rows, x: Array, seed: int) -> Evaluation:
        """The motion at a point of the unit cube; of those outside the limits the least is remembered."""
        if self.tried >= self.search.tries:
            raise _EvaluationsUsedError
        self.tried += 1
        made = rows.gradients.at(self._states(rows, x, seed))
        if 0 < made.worst < self.nearest[0][0]:
            self.nearest = _sorted(made.excesses)
        if self.progress:
            self.progress(self.tried / self.search.tries, self.least)
        return made

    def _keep_noted(self) -> None:
        """Keep the best of the noted motions that is within the limits between its rows too, if it is the best."""
        noted, self.noted = [start for _, start in self.noted], []
        every_row, looked_at = self._rows(), 0
        while noted and looked_at < _LOOKED_AT:
            start, looked_at = noted[-1], looked_at + 1
            made = every_row.gradients.at(self._states(every_row, start.x, start.seed))
            cost, exceeded = min(made.cost(), _WORST), _sorted(made.excesses)
            if exceeded[0][0] <= 0:  # flat loops change slowly: these rows are dense enough
                exceeded = self._between(start, 1.0 / (_DENSER * self.search.rows_hz), 2 * _INSIDE)
            self.nearest = min(self.nearest, exceeded, key=lambda found: found[0][0])
            if exceeded[0][0] > 0:
                noted.pop()
                continue
            self.first = self.first or start
            if cost < self.least:
                self.least = cost
                self.kept += noted
                self.history.append((self.tried, cost))
            return

    def _between(self, start: Start, dt: float, inside: float) -> tuple[tuple[float, str], ...]:
        """The limits that a motion exceeds at rows in steps of dt, s, or is nearer to than `inside`."""
        if self.dense_basis is not None and dt == 1.0 / (_DENSER * self.search.rows_hz):
            states = self.dense_basis.states(start.x)
        else:
            states = _stacked(plan(self.family.kind(start.x, self.bounds), self.bounds.model, dt, phases(start.seed)))
        found = (*self.bounds.by_sample(states), *self.bounds.over_time(states, dt))
        return _sorted([(float(excess.max()) + inside, what) for excess, what in found])

    @property
    def outside(self) -> TrajectoryError:
        """No motion is within the limits: those that the best one exceeds, and by how much."""
        by = ", ".join(f"{what} by {100 * excess:.3g} %" for excess, what in self.nearest if excess > 0) or "a limit"
        return TrajectoryError(
            f"none of {self.tried} motions is within all limits; the best exceeds {by}.",
            where=self.nearest[0][1],
            found=self.nearest[0][0],
            limit=0.0,
            advice="Widen what is exceeded, move the range of positions, or evaluate more motions.",
        )


def _stacked(made: Trajectory) -> Array:
    """Positions, velocities and accelerations of the active joints, (3, active, n)."""
    return np.array([made.q.T, made.qd.T, made.qdd.T])


def _sorted(excesses: list[tuple[float, str]]) -> tuple[tuple[float, str], ...]:
    """Those above zero, the largest first; at least one."""
    found = sorted(excesses, key=lambda one: -one[0])
    return tuple(one for one in found if one[0] > 0) or (found[0],)
