"""Profile likelihood: how far a parameter of a held estimate can go before the rows speak against it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import clarabel
import numpy as np
from scipy import sparse

from haptid._internal.arrays import Array
from haptid.errors import MethodSettingError, PulledProfileError, UnsolvedError
from haptid.estimation.feasibility.conic_program import ENOUGH, SOLVED, TIGHT, Condition, settings
from haptid.estimation.feasibility.feasible import roomy
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.estimation.intervals.spread import Intervals, Spread
from haptid.estimation.methods.bounded import BoundedSolution, conditions
from haptid.estimation.methods.consistent import Constrained

# Weight of the pull along directions that no torque shows, in units in which the end that is looked for is one.
PULL = 1e-6
# Where the solver comes no further, it is asked again with tolerances so many times as wide.
WIDER = (1.0, 1e2, 1e4)


@dataclass(frozen=True)
class Profile:
    """Ends of each interval: the least and largest value at which the best fit within the limits is not too bad.

    Too bad is a rise of |R (b - beta)|^2 over that of the estimate by more than t^2 times how much larger the honest
    variance of that parameter is than the textbook's: where no limit is near, the interval is the honest one. Where
    limits hold other parameters it is narrower than the free one, for these limits are information. Limits are those of
    `Bounds`, or what bodies and passive terms can have, of `PhysicallyConsistent`: each end is one cone programme, and is asked
    only where the end of the free interval is not seen to be possible as it is.

    Sources: Murphy and van der Vaart (2000), JASA 95; Kent (1982), Biometrika 69, for the factor.

    Attributes:
        free: intervals of the fit that is held to nothing.
    """

    free: Intervals = field(default_factory=ClusterRobust)

    @property
    def name(self) -> str:
        return f"profile likelihood within the limits; scale by {self.free.name}"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of the free fit."""
        return self.free.spread(fit, combinations)

    def limits(self, fit: Fit, held: object, half: Array) -> Array:
        """Ends of the 95 % intervals, (p, 2).

        Args:
            fit: the free fit.
            held: the estimate within its limits.
            half: half-widths of the free intervals, (p,).

        Raises:
            MethodSettingError: the estimate is not one of `Bounds()` or `PhysicallyConsistent()`.
            PulledProfileError: it was pulled towards a prior.
            UnsolvedError: the solver stopped before it had an answer.
        """
        known = np.flatnonzero(np.isfinite(half))
        ends = np.array(ranged(held).interval(half))
        ends[known] = self.ends(fit, held, np.eye(len(half))[known], half[known])
        return ends

    def ends(self, fit: Fit, held: object, combinations: Array, half: Array) -> Array:
        """Ends of the 95 % intervals of combinations of base parameters, (q, 2).

        Args:
            fit: the free fit.
            held: the estimate within its limits.
            combinations: (q, p).
            half: half-widths of their free intervals, (q,).

        Raises:
            MethodSettingError, PulledProfileError, UnsolvedError: as `limits`.
        """
        kept = ranged(held)
        room = within(fit, kept) if isinstance(kept, BoundedSolution) else possible(fit, kept)
        least = float(np.sum((fit.solution.R @ inner(fit, room.beta - room.free)) ** 2))
        made = np.empty((len(half), 2))
        for row, (wanted, wide) in enumerate(zip(combinations, half.tolist(), strict=True)):
            across = wanted @ fit.solution.root
            size = float(np.linalg.norm(across))
            reach = float(np.sqrt(least + (wide / size) ** 2))
            for side, sign in enumerate((-1.0, 1.0)):
                straight = fit.solution.root @ across * (sign * reach / size)
                step = straight if room.holds(straight) else furthest(room, reach, sign * wanted)
                made[row, side] = wanted @ (room.free + step)
        value = combinations @ room.beta
        return np.column_stack([np.minimum(made[:, 0], value), np.maximum(made[:, 1], value)])


@dataclass(frozen=True, eq=False)
class Room:
    """Where base parameters may be: free + change h, with every condition on (h, y) met for some y.

    Attributes:
        free, beta: the free fit, and the estimate, (p,), SI.
        change: (p, k); h is the change of the weighted torque.
        conditions: on (h, y), (k + extra,).
        holds: whether a change of base parameters, (p,), is seen at once to be possible.
    """

    free: Array
    beta: Array
    change: Array
    conditions: tuple[Condition, ...]
    holds: Callable[[Array], bool]


def ranged(held: object) -> BoundedSolution | Constrained:
    """An estimate that is held; of others there is no profile.

    Raises:
        MethodSettingError: it is none.
        PulledProfileError: it is not the best fit of what it is held to.
    """
    if isinstance(held, Constrained) and held.pulled:
        raise PulledProfileError
    if isinstance(held, BoundedSolution | Constrained):
        return held
    wanted = "an estimate by Bounded(...) or Consistent(...)"
    raise MethodSettingError("Profile", "method", type(held).__name__, wanted)


def inner(fit: Fit, change: Array) -> Array:
    """A change of base parameters, (p,), in the directions that nothing fixes, (k,)."""
    return np.asarray(np.linalg.lstsq(fit.solution.root @ fit.solution.R, change, rcond=None)[0])


def within(fit: Fit, held: BoundedSolution) -> Room:
    """Between limits."""
    size = np.linalg.norm(fit.solution.root, axis=1)
    own = conditions(held.free, size, held.low, held.high)
    made = tuple(Condition(c.F @ (fit.solution.root / size[:, None]), c.f) for c in own)

    def holds(step: Array) -> bool:
        return bool(((held.low <= held.free + step) & (held.free + step <= held.high)).all())

    return Room(held.free, held.beta, fit.solution.root, made, holds)


def possible(fit: Fit, held: Constrained) -> Room:
    """What bodies and passive terms can have; y moves what no base parameter shows."""
    cone = roomy(held.possible.model, held.beta)
    x = held.possible.chi / cone.scale + cone.inverse @ (held.free - held.beta)
    move = np.column_stack([cone.inverse @ fit.solution.root, cone.null])
    made = tuple(Condition(block.G @ move, block.G @ x, block.is_link) for block in cone.blocks)

    def holds(step: Array) -> bool:
        return cone.margin(x + cone.inverse @ step) >= 0

    return Room(held.free, held.beta, fit.solution.root, made, holds)


def furthest(room: Room, reach: float, wanted: Array) -> Array:
    """The change of base parameters that goes furthest along `wanted`, no more than `reach` from the free fit, (p,).

    Solved for h / reach, a vector no longer than one; y is held near zero by a pull too weak to be felt.
    """
    k, size = room.change.shape[1], room.conditions[0].F.shape[1]
    scale = np.append(np.full(k, reach), np.ones(size - k))
    own = [(c.F * scale, c.f) for c in room.conditions]
    cones = [clarabel.PSDTriangleConeT(4) if c.matrix else clarabel.NonnegativeConeT(len(c.f)) for c in room.conditions]
    A = np.concatenate([*(-F for F, _ in own), np.zeros((1, size)), -np.eye(k, size)])
    b = np.concatenate([*(f for _, f in own), [1.0], np.zeros(k)])
    across = wanted @ room.change
    q = np.append(-across / np.linalg.norm(across), np.zeros(size - k))
    P = sparse.diags(np.append(np.zeros(k), np.full(size - k, PULL)), format="csc")
    problem = (P, q, sparse.csc_matrix(A), b, [*cones, clarabel.SecondOrderConeT(k + 1)])
    for wider, equilibrate in product(WIDER, (True, False)):
        how = settings(equilibrate)
        how.tol_gap_abs = how.tol_gap_rel = how.tol_feas = TIGHT * wider
        how.reduced_tol_gap_abs = how.reduced_tol_gap_rel = how.reduced_tol_feas = ENOUGH * max(1.0, wider / 100)
        answer = clarabel.DefaultSolver(*problem, how).solve()
        if str(answer.status) in SOLVED:
            return np.asarray(room.change @ np.array(answer.x)[:k] * reach)
    raise UnsolvedError(str(answer.status), answer.iterations)
