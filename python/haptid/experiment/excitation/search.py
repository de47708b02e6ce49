"""The search for a motion that excites parameters well within limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import optimize

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import MethodSettingError, NoFeasibleMotionError
from haptid.estimation.methods.zeroed import indices
from haptid.experiment.bench.trajectories import Figures, Kind, Trajectory, plan, spread
from haptid.experiment.excitation.criteria import Criterion, ScaledCondition
from haptid.experiment.excitation.families import Family
from haptid.experiment.excitation.gradients import Slopes
from haptid.experiment.excitation.limits import Bounds, Limits
from haptid.experiment.excitation.quality import Quality, observed, quality

# No motion costs more than this; a singular W would without bound.
WORST = 50.0
# What exceeding a limit by all its size costs, where starts are compared.
PENALTY = 100.0
# Share of the motions tried that are drawn at random to start from.
RANDOM = 0.05
# A descent goes through so many motions in rounds. Of each round: power of the criterion's stand-in, weight of the
# limits, and share of the motions. Both grow: first towards good motions, then to the sharp optimum within the limits.
DESCENT = 1500
ROUNDS = ((2, 3e2, 0.23), (3, 1e3, 0.23), (2, 1e3, 0.18), (4, 3e3, 0.12), (8, 1e4, 0.12), (8, 1e5, 0.12))
# Steps that a descent remembers.
MEMORY = 30
# Step of the differences that tell how a motion follows its numbers.
DIFFERENCE = 1e-6
# Rows a second that a motion is judged by: several for the shortest period of any family's default.
ROWS_HZ = 25.0


@dataclass(frozen=True)
class Search:
    """How long to search, and from where.

    Attributes:
        tries: motions tried.
        seed: of the search, and of the phases that a motion draws.
        rows_hz: rows a second that a motion is judged by.
    """

    tries: int = 3000
    seed: int = 0
    rows_hz: float = ROWS_HZ

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise MethodSettingError("Search", "tries", self.tries, "a whole number, 1 or more")


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion that excites parameters well, and what it tells of them.

    Attributes:
        model: the dynamic model.
        kind: of motion; the bench plans it.
        seed: of the phases that it draws.
        before: of the first motion within the limits that the search met.
        after: of the motion found.
        bounds: what it stays within.
        tried: motions.
        noise: deviation of a row of each motor, (motors,), N m or N.
    """

    model: DynamicModel
    kind: Kind
    seed: int
    before: Quality
    after: Quality
    bounds: Bounds
    tried: int
    noise: Array

    def trajectory(self, dt: float) -> Trajectory:
        """The motion in steps of dt, s: what the bench would plan from its experiment file."""
        return plan(self.kind, self.model, dt, phases(self.seed))

    @cached_property
    def predicted(self) -> dict[str, float]:
        """Relative deviation of each parameter by name, per cent of its value; white noise."""
        return dict(zip(self.after.names, self.after.relative_se.tolist(), strict=True))

    def summary(self) -> str:
        """As text: condition before and after, and the deviations that the motion promises."""
        lines = [f"{len(self.after.names)} parameters, {self.tried} motions tried"]
        for when, found in (("before", self.before), ("after", self.after)):
            lines.append(f"  {when:6s} condition {found.raw:.4g} raw, {found.scaled:.4g} with unit columns")
        lines.append(f"  expected deviations, {self.after.rows} rows of white noise:")
        lines += [f"    {name:8s} {percent:9.3g} %" for name, percent in self.predicted.items()]
        return "\n".join(lines)


def phases(seed: int) -> np.random.Generator:
    """What the bench draws phases from, for an experiment of this seed."""
    return np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])


def design(
    model: DynamicModel,
    family: Family,
    limits: Limits | None = None,
    *,
    criterion: Criterion | None = None,
    columns: tuple[str, ...] | None = None,
    beta: Array | None = None,
    noise: Figures = (0.01,),
    search: Search | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Excitation:
    """Search a family of motions for the one that excites best, within limits.

    Motions drawn at random, then descents from the best of them: quasi-Newton steps (L-BFGS-B) along slopes of the
    criterion, with limits as penalties that grow.

    Args:
        model: the dynamic model.
        family: `FourierSeries()` or `TrianglesWithSines()`.
        limits: of positions, speeds, torques, couplings, loops; the device file's where left out.
        criterion: what to lower; the condition number with unit columns where left out.
        columns: names of the base parameters that count, such as essential ones; all where left out.
        beta: base parameters that torques and relative deviations are told with, (p,), SI; the prior where left out,
            in which a parameter that is not known is zero.
        noise: deviation of a row of torque, N m or N; one for all motors or one for each.
        search: how long.
        progress: called with the share of the search done, 0 to 1, and the least cost so far.

    Raises:
        NoRangeError: a joint has no limits.
        BaseNameError: no base parameter of that name.
        NoFeasibleMotionError: no motion within the limits was found.
    """
    search = search or Search()
    beta = model.base.of(np.nan_to_num(model.device.chi_prior)) if beta is None else np.asarray(beta, dtype=float)
    picked = indices(model.base.names, columns if columns is not None else model.base.names)
    motors = [name for name, known in zip(model.device.row_names, model.device.measured, strict=True) if known]
    judge = Judge(
        Bounds.of(model, limits or Limits(), beta),
        family,
        criterion or ScaledCondition(),
        picked,
        spread("noise", noise, motors),
        search,
        progress,
    )
    judge.run()
    if judge.best is None or judge.first is None:
        raise NoFeasibleMotionError(judge.tried, judge.nearest[1], judge.nearest[0])
    start, after = judge.best
    kind = family.kind(start.x, judge.bounds)
    return Excitation(model, kind, start.seed, judge.first, after, judge.bounds, judge.tried, judge.noise)


class Enough(Exception):
    """All tries are used up."""


@dataclass(frozen=True, eq=False)
class Start:
    """A point of the unit cube to begin from, and the seed of the phases there."""

    x: Array
    seed: int


@dataclass(eq=False)
class Judge:
    """What a search asks of each motion, and the best that it has met.

    Attributes:
        bounds, family, criterion, columns, noise, search, progress: of the search.
        tried: motions judged so far.
        first: the first motion within the limits; None before there is one.
        best: where the best motion is, and its quality; None before there is one.
        least: its cost.
        nearest: least excess over the limits, and which was exceeded.
        affine: how the states follow the numbers of a motion, once it is known.
    """

    bounds: Bounds
    family: Family
    criterion: Criterion
    columns: tuple[int, ...]
    noise: Array
    search: Search
    progress: Callable[[float, float], None] | None
    tried: int = 0
    first: Quality | None = None
    best: tuple[Start, Quality] | None = None
    least: float = np.inf
    nearest: tuple[float, str] = (np.inf, "a limit")
    affine: Array | None = None

    def run(self) -> None:
        """Search until all tries are used up: the first share of them at random, then down from the best of those."""
        rng = np.random.default_rng(self.search.seed)
        try:
            drawn = [self._start(rng) for _ in range(max(1, round(RANDOM * self.search.tries)))]
            for start in sorted(drawn, key=self._penalised):
                self._descend(start)
            while True:
                self._descend(self._start(rng))
        except Enough:
            return

    @cached_property
    def slopes(self) -> Slopes:
        """Of the criterion and the limits."""
        return Slopes.of(self.bounds, self.criterion, self.columns, self.noise)

    def _start(self, rng: np.random.Generator) -> Start:
        return Start(self.family.start(self.bounds, rng), int(rng.integers(2**31)))

    def _descend(self, start: Start) -> None:
        """Down by quasi-Newton steps, round after round, each with its share of the tries that are left."""
        tries = min(DESCENT, self.search.tries - self.tried)
        bounds, x = [(0.0, 1.0)] * len(start.x), start.x
        for power, weight, share in ROUNDS:
            settings = {"maxfun": max(1, round(share * tries)), "maxiter": tries, "maxcor": MEMORY}
            arguments = (start.seed, power, weight)
            x = optimize.minimize(
                self._sloped, x, args=arguments, jac=True, method="L-BFGS-B", bounds=bounds, options=settings
            ).x

    def _sloped(self, x: Array, seed: int, power: float, weight: float) -> tuple[float, Array]:
        """The descent's cost and its gradient, (size,)."""
        states = self.judge(x, seed)[0]
        cost, by_state = self.slopes(states, power, weight)
        return cost, np.tensordot(self._turns(x, seed), by_state, axes=3)

    def _turns(self, x: Array, seed: int) -> Array:
        """How the states follow the numbers of the motion, (size, 3, active, n); found once where always the same."""
        if self.family.affine and self.affine is not None:
            return self.affine
        made, here = [], self._states(x, seed)
        for k in range(len(x)):
            step = DIFFERENCE if x[k] < 0.5 else -DIFFERENCE
            moved = x.copy()
            moved[k] += step
            made.append((self._states(moved, seed) - here) / step)
        self.affine = np.array(made)
        return self.affine

    def _states(self, x: Array, seed: int) -> Array:
        return _states(self._planned(x, seed))

    def _planned(self, x: Array, seed: int) -> Trajectory:
        kind = self.family.kind(x, self.bounds)
        return plan(kind, self.bounds.model, 1.0 / self.search.rows_hz, phases(seed))

    def _penalised(self, start: Start) -> float:
        """Cost of a motion, and of every limit that it exceeds."""
        states, excess = self.judge(start.x, start.seed)
        return self.slopes.cost(states) + PENALTY * excess

    def judge(self, x: Array, seed: int) -> tuple[Array, float]:
        """States of the motion at a point of the unit cube, (3, active, n), and its excess over all limits."""
        if self.tried >= self.search.tries:
            raise Enough
        self.tried += 1
        made = self._planned(x, seed)
        excesses = self.bounds.excesses(made)
        worst = max(excesses, key=lambda excess: excess[0])
        if worst[0] <= 0:
            self._keep(made, Start(x.copy(), seed))
        self.nearest = min(self.nearest, worst)
        if self.progress:
            self.progress(self.tried / self.search.tries, self.least)
        return _states(made), float(sum(max(excess, 0.0) for excess, _ in excesses))

    def _keep(self, made: Trajectory, start: Start) -> None:
        """Remember a motion within all limits if it is the first or the best."""
        found = quality(observed(self.bounds.model, made), self.columns, self.bounds.beta, self.noise)
        cost = min(self.criterion.cost(found), WORST)
        self.first = self.first or found
        if cost < self.least:
            self.least, self.best = cost, (start, found)


def _states(made: Trajectory) -> Array:
    return np.array([made.q.T, made.qd.T, made.qdd.T])
