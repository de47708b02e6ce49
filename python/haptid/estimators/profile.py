"""Profile likelihood: how far a parameter of a bounded estimate can go before the rows speak against it."""

from __future__ import annotations

from dataclasses import dataclass, field

import clarabel
import numpy as np
from scipy import sparse

from haptid._values import Array
from haptid.errors import MethodSettingError, UnsolvedError
from haptid.estimators.bounded import Within, conditions
from haptid.estimators.clustered import Clustered
from haptid.estimators.fit import Fit
from haptid.estimators.programme import SOLVED, settings
from haptid.estimators.spread import Intervals, Spread


@dataclass(frozen=True)
class Profile:
    """Ends of each interval: the least and largest value at which the best fit within the limits is not too bad.

    Too bad is a rise of |R (b - beta)|^2 over that of the estimate by more than t^2 times how much larger the honest
    variance of that parameter is than the textbook's: where no limit is near, the interval is the honest one. Where
    limits hold other parameters it is narrower than the free one, for these limits are information.

    Sources: Murphy and van der Vaart (2000), JASA 95; Kent (1982), Biometrika 69, for the factor.

    Attributes:
        free: intervals of the fit that is held to nothing.
    """

    free: Intervals = field(default_factory=Clustered)

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
            MethodSettingError: the estimate is not one of `Bounded()`.
            UnsolvedError: the solver stopped before it had an answer.
        """
        if not isinstance(held, Within):
            raise MethodSettingError("Profile", "method", type(held).__name__, "an estimate by Bounded(...)")
        size = np.linalg.norm(fit.solution.root, axis=1)
        # In units of each parameter's textbook deviation, from the free fit.
        start = (held.beta - held.free) / size
        least = float(np.sum((fit.solution.R @ (size * start)) ** 2))
        ends = np.array(held.interval(half))
        for k in np.flatnonzero(np.isfinite(half)).tolist():
            reach = float(np.sqrt(least + (half[k] / size[k]) ** 2))
            for side, sign in enumerate((1.0, -1.0)):
                ends[k, side] = held.free[k] + size[k] * furthest(fit, held, size, reach, k, sign)
        return np.column_stack([np.minimum(ends[:, 0], held.beta), np.maximum(ends[:, 1], held.beta)])


def furthest(fit: Fit, held: Within, size: Array, reach: float, k: int, sign: float) -> float:
    """Entry k of the x that minimises sign x_k, where |R size x| <= reach and free + size x is within the limits.

    Solved for h = R size x / reach, a vector no longer than one.
    """
    change = reach * fit.solution.root / size[:, None]
    own = conditions(held.free, size, held.low, held.high)
    n = change.shape[1]
    cones = [*(clarabel.NonnegativeConeT(len(c.f)) for c in own), clarabel.SecondOrderConeT(n + 1)]
    A = np.concatenate([*(-c.F @ change for c in own), np.zeros((1, n)), -np.eye(n)])
    b = np.concatenate([*(c.f for c in own), [1.0], np.zeros(n)])
    lengths = np.where((norms := np.linalg.norm(change, axis=1)) > 0, norms, 1.0)
    for equilibrate in (True, False):
        problem = (sparse.csc_matrix((n, n)), sign * change[k] / lengths[k], sparse.csc_matrix(A), b, cones)
        answer = clarabel.DefaultSolver(*problem, settings(equilibrate)).solve()
        if str(answer.status) in SOLVED:
            return float(change[k] @ np.array(answer.x))
    raise UnsolvedError(str(answer.status), answer.iterations)
