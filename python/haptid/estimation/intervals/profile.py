"""Profile-likelihood intervals of constrained estimates: each end is one cone programme."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from itertools import product

import clarabel
import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import SettingError, setting_error
from haptid.estimation.feasibility.conic_program import (
    ENOUGH,
    REGULARISATIONS,
    SOLVED,
    TIGHT,
    ConeCondition,
    attempt,
    cones_of,
    settings,
    unsolved,
)
from haptid.estimation.feasibility.feasible import roomy
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.covariance import Intervals, Spread
from haptid.estimation.method import Fit
from haptid.estimation.methods.constrained import BoundedSolution, Constrained, bound_conditions

# Weight of a quadratic penalty on directions without torque, which makes the solution unique.
_PENALTY = 1e-6
# Where the solver stops short of its tolerances, it is run again with these multiples of them.
RELAXED = (1.0, 1e2, 1e4)


@dataclass(frozen=True)
class Profile:
    """Ends of each interval: least and largest value at which the best constrained fit passes a likelihood-ratio test.

    The test allows |R (b - beta)|^2 to rise above that of the estimate by t^2 times the ratio of the cluster-robust to
    the classical variance of that parameter: away from all constraints the interval is the cluster-robust one. Where
    constraints on other parameters are active it is narrower than the unconstrained one, because they are information.
    It is never wider, unless the estimate itself lies outside of the unconstrained interval: data and constraints then
    contradict each other, the status is `constrained_outside_ci`, and no interval has its nominal coverage.
    Constraints are those of `Bounds` or `PhysicallyConsistent`; a cone programme is solved only where the end of the
    unconstrained interval is not found to be feasible as it is.

    Sources: Murphy and van der Vaart (2000), JASA 95; Kent (1982), Biometrika 69, for the factor.

    Attributes:
        free: covariance estimator of the unconstrained fit.
    """

    free: Intervals = field(default_factory=ClusterRobust)

    @property
    def name(self) -> str:
        return f"profile likelihood within the limits; scale by {self.free.name}"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of the unconstrained fit."""
        return self.free.spread(fit, combinations)

    def limits(self, fit: Fit, solution: object, half: Array) -> Array:
        """Ends of the intervals of the base parameters, (p, 2), at the level of `half`.

        Args:
            fit: the unconstrained fit.
            solution: the constrained estimate.
            half: half-widths of the unconstrained intervals, (p,).

        Raises:
            SettingError: the estimate is not one of `Bounds()` or `PhysicallyConsistent()`, or is regularised.
            ConvergenceError: the solver stopped without a solution.
        """
        known = np.flatnonzero(np.isfinite(half))
        ends = np.array(expect_constrained(solution).interval(half))
        ends[known] = self.ends(fit, solution, np.eye(len(half))[known], half[known])
        return ends

    def ends(self, fit: Fit, solution: object, combinations: Array, half: Array) -> Array:
        """Ends of the intervals of combinations of base parameters, (q, 2), at the level of `half`.

        Args:
            fit: the unconstrained fit.
            solution: the constrained estimate.
            combinations: (q, p).
            half: half-widths of their unconstrained intervals, (q,).

        Raises:
            SettingError, ConvergenceError: as `limits`.
        """
        constrained = expect_constrained(solution)
        feasible = (
            between_bounds(fit, constrained)
            if isinstance(constrained, BoundedSolution)
            else consistent(fit, constrained)
        )
        least = float(np.sum((fit.solution.R @ inner(fit, feasible.beta - feasible.free)) ** 2))
        ends = np.empty((len(half), 2))
        for row, (wanted, wide) in enumerate(zip(combinations, half.tolist(), strict=True)):
            across = wanted @ fit.solution.root
            size = float(np.linalg.norm(across))
            reach = float(np.sqrt(least + (wide / size) ** 2))
            for side, sign in enumerate((-1.0, 1.0)):
                straight = fit.solution.root @ across * (sign * reach / size)
                step = straight if feasible.holds(straight) else furthest(feasible, reach, sign * wanted)
                ends[row, side] = wanted @ (feasible.free + step)
        # The constraints are information: never wider than the unconstrained interval, but for the estimate itself.
        free, value = combinations @ feasible.free, combinations @ feasible.beta
        low, high = np.maximum(ends[:, 0], free - half), np.minimum(ends[:, 1], free + half)
        return np.column_stack([np.minimum(low, value), np.maximum(high, value)])


@dataclass(frozen=True, eq=False)
class FeasibleSet:
    """Feasible base parameters: free + change h, with every condition on (h, y) satisfied for some y.

    Attributes:
        free, beta: the unconstrained fit and the estimate, (p,), SI.
        change: (p, k); h is the change of the weighted torque.
        conditions: on (h, y), (k + extra,).
        holds: a quick sufficient check that a change of base parameters, (p,), is feasible.
    """

    free: Array
    beta: Array
    change: Array
    conditions: tuple[ConeCondition, ...]
    holds: Callable[[Array], bool]


def expect_constrained(solution: object) -> BoundedSolution | Constrained:
    """The constrained estimate; other estimates have no profile.

    Raises:
        SettingError: the estimate is unconstrained, or is not the best fit within its constraints.
    """
    if isinstance(solution, Constrained) and solution.pulled:
        raise SettingError(
            "Profile: the estimate is regularised towards prior bodies, so it is not the best fit of which a profile "
            "could be made.",
            where="intervals",
            advice="Use ClusterRobust(), or estimate with PhysicallyConsistent().",
        )
    if isinstance(solution, BoundedSolution | Constrained):
        return solution
    wanted = "an estimate by Bounds(...) or PhysicallyConsistent(...)"
    raise setting_error("method", type(solution).__name__, wanted, "Profile")


def inner(fit: Fit, change: Array) -> Array:
    """A change of base parameters, (p,), in the unconstrained directions, (k,)."""
    return np.asarray(np.linalg.lstsq(fit.solution.root @ fit.solution.R, change, rcond=None)[0])


def between_bounds(fit: Fit, solution: BoundedSolution) -> FeasibleSet:
    """The set between bounds."""
    size = np.linalg.norm(fit.solution.root, axis=1)
    own = bound_conditions(solution.free, size, solution.low, solution.high)
    conditions = tuple(ConeCondition(c.F @ (fit.solution.root / size[:, None]), c.f) for c in own)

    def holds(step: Array) -> bool:
        return bool(((solution.low <= solution.free + step) & (solution.free + step <= solution.high)).all())

    return FeasibleSet(solution.free, solution.beta, fit.solution.root, conditions, holds)


def consistent(fit: Fit, solution: Constrained) -> FeasibleSet:
    """The physically consistent set; y moves standard parameters without effect on the base parameters."""
    cone = roomy(solution.feasible.model, solution.beta)
    x = solution.feasible.chi / cone.scale + cone.inverse @ (solution.free - solution.beta)
    move = np.column_stack([cone.inverse @ fit.solution.root, cone.null])
    conditions = tuple(ConeCondition(block.G @ move, block.G @ x, block.is_link) for block in cone.blocks)

    def holds(step: Array) -> bool:
        return cone.margin(x + cone.inverse @ step) >= 0

    return FeasibleSet(solution.free, solution.beta, fit.solution.root, conditions, holds)


def furthest(feasible: FeasibleSet, reach: float, wanted: Array) -> Array:
    """The feasible change of base parameters, (p,), that goes furthest along `wanted`, with |h| at most `reach`.

    Solved for h / reach, a vector of length at most one; y is kept near zero by a negligible penalty.

    Raises:
        ConvergenceError: the solver stopped without a solution.
    """
    from scipy import sparse  # slow to import, and few intervals are profiles

    k, size = feasible.change.shape[1], feasible.conditions[0].F.shape[1]
    scale = np.append(np.full(k, reach), np.ones(size - k))
    own = [(c.F * scale, c.f) for c in feasible.conditions]
    A = np.concatenate([*(-F for F, _ in own), np.zeros((1, size)), -np.eye(k, size)])
    b = np.concatenate([*(f for _, f in own), [1.0], np.zeros(k)])
    across = wanted @ feasible.change
    q = np.append(-across / np.linalg.norm(across), np.zeros(size - k))
    P = sparse.diags(np.append(np.zeros(k), np.full(size - k, _PENALTY)), format="csc")
    cones = [*cones_of(feasible.conditions), clarabel.SecondOrderConeT(k + 1)]
    problem = (P, q, sparse.csc_matrix(A), b, cones)
    for relaxed, equilibrate in product(RELAXED, (True, False)):
        options = settings(equilibrate, REGULARISATIONS[0])
        options.tol_gap_abs = options.tol_gap_rel = options.tol_feas = TIGHT * relaxed
        options.reduced_tol_gap_abs = options.reduced_tol_gap_rel = options.reduced_tol_feas = ENOUGH * max(
            1.0, relaxed / 100
        )
        answer = attempt(problem, options)
        if answer.status in SOLVED:
            return np.asarray(feasible.change @ answer.x[:k] * reach)
    raise unsolved(answer.status, answer.iterations)
