"""Standard errors robust to serial correlation, from the scores of time blocks: CR2, the CR3 jackknife and fixed-b.

Residuals of robots are serially correlated, and motors share the errors of the model, so standard errors that take the
rows as independent are far too small. The covariance is built from the score of each block instead. CR2 corrects each
block for its leverage (bias-reduced linearisation); Satterthwaite degrees of freedom account for the small number of
effective blocks. Fixed-b (`FixedB`) takes the scores as a time series instead. All need only the R factors.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array, whole
from haptid._internal.late import dataclass
from haptid.errors import setting_error
from haptid.estimation.block_moments import Adjustment, BlockMoments
from haptid.estimation.intervals.covariance import Spread, with_prior_variance
from haptid.estimation.least_squares import Solution
from haptid.estimation.method import Fit
from haptid.observation.observation import Observation

# Least degrees of freedom: with fewer effective blocks an interval means nothing.
LEAST_DOF = 2.0
# Least number of cosines of the fixed-b series.
_FEWEST_COSINES = 3


@dataclass(frozen=True)
class ClusterRobust:
    """The default: CR2 over time blocks, all motors together.

    Source: Bell and McCaffrey (2002), Survey Methodology 28, CR2, with degrees of freedom after Pustejovsky and Tipton
    (2018), Journal of Business and Economic Statistics 36, section 3.2, for rows that are independent.
    """

    name: ClassVar[str] = "CR2 over time blocks of all motors, Student t with Satterthwaite degrees of freedom"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them; a prior adds its own variance."""
        moments, own = fit.pooled_moments, fit.combined(combinations)
        adjustment = moments.adjustment
        scores = adjustment.times(moments.s) @ own.T
        dof = _cr2_freedom(moments, adjustment, own)
        covariance, dof = with_prior_variance(scores.T @ scores, dof, own, fit.solution.pull)
        return Spread(covariance, dof, len(moments.s), moments.alone(own, adjustment.eigen))


def clustered(
    observation: Observation, weights: Array, solution: Solution, combinations: Array | None = None
) -> Spread:
    """CR2 of rows and a solution of them.

    Args:
        weights: of each motor's rows, (motors,).
        solution: the fit with these weights.
        combinations: of base parameters, (q, p); each base parameter where None.
    """
    return ClusterRobust().spread(Fit(observation, weights, solution, True), combinations)


def _cr2_freedom(moments: BlockMoments, adjustment: Adjustment, combinations: Array) -> Array:
    """Degrees of freedom (tr P)^2 / tr P^2 of combinations (q, k), (q,).

    P_gh is the covariance of the scores of blocks g and h for independent rows: c'G c on the diagonal and -b_g'b_h off
    it, b = G (1 - G)^-1/2 c.
    """
    own = moments.shares(combinations)
    b = adjustment.carried(combinations)
    diagonal = np.einsum("bkq,bkq->bq", b, b)
    all_pairs = np.array([((x.T @ x) ** 2).sum() for x in b.transpose(2, 0, 1)])
    squares = (own**2).sum(axis=0) + all_pairs - (diagonal**2).sum(axis=0)
    # Zero where a parameter is fixed, which has no uncertainty.
    effective = np.divide(own.sum(axis=0) ** 2, squares, out=np.full(len(squares), np.inf), where=squares > 0)
    return np.asarray(np.maximum(effective, LEAST_DOF))


@dataclass(frozen=True)
class BlockJackknife:
    """CR3: the delete-one-block jackknife over each block of each motor, for errors that motors do not share.

    A few per cent wider than the default where parameters are many compared with the blocks. It is no setting of
    `ClusterRobust`: the clusters differ (a block of one motor, not of all motors), not only the correction for
    leverage.

    Source: Bell and McCaffrey (2002), Survey Methodology 28, CR3, and their degrees of freedom.
    """

    name: ClassVar[str] = "CR3 jackknife over motor and time block, Student t with Satterthwaite degrees of freedom"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them; a prior adds its own variance."""
        moments, own = fit.moments, fit.combined(combinations)
        shifts, blocks = moments.leave_out_shifts @ own.T, len(moments.s)
        outer = shifts.T @ shifts * (blocks - 1) / max(blocks, 1)
        covariance, dof = with_prior_variance(outer, _cr3_freedom(moments, own), own, fit.solution.pull)
        return Spread(covariance, dof, blocks, moments.alone(own))


def _cr3_freedom(moments: BlockMoments, combinations: Array) -> Array:
    """Satterthwaite's, from the shares l of the blocks in a combination: (sum l)^2 / sum l^2 - 1, (q,)."""
    shares = moments.shares(combinations)
    squares = (shares**2).sum(axis=0)  # zero where a parameter is fixed, which has no uncertainty
    total = shares.sum(axis=0) ** 2
    effective = np.divide(total, squares, out=np.full(len(total), np.inf), where=squares > 0)
    return np.asarray(np.maximum(effective - 1.0, LEAST_DOF))


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
            raise setting_error("share", self.share, "a number above 0, up to 1", "FixedB")

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them."""
        moments, own = fit.moments, fit.combined(combinations)
        times, time_of = np.unique(moments.block, return_inverse=True)
        series = np.zeros((len(times), len(own)))
        np.add.at(series, time_of, moments.leave_out_shifts @ own.T)  # corrected for leverage, as in the jackknife
        count = min(max(_FEWEST_COSINES, round(self.share * len(times))), max(1, len(times) - 1))
        places = np.pi * (np.arange(len(times)) + 0.5) / len(times)
        cosines = np.sqrt(2.0 / len(times)) * np.cos(np.arange(1, count + 1)[:, None] * places) @ series
        covariance = len(times) / count * cosines.T @ cosines
        if fit.solution.pull is not None:
            prior = own @ fit.solution.pull.T
            covariance = covariance + prior @ prior.T
        return Spread(covariance, np.full(len(own), float(count)), len(moments.s), moments.alone(own))
