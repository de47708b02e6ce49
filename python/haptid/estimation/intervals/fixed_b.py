"""Intervals from the slow waves of what blocks ask for, with critical values that know how few these are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError
from haptid.estimation.fit import Fit
from haptid.estimation.intervals.spread import Spread

# Fewer waves than this give no deviation worth the name.
FEWEST = 3


@dataclass(frozen=True)
class FixedB:
    """Heteroscedasticity and autocorrelation consistent, of a bandwidth that is a fixed share of the log.

    What each block asks all parameters to move, over all motors, is a series in time; its variance is the mean square
    of its slowest cosines. With a fixed number of them the interval is Student's, with as many degrees of freedom, and
    it is right however long residuals remember, as long as that is short beside the log, and however motors share
    them. Needs only the triangles of the blocks.

    Sources: Kiefer and Vogelsang (2005), Econometric Theory 21; Lazarus, Lewis, Stock and Watson (2018), JBES 36(4),
    eqs 8 and 9 (equal-weighted cosines).

    Attributes:
        share: of the cosines there are, as many as blocks, that are taken.
    """

    share: float = 0.5

    def __post_init__(self) -> None:
        if not (isinstance(self.share, float) or whole(self.share)) or not 0 < self.share <= 1:
            raise MethodSettingError("FixedB", "share", self.share, "a number above 0, up to 1")

    @property
    def name(self) -> str:
        return "fixed-b, cosines of time blocks, Student t"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Of base parameters, or of combinations of them, (q, p)."""
        made, spread = fit.moments, fit.combined(combinations)
        times, where = np.unique(made.block, return_inverse=True)
        series = np.zeros((len(times), len(spread)))
        np.add.at(series, where, made.moved @ spread.T)  # each without its own pull, as in the jackknife
        waves = min(max(FEWEST, round(self.share * len(times))), max(1, len(times) - 1))
        cosines = fft.dct(series, 2, norm="ortho", axis=0)[1 : waves + 1]
        covariance = len(times) / waves * cosines.T @ cosines
        if fit.solution.pull is not None:
            believed = spread @ fit.solution.pull.T
            covariance = covariance + believed @ believed.T
        return Spread(covariance, np.full(len(spread), float(waves)), len(made.s), made.alone(spread))
