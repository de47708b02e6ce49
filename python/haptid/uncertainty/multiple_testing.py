"""Tests of several values: Holm's adjustment, Student's t, and Johansen's (Welch's) test of equal means.

Variances may be unequal; each is an estimate with degrees of freedom of its own.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.uncertainty.distributions import chi2_tail, f_tail, t_tail

# A standard error below this share of the largest value is rounding: values that are held have none at all.
_ROUNDING = 1e-9


def two_sided(value: Array, se: Array, dof: Array) -> Array:
    """Two-sided p-values of Student's t test against zero, (k,); 0 or 1 where the standard error is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.abs(value) / se
    return np.asarray(2.0 * t_tail(np.where(np.isnan(t), 0.0, t), dof))


def holm_adjusted(p: Array) -> Array:
    """P-values adjusted for multiple testing by Holm's step-down procedure, (k,), from those of single tests, (k,).

    Source: Holm (1979), Scandinavian Journal of Statistics 6.
    """
    order = np.argsort(p)
    steps = p[order] * np.arange(len(order), 0, -1)
    adjusted = np.empty(len(order))
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return freeze(adjusted)


def se_above_rounding(value: Array, se: Array) -> Array:
    """Standard errors, (n,), none of them below the rounding of the values, (n,)."""
    return np.asarray(np.maximum(se, _ROUNDING * np.abs(value).max(initial=0.0)))


def johansen_p(value: Array, se: Array, dof: Array, columns: Array) -> float:
    """P-value of Johansen's test that values are a linear combination of columns, apart from their errors.

    With a single column of ones this is Welch's test of equal means, and of two values his t test.

    Source: Johansen (1980), Biometrika 67(1), whose statistic has these sums where each group has one variance; Welch
    (1951), Biometrika 38, eq. (20).

    Args:
        value: (n,).
        se: their standard errors, infinite where nothing is known, (n,).
        dof: degrees of freedom of each standard error, (n,).
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
    correction = float(np.sum((1.0 - np.sum(Q**2, axis=1)) ** 2 / dof))
    if correction == 0.0:
        return float(chi2_tail(square, free))
    size = free + 2 * correction - 6 * correction / (free + 2)
    return float(f_tail(square / size, free, free * (free + 2) / (3 * correction)))
