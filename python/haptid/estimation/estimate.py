"""`estimate(observation, method)`: value and covariance together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, read_only
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation.feasibility.feasible import FeasibleParameters
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.spread import Intervals, Limiting, Spread, correlations
from haptid.estimation.least_squares import Solution, solve
from haptid.estimation.method import Fitting, Knowing, Method, Reduced, rows_of
from haptid.estimation.methods.bounded import BoundedSolution
from haptid.estimation.methods.consistent import Constrained
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation
from haptid.observation.plan import Block
from haptid.uncertainty.quantities import Quantities

# Scaled condition number above which single parameters are not to be trusted one by one (Gautier's rule).
WELL_CONDITIONED = 200.0


@runtime_checkable
class Restricted(Method, Protocol):
    """A method that holds the solution to a set of parameters, such as `PhysicallyConsistent`."""

    def hold(self, observation: Observation, free: Solution) -> Constrained | BoundedSolution:
        """The solution in the set, beside the free one."""


@dataclass(frozen=True)
class Parameter:
    """One base parameter as identified.

    Attributes:
        name, unit, grouping: ZZ1R, kg m^2, and what regroups into it.
        value, se: and its honest deviation, SI.
        classical_se: its deviation if the residual were white.
        interval: the honest 95 % interval.
        prior: value and deviation known beforehand, or None.
        free: value of the fit that is held to nothing, to which `sd` belongs; `value` where nothing holds it.
        constrained_outside_ci: whether the value is held outside of the free fit's interval.
    """

    name: str
    unit: str
    grouping: str
    value: float
    se: float
    classical_se: float
    interval: tuple[float, float]
    prior: tuple[float, float | None] | None
    free: float
    constrained_outside_ci: bool

    @property
    def relative_se(self) -> float:
        """100 sd / |value|, per cent (Janot et al. 2007, eq. 17, with the absolute value it lacks).

        NaN where `constrained_outside_ci`: the deviation then says nothing about the value.
        """
        if self.constrained_outside_ci:
            return float("nan")
        return 100 * self.se / abs(self.value) if self.value else float("inf")


@dataclass(frozen=True, eq=False)
class Estimate:
    """Base parameters from an observation.

    Attributes:
        observation: the rows it was made from.
        method: how.
        fit: the solution that is held to nothing, and the rows as least squares saw them.
        intervals: how deviations are made.
        beta: (p,), SI.
        covariance: honest, (p, p).
        classical_covariance: if the residual were white, (p, p).
        dof: degrees of freedom of each interval, (p,).
        single_block: parameters that one stretch of the log alone tells: their intervals are infinite, for nothing else can
            say how far to trust it.
        weights: of each motor's rows, (motors,); of a method that weighs single rows one over each motor's residual.
        status: "ok", or what is wrong with it: "weak", or "strained" where what is possible lies beyond an interval.
        notes: sentences a user should read.
        held: of a method that holds the estimate to what bodies can have: those bodies, the free estimate beside it,
            and what holds it; None of the others.
        zero: indices of the parameters that were left out: zero, without deviation.
    """

    observation: Observation
    method: Method
    fit: Fit
    intervals: Intervals
    beta: Array
    covariance: Array
    classical_covariance: Array
    dof: Array
    single_block: tuple[int, ...]
    weights: Array
    status: str
    notes: tuple[str, ...]
    held: Constrained | BoundedSolution | None = None
    zero: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("beta", "covariance", "classical_covariance", "dof", "weights"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def model(self) -> DynamicModel:
        return self.observation.model

    @property
    def base(self) -> BaseParameters:
        return self.observation.base

    @property
    def quantities(self) -> Quantities:
        """Base parameters of the unconstrained fit, with covariance and degrees of freedom."""
        return Quantities(self.base.names, self.base.units, self.free, self.covariance, self.dof, self.single_block)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Time blocks of the logs that it was made from."""
        return self.observation.blocks

    @property
    def free(self) -> Array:
        """Base parameters of the unconstrained fit, to which covariance and standard errors belong, (p,), SI."""
        return self.held.free if self.held else self.beta

    @property
    def constrained(self) -> bool:
        """Whether a constraint is active, so that `beta` differs from `free`."""
        return bool(self.held and self.held.active)

    @property
    def kept(self) -> tuple[int, ...]:
        """Indices of the parameters that were not left out."""
        return tuple(k for k in range(len(self.base)) if k not in self.zero)

    @property
    def possible(self) -> FeasibleParameters | None:
        """Bodies that have these base parameters, of a method that looks for them."""
        return self.held.possible if isinstance(self.held, Constrained) else None

    @property
    def se(self) -> Array:
        """Honest deviations, (p,); infinite for the lonely ones. Of a held estimate, those of the free one."""
        return deviations(self.covariance, self.single_block)

    @cached_property
    def correlation(self) -> Array:
        """Of the errors of the base parameters, (p, p); NaN beside what has no deviation."""
        return correlations(self.covariance)

    @cached_property
    def interval95(self) -> Array:
        """Honest 95 % intervals, (p, 2)."""
        if self.held and isinstance(self.intervals, Limiting):
            return read_only(self.intervals.limits(self.fit, self.held, self._half))
        if self.held:
            return read_only(self.held.interval(self._half))
        return read_only(np.column_stack([self.beta - self._half, self.beta + self._half]))

    @cached_property
    def _half(self) -> Array:
        """Half-widths of the 95 % intervals of the free fit, (p,)."""
        return read_only(stats.t.ppf(0.975, self.dof) * self.se)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The estimate, parameter by parameter."""
        classical, free = np.sqrt(np.diag(self.classical_covariance)), self.held.free if self.held else self.beta
        constrained_outside_ci = self.held.constrained_outside_ci(self._half) if self.held else ()
        return tuple(
            Parameter(
                name=name,
                unit=self.base.units[k],
                grouping=self.base.groupings[k],
                value=float(self.beta[k]),
                se=float(self.se[k]),
                classical_se=float(classical[k]),
                interval=(float(self.interval95[k, 0]), float(self.interval95[k, 1])),
                prior=self.model.base_prior[k],
                free=float(free[k]),
                constrained_outside_ci=name in constrained_outside_ci,
            )
            for k, name in enumerate(self.base.names)
        )

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[self.base.names.index(name)]

    def spread(self, combinations: Array) -> Spread:
        """Deviations and degrees of freedom of combinations of base parameters, (q, p), of the free fit."""
        return self.intervals.spread(self.fit, combinations)


def estimate(observation: Observation, method: Method, intervals: Intervals | None = None) -> Estimate:
    """Base parameters with honest intervals.

    Args:
        observation: the rows.
        method: `OLS()`, `WLS()`, `GLS()`, `PhysicallyConsistent()`, ...
        intervals: how deviations are made; `ClusterRobust()` where None.

    Raises:
        TooFewRowsError: fewer rows than parameters.
        UnexcitedError: the log leaves a direction of the parameters in the dark.
        NoBodyError, UnsolvedError: `PhysicallyConsistent()` finds no bodies.
    """
    intervals = intervals or ClusterRobust()
    zero = method.zero(observation) if isinstance(method, Reduced) else ()
    fit = method.fit(observation) if isinstance(method, Fitting) else fitted(observation, method, zero)
    solution, spread = fit.solution, intervals.spread(fit)
    held = method.hold(observation, solution) if isinstance(method, Restricted) else None
    status, notes = verdict(observation, spread, held, zero)
    own = fit.observation is observation
    return Estimate(
        observation=observation,
        method=method,
        fit=fit,
        intervals=intervals,
        beta=held.beta if held else solution.beta,
        covariance=spread.covariance,
        classical_covariance=solution.classical_covariance(fit.unit_residual),
        dof=spread.dof,
        single_block=tuple(int(k) for k in spread.alone),
        weights=fit.weights if own else np.array([WLS().weight(m, solution.beta) for m in observation.motors]),
        status=status,
        notes=notes,
        held=held,
        zero=zero,
    )


def fitted(observation: Observation, method: Method, zero: tuple[int, ...]) -> Fit:
    """Least squares on the rows as the method wants them seen, with what it knows beside them."""
    known = method.knowledge(observation) if isinstance(method, Knowing) else None
    seen = rows_of(method, observation)
    weights = method.weights(seen)
    return Fit(seen, weights, solve(seen, weights, zero, known), method.unit_residual)


def verdict(
    observation: Observation, spread: Spread, held: Constrained | BoundedSolution | None, zero: tuple[int, ...]
) -> tuple[str, tuple[str, ...]]:
    """The status of an estimate, and the sentences a user should read."""
    raw, scaled = observation.condition_without(zero)
    notes = list(observation_notes(observation))
    status = "ok"
    if scaled > WELL_CONDITIONED:
        status = "weak"
        notes.append(
            f"The motion tells some parameters apart only weakly (condition number {scaled:.0f} with unit columns, "
            f"{raw:.0f} raw): trust the torque, and of single parameters only those with a small deviation."
        )
    if len(spread.alone):
        status = "weak"
        names = ", ".join(observation.base.names[k] for k in spread.alone)
        notes.append(
            f"One stretch of the log alone tells {names}, so nothing says how far to trust it and the interval is "
            f"infinite. Record longer, or motion that shows it again and again."
        )
    if held:
        half = stats.t.ppf(0.975, spread.dof) * deviations(spread.covariance, spread.alone)
        status = "strained" if held.constrained_outside_ci(half) else status
        notes += held.notes(half)
    return status, tuple(notes)


def deviations(covariance: Array, single_block: Sequence[int] | np.ndarray) -> Array:
    """Square roots of the variances, (p,); infinite for the lonely ones."""
    se = np.sqrt(np.diag(covariance))
    se[list(single_block)] = np.inf
    return se


def observation_notes(observation: Observation) -> tuple[str, ...]:
    """What the values this observation came from have to say, each sentence once."""
    sentences = list(observation.model.device.notes)
    for motion in observation.motions:
        sentences += motion.log.notes if motion.log else ()
    sentences += observation.notes
    return tuple(dict.fromkeys(sentences))
