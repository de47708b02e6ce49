"""Fixed-b HAC standard errors: a series estimator of the long-run variance of the blocks' scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import fft

from haptid._internal.arrays import Array, whole
from haptid.estimation.intervals.covariance import Spread
from haptid.estimation.method import Fit, setting_error

# Least number of cosines.
_FEWEST = 3


@dataclass(frozen=True)
class FixedB:
    """Heteroscedasticity and autocorrelation consistent covariance, with a bandwidth that is a fixed share of the log.

    The scores of the time blocks, over all motors, are a series; its long-run variance is the mean square of its
    lowest cosine coefficients. With a fixed number of them the interval is Student's, with that many degrees of
    freedom, whatever the correlation across motors, and for any serial correlation that is short compared with the
    log. Needs only the R factors of the blocks.

    Sources: Kiefer and Vogelsang (2005), Econometric Theory 21; Lazarus, Lewis, Stock and Watson (2018), JBES 36(4),
    eqs 8 and 9 (equal-weighted cosines).

    Attributes:
        share: of the cosines, of which there are as many as blocks, that are used.
    """

    name: ClassVar[str] = "fixed-b, cosines of time blocks, Student t"
    share: float = 0.5

    def __post_init__(self) -> None:
        if not (isinstance(self.share, float) or whole(self.share)) or not 0 < self.share <= 1:
            raise setting_error("FixedB", "share", self.share, "a number above 0, up to 1")

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them."""
        moments, own = fit.moments, fit.combined(combinations)
        times, where = np.unique(moments.block, return_inverse=True)
        series = np.zeros((len(times), len(own)))
        np.add.at(series, where, moments.leave_out_shifts @ own.T)  # corrected for leverage, as in the jackknife
        count = min(max(_FEWEST, round(self.share * len(times))), max(1, len(times) - 1))
        cosines = fft.dct(series, 2, norm="ortho", axis=0)[1 : count + 1]
        covariance = len(times) / count * cosines.T @ cosines
        if fit.solution.pull is not None:
            prior = own @ fit.solution.pull.T
            covariance = covariance + prior @ prior.T
        return Spread(covariance, np.full(len(own), float(count)), len(moments.s), moments.alone(own))
