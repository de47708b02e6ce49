"""Tails and quantiles of the distributions that tests and intervals use.

The functions of `scipy.special` behind `scipy.stats`, which takes as long to import as all the rest of SciPy, and
checks its arguments for longer than it computes.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from haptid._internal.arrays import Array, freeze

# Values below which the approximations of the moments' distributions are poor.
_FEWEST = 20


def t_tail(x: ArrayLike, dof: ArrayLike) -> Array:
    """Probability that Student's t with `dof` degrees of freedom, possibly infinite, exceeds x."""
    return np.asarray(special.stdtr(dof, np.negative(x)))


def t_quantile(p: ArrayLike, dof: ArrayLike) -> Array:
    """Value below which Student's t lies with probability p, 0 < p < 1."""
    return np.asarray(special.stdtrit(dof, p))


def f_tail(x: ArrayLike, above: ArrayLike, below: ArrayLike) -> Array:
    """Probability that Fisher's F with so many degrees of freedom above and below the line exceeds x."""
    below = np.minimum(below, 1e300)  # the incomplete beta function of infinity is not defined
    return np.asarray(special.fdtrc(above, below, np.maximum(x, 0.0)))


def f_quantile(p: ArrayLike, above: ArrayLike, below: ArrayLike) -> Array:
    """Value below which Fisher's F lies with probability p."""
    return np.asarray(special.fdtri(above, below, p))


def noncentral_f_tail(x: ArrayLike, above: ArrayLike, below: ArrayLike, noncentrality: ArrayLike) -> Array:
    """Probability that a noncentral F exceeds x."""
    return np.asarray(1.0 - special.ncfdtr(above, below, noncentrality, x))


def chi2_tail(x: ArrayLike, dof: ArrayLike) -> Array:
    """Probability that chi squared with `dof` degrees of freedom exceeds x."""
    return np.asarray(special.chdtrc(dof, np.maximum(x, 0.0)))


def normal_quantile(p: ArrayLike) -> Array:
    """Value below which a standard normal variable lies with probability p."""
    return np.asarray(special.ndtri(p))


def signed_rank_tail(differences: Array) -> float:
    """Probability that differences about zero, (n,), have positive ones of such ranks: Wilcoxon's signed-rank test.

    Exact; zeros are left out, and equal sizes are ranked in the order given.

    Source: Wilcoxon (1945), Biometrics Bulletin 1(6).
    """
    signs = np.sign(differences[np.argsort(np.abs(differences), kind="stable")])
    signs = signs[signs != 0]
    found = int((1 + np.flatnonzero(signs > 0)).sum())
    return float(min(_rank_sums(len(signs))[found:].sum(), 1.0))


@lru_cache(maxsize=8)  # the tests of one log have as many differences
def _rank_sums(n: int) -> Array:
    """Chance of each sum of those of the ranks 1..n that have heads of a coin, (1 + n (n + 1) / 2,)."""
    chances = np.zeros(1 + n * (n + 1) // 2)
    chances[0] = 1.0
    for rank in range(1, n + 1):
        chances[rank:] += chances[:-rank]
        chances *= 0.5
    return freeze(chances)


def dagostino_pearson(x: Array) -> tuple[float, float, float]:
    """Skewness, excess kurtosis and p-value of a normal sample, (n,); the p-value of fewer than 20 values is 1.

    Source: D'Agostino, Belanger and D'Agostino (1990), The American Statistician 44(4), equations (8) to (20).
    """
    n, deviations = len(x), x - x.mean()
    m2 = float(np.mean(deviations**2))
    if m2 <= (np.finfo(float).eps * abs(float(x.mean()))) ** 2:  # rounding of a constant
        return np.nan, np.nan, np.nan
    skewness, kurtosis = float(np.mean(deviations**3)) / m2**1.5, float(np.mean(deviations**4)) / m2**2
    if n < _FEWEST:
        return skewness, kurtosis - 3.0, 1.0
    y = skewness * np.sqrt((n + 1) * (n + 3) / (6.0 * (n - 2)))
    spread = 3 * (n**2 + 27 * n - 70) * (n + 1) * (n + 3) / ((n - 2) * (n + 5.0) * (n + 7) * (n + 9))
    w2 = np.sqrt(2 * (spread - 1)) - 1
    of_skewness = np.arcsinh(y / np.sqrt(2 / (w2 - 1))) / np.sqrt(0.5 * np.log(w2))

    mean = 3.0 * (n - 1) / (n + 1)
    variance = 24.0 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5.0))
    third = (
        6.0 * (n**2 - 5 * n + 2) / ((n + 7) * (n + 9)) * np.sqrt(6.0 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3.0)))
    )
    a = 6 + 8 / third * (2 / third + np.sqrt(1 + 4 / third**2))
    below = 1 + (kurtosis - mean) / np.sqrt(variance) * np.sqrt(2 / (a - 4))
    root = np.sign(below) * np.cbrt((1 - 2 / a) / abs(below)) if below else 0.0
    of_kurtosis = (1 - 2 / (9 * a) - root) / np.sqrt(2 / (9 * a))
    return skewness, kurtosis - 3.0, float(chi2_tail(of_skewness**2 + of_kurtosis**2, 2))
