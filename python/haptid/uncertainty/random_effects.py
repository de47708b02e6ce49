"""Random-effects regression: estimates with known standard errors, which vary by more than these from case to case."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.uncertainty.multiple_testing import se_above_rounding


@dataclass(frozen=True, eq=False)
class RandomEffects:
    """Coefficients of a regression of estimates, such as those of several logs.

    Attributes:
        values: of the columns, (c,); NaN where the cases do not determine them.
        se: standard errors, (c,); infinite there.
        dof: degrees of freedom, cases less columns.
        between: standard deviation between cases beyond that of the estimates themselves.
    """

    values: Array
    se: Array
    dof: float
    between: float

    def __post_init__(self) -> None:
        freeze_fields(self, "values", "se")


def random_effects(values: Array, se: Array, columns: Array) -> RandomEffects:
    """Regression of estimates on columns, with a variance between them.

    The variance is that of DerSimonian and Laird (1986), Controlled Clinical Trials 7(3), as a regression has it; the
    covariance of the coefficients is scaled by the weighted mean square of the residuals where that is above one (Knapp
    and Hartung 2003, Statistics in Medicine 22, eq. 7; Roever, Knapp and Friede 2015, BMC Medical Research Methodology
    15), with Student's t of n - c degrees of freedom.

    Args:
        values: the estimates, (n,).
        se: their standard errors, (n,); those with an infinite one are left out.
        columns: (n, c).
    """
    known = np.isfinite(se) & np.isfinite(values)
    y, X = values[known], columns[known]
    n, c = X.shape
    if n <= c or np.linalg.matrix_rank(X) < c:
        return RandomEffects(np.full(c, np.nan), np.full(c, np.inf), float(max(n - c, 1)), np.nan)
    s = se_above_rounding(y, se[known])
    unit = float(s.max()) or 1.0
    within = np.maximum(s / unit, np.finfo(float).tiny ** 0.25) ** 2
    w = 1.0 / within
    _, residual, inverse = _weighted(y / unit, X, w)
    excess = float(w @ residual**2) - (n - c)
    share = float(w.sum() - np.trace(inverse @ (X.T @ (w[:, None] ** 2 * X))))
    between = max(0.0, excess / share) if share > 0 else 0.0
    w = 1.0 / (within + between)
    found, residual, inverse = _weighted(y / unit, X, w)
    scale = max(1.0, float(w @ residual**2) / (n - c))
    return RandomEffects(
        found * unit, np.sqrt(scale * np.diag(inverse)) * unit, float(n - c), float(np.sqrt(between)) * unit
    )


def _weighted(y: Array, X: Array, w: Array) -> tuple[Array, Array, Array]:
    """Coefficients, residuals, and the inverse of X'WX."""
    root = np.sqrt(w)
    Q, R = np.linalg.qr(root[:, None] * X)
    found = np.linalg.solve(R, Q.T @ (root * y))
    inverse = np.linalg.inv(R)
    return found, y - X @ found, inverse @ inverse.T
