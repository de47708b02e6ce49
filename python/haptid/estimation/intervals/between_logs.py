"""`BetweenLogs`: how much parameters scatter from log to log, and intervals that cover a repeat on another day.

Time blocks of one log share its day: friction at its temperature, zeros of its encoders, its grease. An interval from
blocks is of the mean over *these* logs. Where there are three logs or more, the logs themselves are clusters: the
delete-one-log jackknife estimates the variance of the parameters over days, whatever drifts between them.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.estimation.block_moments import Adjustment, BlockMoments
from haptid.estimation.intervals.covariance import with_prior_variance
from haptid.estimation.method import Fit
from haptid.uncertainty.distributions import f_tail
from haptid.uncertainty.multiple_testing import holm_adjusted
from haptid.uncertainty.quantities import LEVEL, Quantities, half_width

# Fewest logs from which their scatter is estimated, and fewest that must have information on a parameter: the sum of
# their shares in its variance squared, over the sum of squares.
LEAST_LOGS = 3
_LEAST_EFFECTIVE = 1.5
# Eigenvalues of a log's information below this share of the largest: directions that the log does not excite.
_EXCITED = 1e-9


@dataclass(frozen=True, eq=False)
class BetweenLogs:
    """Scatter between logs of base parameters, or of combinations of them, k in all.

    Three intervals with three meanings: `Estimate.conf_int` holds the parameters' mean over the logs of the fit;
    `conf_int` their mean over all days of which the logs are a sample; `repeat_conf_int` the estimate of one more log,
    as informative as these, on another day. The latter two contain the first.

    With l the share of each log in the variance of a parameter, n = (sum l)^2 / sum l^2 logs count for it. Its variance
    over days is the jackknife's, V = (J - 1) / J sum (shift without a log)^2, with n - 1 degrees of freedom; a repeat
    differs from the mean by a variance of (1 + n) V. Exact for logs of one motion: V is then their sample variance over
    J, and the interval of a repeat that of Student.

    Sources: Bell and McCaffrey (2002), Survey Methodology 28, CR3 and its degrees of freedom, with logs as clusters;
    Higgins, Thompson and Spiegelhalter (2009), Journal of the Royal Statistical Society A 172(1), prediction intervals.

    Attributes:
        values: the parameters, (k,), SI.
        logs: how many.
        effective: number of logs n that count for each parameter, (k,).
        pooled: the unconstrained fit, with the covariance of the estimate, from all blocks.
        within: with covariance from blocks about each log's own fit, and the nuisances'.
        across: with covariance from logs and the nuisances'; unbounded where less than one and a half logs count.
        scatter: ratio of the variances of both without nuisances, with the correction of CR2 for logs, (k,).
    """

    values: Array
    logs: int
    effective: Array
    pooled: Quantities
    within: Quantities
    across: Quantities
    scatter: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "values", "effective", "scatter")

    @staticmethod
    def of(fit: Fit, estimated: Quantities, values: Array, C: Array, shifts: Array) -> BetweenLogs | None:
        """Of combinations of base parameters; None with fewer than three logs.

        Args:
            fit: of several logs.
            estimated: the combinations in the unconstrained fit.
            values: the combinations in the estimate, (k,), SI.
            C: factors of the base parameters, (k, p).
            shifts: by how much one standard error of each nuisance moves the base parameters, (n, p), SI.
        """
        blocks, names = fit.pooled_moments, [block.log for block in fit.observation.blocks]
        owners = np.unique([names[k] for k in blocks.block], return_inverse=True)[1]
        many = int(owners.max()) + 1
        if many < LEAST_LOGS:
            return None
        logs = _summed(blocks, owners, many)
        own = fit.combined(C)
        shares = logs.shares(own)
        total, squares = shares.sum(axis=0) ** 2, (shares**2).sum(axis=0)
        effective = np.divide(total, squares, out=np.full(len(own), float(many)), where=squares > 0)
        jackknife, corrected = logs.leave_out_shifts @ own.T, Adjustment.of(logs.G).times(logs.s) @ own.T
        inside, outside = _within(blocks, owners, logs, own), (many - 1) / many * jackknife.T @ jackknife
        variance = np.diag(inside)
        scatter = np.divide((corrected**2).sum(axis=0), variance, out=np.ones(len(own)), where=variance > 0)
        single = np.union1d(np.flatnonzero(effective < _LEAST_EFFECTIVE), logs.alone(own))

        def quantities(covariance: Array, dof: Array, unbounded: tuple[int, ...]) -> Quantities:
            for coordinates, pull in ((own, fit.solution.pull), (C, shifts if len(shifts) else None)):
                covariance, dof = with_prior_variance(covariance, dof, coordinates, pull)
            return Quantities(estimated.names, estimated.units, estimated.values, covariance, dof, unbounded)

        return BetweenLogs(
            values=values,
            logs=many,
            effective=effective,
            pooled=estimated,
            within=quantities(inside, estimated.dof, estimated.unbounded),
            across=quantities(outside, np.maximum(effective - 1.0, 1.0), tuple(map(int, single))),
            scatter=scatter,
        )

    @cached_property
    def deviation(self) -> Array:
        """Standard deviation from log to log beyond the noise of blocks, (k,).

        A variance component by its moments; 0 where noise explains the scatter, NaN where too few logs count.
        """
        excess = np.maximum(self.across.se**2 - self.within.se**2, 0.0)
        with np.errstate(invalid="ignore"):
            return freeze(np.where(np.isfinite(self.across.se), np.sqrt(self.effective * excess), np.nan))

    @cached_property
    def p(self) -> Array:
        """p-values of the hypothesis that logs scatter by the noise of their blocks alone, F test, (k,)."""
        probabilities = f_tail(self.scatter, np.maximum(self.effective - 1.0, 1.0), self.within.dof)
        return freeze(np.where(np.isfinite(self.across.se), probabilities, 1.0))

    def differs(self, confidence: float = LEVEL) -> tuple[str, ...]:
        """Names of the parameters that scatter between logs beyond noise, Holm's correction over all of them."""
        adjusted = holm_adjusted(self.p) < 1 - confidence
        return tuple(name for name, far in zip(self.across.names, adjusted, strict=True) if far)

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals of the mean over days, (k, 2), SI."""
        return self._interval(np.ones(len(self.values)), level)

    def repeat_conf_int(self, level: float = LEVEL) -> Array:
        """Prediction intervals of the estimate from one more log, on another day, (k, 2), SI."""
        return self._interval(np.sqrt(1.0 + self.effective), level)

    def _interval(self, factor: Array, level: float) -> Array:
        """The wider of the intervals from logs and of the estimate, about the unconstrained fit, with the values."""
        sides = [half_width(factor * quantities.se, quantities.dof, level) for quantities in (self.across, self.pooled)]
        half, free = np.maximum(*sides), self.across.values
        return freeze(np.column_stack([np.minimum(free - half, self.values), np.maximum(free + half, self.values)]))

    @property
    def sentences(self) -> tuple[str, ...]:
        """What scatters, and which interval to quote."""
        far = self.differs()
        confidence = f"({100 * LEVEL:g} % confidence for all together)"
        meaning = f'The "95 % interval" is of the mean over these {self.logs} logs.'
        if not far:
            return (f"{meaning} No parameter scatters between them beyond the noise of their blocks {confidence}.",)
        order = sorted((self.across.names.index(name) for name in far), key=lambda k: self.p[k])
        sizes = ", ".join(f"{self.across.names[k]} by {self._relative(k)}" for k in order)
        return (
            f"{meaning} From log to log more scatters than the noise of blocks explains {confidence}: {sizes}. For "
            "another day quote the interval of a repeat.",
        )

    def _relative(self, k: int) -> str:
        size, own = abs(float(self.values[k])), float(self.deviation[k])
        return f"{100 * own / size:.2g} %" if size > 0 else f"{own:.2g} {self.across.units[k]}"


def _summed(blocks: BlockMoments, owners: np.ndarray, logs: int) -> BlockMoments:
    """Moments of each log from those of its blocks."""
    k = blocks.s.shape[1]
    G, s = np.zeros((logs, k, k)), np.zeros((logs, k))
    np.add.at(G, owners, blocks.G)
    np.add.at(s, owners, blocks.s)
    return BlockMoments(G, s, np.arange(logs))


def _within(blocks: BlockMoments, owners: np.ndarray, logs: BlockMoments, own: Array) -> Array:
    """Covariance of combinations (q, k) from the blocks' scores about each log's own fit, CR2, (q, q).

    The pooled estimate is sum_j G_j g_j, g_j the fit of log j alone in the directions that it excites.
    """
    total = np.zeros((len(own), len(own)))
    for j in range(len(logs.s)):
        values, vectors = np.linalg.eigh(logs.G[j])
        excited = values > _EXCITED * values[-1]
        root = vectors[:, excited] * np.sqrt(values[excited])
        whitening = (vectors[:, excited] / np.sqrt(values[excited])).T
        G = whitening @ blocks.G[owners == j] @ whitening.T
        s = blocks.s[owners == j] @ whitening.T - G @ (whitening @ logs.s[j])
        scores = Adjustment.of(G).times(s) @ root.T @ own.T
        total += scores.T @ scores
    return total
