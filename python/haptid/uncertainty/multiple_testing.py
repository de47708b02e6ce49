"""Tests of independent values of unequal variances, each variance an estimate with degrees of freedom of its own."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.uncertainty.distributions import chi2_tail, f_tail, t_tail

# A deviation below this share of the values is rounding: what is held has none at all.
_ROUNDING = 1e-9


def two_sided(value: Array, se: Array, dof: Array) -> Array:
    """Two-sided probability of Student's t of each value under zero, (k,); without deviation, whether it is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(value) / se
    return np.asarray(2.0 * t_tail(np.where(np.isnan(t), 0.0, t), dof))


def together(p: Array) -> Array:
    """Probabilities taken one by one, (k,), as they are for all of them together.

    Source: Holm (1979), Scandinavian Journal of Statistics 6.
    """
    order = np.argsort(p)
    steps = p[order] * np.arange(len(order), 0, -1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return freeze(adjusted)


def se_above_rounding(value: Array, se: Array) -> Array:
    """Deviations, (n,), none of them below what is rounding of the values, (n,)."""
    return np.asarray(np.maximum(se, _ROUNDING * np.abs(value).max(initial=0.0)))


def misfit(value: Array, se: Array, dof: Array, columns: Array) -> float:
    """Probability of values so far from their weighted fit to columns, where the columns are all there is.

    With a single column of ones this is Welch's test of equal means, and of two values his t test.

    Source: Johansen (1980), Biometrika 67(1), whose statistic has these sums where each group has one variance; Welch
    (1951), Biometrika 38, eq. (20).

    Args:
        value: (n,).
        se: its deviations, infinite where nothing is known, (n,).
        dof: degrees of freedom of each deviation, (n,).
        columns: of full rank, (n, c).
    """
    finite = np.isfinite(se)
    value, se, dof, columns = value[finite], se[finite], dof[finite], columns[finite]
    free = len(value) - columns.shape[1]
    if free < 1 or not value.any():
        return 1.0
    se = se_above_rounding(value, se)
    Q = np.linalg.qr(columns / se[:, None])[0]
    scaled = value / se
    square = float(np.sum((scaled - Q @ (Q.T @ scaled)) ** 2))
    doubt = float(np.sum((1.0 - np.sum(Q**2, axis=1)) ** 2 / dof))
    if doubt == 0.0:
        return float(chi2_tail(square, free))
    size = free + 2 * doubt - 6 * doubt / (free + 2)
    return float(f_tail(square / size, free, free * (free + 2) / (3 * doubt)))
