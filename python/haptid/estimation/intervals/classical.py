"""The textbook's intervals: right where residuals are white and columns exact, and far too narrow elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.spread import Spread


@dataclass(frozen=True)
class Classical:
    """(W'W)^-1 times the variance of the residual. Of whitened rows, as of `GLS()`, they are the method's own.

    Source: Janot et al. (2007), ISIE, eqs 15 and 16.
    """

    @property
    def name(self) -> str:
        return "textbook, for a white residual"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of base parameters, or of combinations of them, (q, p)."""
        made = fit.solution.classical_covariance(fit.unit_residual)
        if combinations is not None:
            made = combinations @ made @ combinations.T
        rows = fit.observation.motors
        blocks = int(sum((motor.rows > 0).sum() for motor in rows))
        return Spread(made, np.full(len(made), float(fit.solution.dof)), blocks, np.array([], dtype=int))
