"""Intervals by leaving out one motor's second at a time, and seeing how far the estimate moves.

The delete-one-block jackknife (CR3 of Bell and McCaffrey 2002, Survey Methodology 28) needs only the triangles of the
blocks, whatever the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation.fit import Fit, Moments
from haptid.estimation.intervals.cluster_robust import LEAST_FREEDOM
from haptid.estimation.intervals.spread import Spread, believing


@dataclass(frozen=True)
class BlockJackknife:
    """Each block of each motor is left out in turn: right where motors do not share what the model lacks.

    A few per cent wider than the default where parameters are many beside the blocks.

    Source: Bell and McCaffrey (2002), Survey Methodology 28, CR3, and their degrees of freedom.
    """

    @property
    def name(self) -> str:
        return "CR3 jackknife over motor and time block, Student t with Satterthwaite degrees of freedom"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance by leaving out each block of each motor in turn; of base parameters, or combinations (q, p).

        Knowledge with a deviation adds its own variance, as if its value had been drawn with that deviation.
        """
        return _spread(fit.moments, fit.combined(combinations), fit.solution.pull)


def _spread(made: Moments, spread: Array, pull: Array | None) -> Spread:
    """Of combinations (q, k) of the moments' coordinates."""
    shifts, blocks = made.moved @ spread.T, len(made.s)
    outer = shifts.T @ shifts * (blocks - 1) / max(blocks, 1)
    covariance, degrees = believing(outer, dof(made, spread), spread, pull)
    return Spread(covariance, degrees, blocks, made.alone(spread))


def dof(made: Moments, spread: Array) -> Array:
    """Satterthwaite's, from how evenly the blocks carry a combination: (sum l)^2 / sum l^2 - 1, (q,)."""
    shares = made.shares(spread)
    squares = (shares**2).sum(axis=0)  # zero where a parameter is held at zero, which nothing can doubt
    whole = shares.sum(axis=0) ** 2
    effective = np.divide(whole, squares, out=np.full(len(whole), np.inf), where=squares > 0)
    return np.asarray(np.maximum(effective - 1.0, LEAST_FREEDOM))
