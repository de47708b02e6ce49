"""Drift: the rate of change of parameters over a series of estimates, by weighted linear regression on time.

The regressor may be any other number that the parameters may depend on, such as a temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.errors import SettingError
from haptid.inference.comparison import Series, confidence_text, family_wise, significant
from haptid.uncertainty.multiple_testing import holm_adjusted, se_above_rounding, two_sided
from haptid.uncertainty.quantities import aligned, half_width


@dataclass(frozen=True, eq=False)
class Drift:
    """Weighted regression lines through the estimates of a series, one for each parameter.

    Weights are inverse variances, parameter by parameter; the covariance of the slopes uses the whole covariances.
    Weights from whole covariances would be more efficient, but these have no more degrees of freedom than a log has
    blocks, too few for an inverse. Since the weights are themselves estimates, each part of a variance is multiplied
    by 1 + 4 (1 - leverage) / dof (Meier 1953, Biometrics 9(1), for means; Kenward and Roger 1997, Biometrics 53(3),
    eq. 5, for lines). Degrees of freedom are those of Satterthwaite (1946), Biometrics Bulletin 2. For two estimates
    the test is that of `compare`.

    Attributes:
        series: the estimates.
        times: of the estimates, (n,), in `unit`.
        unit: of the times, such as "day".
        weights: slope = weights . values, (n, k); zero where a standard error is infinite.
        leverage: of each value on its line, (n, k).
    """

    series: Series
    times: Array
    unit: str
    weights: Array
    leverage: Array

    def __post_init__(self) -> None:
        shape = self.series.value.shape
        freeze_fields(self, "times", weights=shape, leverage=shape)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, (k,)."""
        return self.series.names

    @cached_property
    def slope(self) -> Array:
        """Change of each parameter in a unit of time, (k,); NaN with information at fewer than two times."""
        slope = (self.weights * self.series.value).sum(axis=0)
        return freeze(np.where(self._identifiable, slope, np.nan))

    @cached_property
    def covariance(self) -> Array:
        """Of the slopes, (k, k)."""
        weights = self.weights * np.sqrt(self._inflation)
        return freeze(np.einsum("ij,ik,ijk->jk", weights, weights, self.series.covariance))

    @cached_property
    def se(self) -> Array:
        """Standard errors of the slopes, (k,); infinite with information at fewer than two times."""
        return freeze(np.where(self._identifiable, np.sqrt(self._parts.sum(axis=0)), np.inf))

    @cached_property
    def dof(self) -> Array:
        """Degrees of freedom of each slope, (k,)."""
        total, squares = self._parts.sum(axis=0), (self._parts**2 / self.series.dof).sum(axis=0)
        return freeze(np.divide(total**2, squares, out=np.full(len(total), np.inf), where=squares > 0))

    def conf_int(self, level: float | None = None) -> Array:
        """Confidence intervals of the slopes, one by one, (k, 2); at the series' confidence where no level is given."""
        half = half_width(self.se, self.dof, self.series.confidence if level is None else level)
        return freeze(np.column_stack([self.slope - half, self.slope + half]))

    @cached_property
    def p(self) -> Array:
        """p-value of each slope by itself, (k,)."""
        return freeze(two_sided(self.slope, self.se, self.dof))

    @cached_property
    def holm(self) -> Array:
        """p-values with Holm's correction over all parameters, (k,)."""
        return holm_adjusted(self.p)

    @property
    def drifts(self) -> tuple[str, ...]:
        """Names of the parameters whose slope is significant."""
        return significant(self.names, self.holm, self.series.confidence)

    @cached_property
    def bent(self) -> tuple[str, ...]:
        """Names of the parameters with a significant lack of fit to their line: the drift is not steady."""
        line = np.column_stack([np.ones(len(self.times)), self.times - self.times.mean()])
        p = holm_adjusted(np.where(self._identifiable, self.series.misfits(line), 1.0))
        return significant(self.names, p, self.series.confidence)

    @property
    def _identifiable(self) -> np.ndarray:
        """Whether two different times have information on a parameter, (k,)."""
        return np.asarray(self.weights.any(axis=0))

    @cached_property
    def _parts(self) -> Array:
        """What each estimate adds to the variance of each slope, (n, k)."""
        known = np.where(np.isfinite(self.series.se), self.series.se, 0.0)
        return freeze(self._inflation * (self.weights * known) ** 2)

    @property
    def _inflation(self) -> Array:
        """Factor on each part of a variance for the uncertainty of the weights, (n, k)."""
        return np.asarray(1.0 + 4.0 * (1.0 - self.leverage) / self.series.dof)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What drifts, in order of significance; then what is not linear in time."""
        order = sorted((self.names.index(name) for name in self.drifts), key=lambda k: self.p[k])
        confidence = family_wise(self.series.confidence, len(self.names))
        sentences = [self._sentence(k) for k in order] or [f"No parameter drifts {confidence}."]
        if self.bent:
            sentences.append(f"Not linear in time {confidence}: {', '.join(self.bent)}. Their slopes are averages.")
        return tuple(sentences)

    def _sentence(self, k: int) -> str:
        size, unit = abs(self.series.common[k]), f"{self.series.units[k]} in a {self.unit}"
        share = f", {100 * self.slope[k] / size:+.2g} % of its size" if size > 0 else ""
        low, high = self.conf_int()[k]
        return (
            f"{self.names[k]} drifts by {self.slope[k]:.3g} {unit}{share} (interval {low:.2g} .. {high:.2g}, "
            f"p = {self.holm[k]:.1e})."
        )

    def summary(self) -> str:
        """A text table, then the sentences. `drifts up to` is a confidence level; an asterisk marks what drifts."""
        interval = f"{100 * self.series.confidence:g} % interval"
        rows = [["", f"in a {self.unit}", "std err", interval, "drifts up to", "", "unit"]]
        for k, (low, high) in enumerate(self.conf_int()):
            mark = "*" if self.names[k] in self.drifts else ""
            slope, se = f"{self.slope[k]:.3g}", f"{self.se[k]:.2g}"
            ends = f"{low:.3g} .. {high:.3g}"
            rows.append([self.names[k], slope, se, ends, confidence_text(self.holm[k]), mark, self.series.units[k]])
        return "\n".join([*aligned(rows), "", *self.sentences])


def drift(series: Series, times: Sequence[float], unit: str = "day") -> Drift:
    """Rates of change of the parameters, with confidence intervals.

    Args:
        series: the estimates.
        times: when each was recorded, (n,), or any other number that the parameters may depend on.
        unit: of the times.

    Raises:
        SettingError: not one time for each estimate; a time is not finite, or all are the same.
    """
    t = np.asarray(times, dtype=float)
    if t.shape != (len(series),):
        raise SettingError(
            f"{t.size} times are given for {len(series)} estimates; give one for each.",
            where="times",
            found=t.size,
            limit=len(series),
        )
    if not np.isfinite(t).all() or np.ptp(t) == 0:
        raise SettingError(
            f"the times are {t.tolist()!r}; give finite numbers, at least two different ones.",
            where="times",
            found=t.tolist(),
        )
    lines = [_line(t, value, se) for value, se in zip(series.value.T, series.se.T, strict=True)]
    weights, leverage = (np.column_stack(part) for part in zip(*lines, strict=True))
    return Drift(series, t, unit, weights, leverage)


def _line(t: Array, value: Array, se: Array) -> tuple[Array, Array]:
    """Coefficients of a slope, (t - mean) / s^2 over the sum of (t - mean)^2 / s^2, and leverages, both (n,)."""
    se = se_above_rounding(value, se)
    least = se.min()
    if not np.isfinite(least):
        return np.zeros(len(t)), np.ones(len(t))
    weight = (least / se) ** 2 if least > 0 else np.ones(len(t))
    centred = t - weight @ t / weight.sum()
    spread = float(weight @ centred**2)
    if spread <= np.finfo(float).eps * np.ptp(t) ** 2:  # information at one time only, however often
        return np.zeros(len(t)), np.ones(len(t))
    return weight * centred / spread, weight * (1.0 / weight.sum() + centred**2 / spread)
