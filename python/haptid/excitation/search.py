"""The search for a motion that excites parameters well within limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from haptid._values import Array
from haptid.bench.trajectories import Figures, Kind, Trajectory, plan, spread
from haptid.device import Device
from haptid.errors import MethodSettingError, NoFeasibleMotionError
from haptid.estimators.reduced import indices
from haptid.excitation.families import Family
from haptid.excitation.limits import Bounds, Limits
from haptid.excitation.quality import Criterion, Quality, ScaledCondition, observed, quality

# No motion costs more than this; a singular W would without bound.
WORST = 50.0
# What exceeding a limit by all its size costs, where starts are compared.
PENALTY = 100.0
# Share of the motions tried that are drawn at random, and how many draws of phases there are among them.
RANDOM = 0.1
PHASES = 8
# Descents: steps of each, relative step of its differences, and change of the cost at which it ends.
STEPS = 200
DIFFERENCE = 1e-5
SETTLED = 1e-3
# Descents aim for so much within every limit, of its size, to end on the right side.
WITHIN = 2e-3
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

    tries: int = 4000
    seed: int = 0
    rows_hz: float = ROWS_HZ

    def __post_init__(self) -> None:
        if self.tries < 1:
            raise MethodSettingError("Search", "tries", self.tries, "a whole number, 1 or more")


@dataclass(frozen=True, eq=False)
class Excitation:
    """A motion that excites parameters well, and what it tells of them.

    Attributes:
        device: the mechanism.
        kind: of motion; the bench plans it.
        seed: of the phases that it draws.
        before: of the first motion within the limits that the search met.
        after: of the motion found.
        bounds: what it stays within.
        tried: motions.
        noise: deviation of a row of each motor, (motors,), N m or N.
    """

    device: Device
    kind: Kind
    seed: int
    before: Quality
    after: Quality
    bounds: Bounds
    tried: int
    noise: Array

    def trajectory(self, dt: float) -> Trajectory:
        """The motion in steps of dt, s: what the bench would plan from its experiment file."""
        return plan(self.kind, self.device, dt, phases(self.seed))

    @cached_property
    def predicted(self) -> dict[str, float]:
        """Relative deviation of each parameter by name, per cent of its value; white noise."""
        return dict(zip(self.after.names, self.after.relative_sd.tolist(), strict=True))

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
    device: Device,
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

    Motions drawn at random, then descents (SLSQP, with the limits as constraints) from the best of them.

    Args:
        device: the mechanism.
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
    beta = device.base.of(np.nan_to_num(device.chi_prior)) if beta is None else np.asarray(beta, dtype=float)
    picked = indices(device.base.names, columns if columns is not None else device.base.names)
    motors = [name for name, known in zip(device.row_names, device.measured, strict=True) if known]
    judge = Judge(
        Bounds.of(device, limits or Limits(), beta),
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
    return Excitation(device, kind, start.seed, judge.first, after, judge.bounds, judge.tried, judge.noise)


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
        last: the motion judged last: seed, point, cost, and excess over every limit.
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
    last: tuple[int, bytes, float, Array] = field(default=(0, b"", np.inf, np.zeros(0)))

    def run(self) -> None:
        """Search until all tries are used up: the first share of them at random, then down from the best of those."""
        n, rng = self.family.size(len(self.bounds.names)), np.random.default_rng(self.search.seed)
        try:
            drawn = [
                Start(x, self.search.seed + k % PHASES)
                for k, x in enumerate(qmc.LatinHypercube(n, rng=rng).random(max(1, round(RANDOM * self.search.tries))))
            ]
            for start in sorted(drawn, key=self.penalised):
                self.descend(start)
            while True:
                self.descend(Start(rng.random(n), int(rng.integers(2**31))))
        except Enough:
            return

    def descend(self, start: Start) -> None:
        """Down by sequential quadratic programmes, the limits as constraints."""
        optimize.minimize(
            lambda x: self.judge(x, start.seed)[0],
            start.x,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(start.x),
            constraints={"type": "ineq", "fun": lambda x: -WITHIN - self.judge(x, start.seed)[1]},
            options={"maxiter": STEPS, "eps": DIFFERENCE, "ftol": SETTLED},
        )

    def penalised(self, start: Start) -> float:
        """Cost of a motion, and of every limit that it exceeds."""
        cost, excess = self.judge(start.x, start.seed)
        return cost + PENALTY * float(np.maximum(excess, 0).sum())

    def judge(self, x: Array, seed: int) -> tuple[float, Array]:
        """Cost of the motion at a point of the unit cube, and its excess over every limit."""
        x = np.clip(x, 0.0, 1.0)
        if self.last[:2] == (seed, x.tobytes()):
            return self.last[2:]
        if self.tried >= self.search.tries:
            raise Enough
        self.tried += 1
        device = self.bounds.device
        made = plan(self.family.kind(x, self.bounds), device, 1.0 / self.search.rows_hz, phases(seed))
        found = quality(observed(device, made), self.columns, self.bounds.beta, self.noise)
        excesses = self.bounds.excesses(made)
        cost = min(self.criterion.cost(found), WORST)
        worst = max(excesses, key=lambda excess: excess[0])
        if worst[0] <= 0:
            self.first = self.first or found
            if cost < self.least:
                self.least, self.best = cost, (Start(x, seed), found)
        self.nearest = min(self.nearest, worst)
        self.last = (seed, x.tobytes(), cost, np.array([excess for excess, _ in excesses]))
        if self.progress:
            self.progress(self.tried / self.search.tries, self.least)
        return self.last[2:]
