"""Drift: how fast the parameters of several estimates change with time, or with anything else that has a number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.errors import TimeCountError, TimeValueError
from haptid.inference.several import Series, confidence_text
from haptid.inference.targets import aligned
from haptid.uncertainty.multiple_testing import deviations_to_weigh, together, two_sided


@dataclass(frozen=True, eq=False)
class Drift:
    """Straight lines through the estimates of a series, parameter by parameter, each value with its own weight.

    Each parameter has weighted least squares of its own, with one over the variances as weights; the whole
    covariances go into that of the slopes. Weights from whole covariances would be finer, but these have no more
    degrees of freedom than there are blocks of a log, too few to be inverted. That the weights are estimates too makes
    slopes less sure: each part of a variance grows by 1 + 4 (1 - leverage) / freedom (Meier 1953, Biometrics 9(1), for
    means; Kenward and Roger 1997, Biometrics 53(3), eq. 5, for lines). Degrees of freedom are Satterthwaite's (1946),
    Biometrics Bulletin 2. Of two estimates the test is that of `compare`.

    Attributes:
        series: what the lines go through.
        times: of the estimates, (n,), in `unit`.
        unit: of the times, such as "day".
        weights: slope = weights . values, (n, k); zero where nothing is known.
        leverage: of each value on its line, (n, k).
    """

    series: Series
    times: Array
    unit: str
    weights: Array
    leverage: Array

    def __post_init__(self) -> None:
        for name in ("times", "weights", "leverage"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("weights", "leverage"):
            expect(name, getattr(self, name).shape, self.series.value.shape)

    @property
    def names(self) -> tuple[str, ...]:
        return self.series.names

    @cached_property
    def slope(self) -> Array:
        """Change of each parameter in a unit of time, (k,); NaN where fewer than two times tell it."""
        made = (self.weights * self.series.value).sum(axis=0)
        return freeze(np.where(self._told, made, np.nan))

    @cached_property
    def covariance(self) -> Array:
        """Of the slopes, (k, k)."""
        weights = self.weights * np.sqrt(self._grown)
        return freeze(np.einsum("ij,ik,ijk->jk", weights, weights, self.series.covariance))

    @cached_property
    def se(self) -> Array:
        """Deviations of the slopes, (k,); infinite where fewer than two times tell it."""
        return freeze(np.where(self._told, np.sqrt(self._parts.sum(axis=0)), np.inf))

    @cached_property
    def dof(self) -> Array:
        """Degrees of freedom of each slope, (k,)."""
        whole, each = self._parts.sum(axis=0), (self._parts**2 / self.series.dof).sum(axis=0)
        return freeze(np.divide(whole**2, each, out=np.full(len(whole), np.inf), where=each > 0))

    @cached_property
    def interval(self) -> Array:
        """Interval of each slope by itself at the confidence of the series, (k, 2)."""
        half = stats.t.ppf((1 + self.series.confidence) / 2, self.dof) * self.se
        return freeze(np.column_stack([self.slope - half, self.slope + half]))

    @cached_property
    def p(self) -> Array:
        """Probability of so great a slope of what does not change, each taken by itself, (k,)."""
        return freeze(two_sided(self.slope, self.se, self.dof))

    @cached_property
    def holm(self) -> Array:
        """The same, taken together with all others, (k,)."""
        return together(self.p)

    @property
    def drifts(self) -> tuple[str, ...]:
        """Names of the parameters that drift at the confidence of the series."""
        return self._under(self.holm)

    @cached_property
    def bent(self) -> tuple[str, ...]:
        """Names of those whose values lie off their line by more than their deviations: it is not a steady drift."""
        turned = self.series.misfits(np.column_stack([np.ones(len(self.times)), self.times - self.times.mean()]))
        return self._under(together(np.where(self._told, turned, 1.0)))

    def _under(self, p: Array) -> tuple[str, ...]:
        return tuple(name for name, one in zip(self.names, p, strict=True) if one < 1 - self.series.confidence)

    @property
    def _told(self) -> np.ndarray:
        """Whether two different times tell a parameter, (k,)."""
        return np.asarray(self.weights.any(axis=0))

    @cached_property
    def _parts(self) -> Array:
        """What each estimate adds to the variance of each slope, (n, k)."""
        known = np.where(np.isfinite(self.series.se), self.series.se, 0.0)
        return freeze(self._grown * (self.weights * known) ** 2)

    @property
    def _grown(self) -> Array:
        """By what the doubt of the weights makes each part of a variance grow, (n, k)."""
        return np.asarray(1.0 + 4.0 * (1.0 - self.leverage) / self.series.dof)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What drifts in plain words, the surest first; then what is no straight line."""
        order = sorted((self.names.index(name) for name in self.drifts), key=lambda k: self.p[k])
        at = f"at {100 * self.series.confidence:g} % confidence for all {len(self.names)} together"
        said = [self._sentence(k) for k in order] or [f"No parameter drifts {at}."]
        if self.bent:
            said.append(f"Not on a straight line {at}: {', '.join(self.bent)}. Their slopes are only means.")
        return tuple(said)

    def _sentence(self, k: int) -> str:
        size, unit = abs(self.series.common[k]), f"{self.series.units[k]} in a {self.unit}"
        share = f", {100 * self.slope[k] / size:+.2g} % of its size" if size > 0 else ""
        low, high = self.interval[k]
        return (
            f"{self.names[k]} drifts by {self.slope[k]:.3g} {unit}{share} (interval {low:.2g} .. {high:.2g}, "
            f"p = {self.holm[k]:.1e})."
        )

    def summary(self) -> str:
        """A table as text, then the sentences. `drifts up to` is a confidence; an asterisk marks what drifts."""
        head = (
            "",
            f"in a {self.unit}",
            "sd",
            f"{100 * self.series.confidence:g} % interval",
            "drifts up to",
            "",
            "unit",
        )
        rows = [
            (
                name,
                f"{self.slope[k]:.3g}",
                f"{self.se[k]:.2g}",
                f"{self.interval[k, 0]:.3g} .. {self.interval[k, 1]:.3g}",
                confidence_text(self.holm[k]),
                "*" if name in self.drifts else "",
                self.series.units[k],
            )
            for k, name in enumerate(self.names)
        ]
        return "\n".join([*aligned([head, *rows]), "", *self.sentences])


def drift(series: Series, times: Sequence[float], unit: str = "day") -> Drift:
    """How fast the parameters change, with intervals.

    Args:
        series: the estimates.
        times: when each was recorded, (n,), or any other number that they may change with, such as a temperature.
        unit: of the times.

    Raises:
        TimeCountError: not one time for each estimate.
        TimeValueError: a time is no finite number, or all are the same.
    """
    t = np.asarray(times, dtype=float)
    if t.shape != (len(series),):
        raise TimeCountError(t.size, len(series))
    if not np.isfinite(t).all() or np.ptp(t) == 0:
        raise TimeValueError(t.tolist())
    lines = [_line(t, value, se) for value, se in zip(series.value.T, series.se.T, strict=True)]
    weights, leverage = (np.column_stack(part) for part in zip(*lines, strict=True))
    return Drift(series, t, unit, weights, leverage)


def _line(t: Array, value: Array, se: Array) -> tuple[Array, Array]:
    """What a slope is made of, (t - mean) / s^2 over the sum of (t - mean)^2 / s^2, and leverages, both (n,)."""
    se = deviations_to_weigh(value, se)
    least = se.min()
    if not np.isfinite(least):
        return np.zeros(len(t)), np.ones(len(t))
    weight = (least / se) ** 2 if least > 0 else np.ones(len(t))
    away = t - weight @ t / weight.sum()
    spread = float(weight @ away**2)
    if spread <= np.finfo(float).eps * np.ptp(t) ** 2:  # one time tells it, however often
        return np.zeros(len(t)), np.ones(len(t))
    return weight * away / spread, weight * (1.0 / weight.sum() + away**2 / spread)
