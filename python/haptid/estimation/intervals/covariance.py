"""Protocols of covariance estimators, and `Spread`: covariance and degrees of freedom of parameter combinations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation.method import Fit
from haptid.uncertainty.quantities import Quantities


@dataclass(frozen=True, eq=False)
class Spread:
    """Covariance of base parameters, or of combinations of them, with degrees of freedom.

    Attributes:
        covariance: (q, q).
        dof: degrees of freedom of the Student t interval of each, (q,).
        blocks: number of blocks of rows.
        alone: indices of those excited in a single block, whose standard error cannot be estimated, (k,).
    """

    covariance: Array
    dof: Array
    blocks: int
    alone: np.ndarray

    def quantities(self, names: Sequence[str], units: Sequence[str], values: Array) -> Quantities:
        """The values (q,) of these combinations with their names, units and uncertainty."""
        return Quantities(tuple(names), tuple(units), values, self.covariance, self.dof, tuple(self.alone.tolist()))


class Intervals(Protocol):
    """A covariance estimator with degrees of freedom: a small frozen dataclass whose fields are its settings."""

    @property
    def name(self) -> str:
        """In words, as in the result file."""

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of combinations (q, p) of base parameters; of each base parameter where None."""


@runtime_checkable
class Limiting(Intervals, Protocol):
    """Intervals with unequal sides, for constrained estimates, such as `Profile`."""

    def limits(self, fit: Fit, solution: object, half: Array) -> Array:
        """Ends of the intervals, (p, 2), at the level of the unconstrained fit's half-widths, (p,)."""


def with_prior_variance(covariance: Array, dof: Array, combinations: Array, pull: Array | None) -> tuple[Array, Array]:
    """Covariance (q, q) and degrees of freedom (q,) with the variance of the prior added, as if drawn from it.

    Args:
        covariance, dof: of the combinations, from the rows.
        combinations: in coordinates in which rows and prior together are the unit matrix, (q, k).
        pull: the prior rows in these coordinates, (rows, k); None without a prior.
    """
    if pull is None:
        return covariance, dof
    total = covariance + (combinations @ pull.T) @ (combinations @ pull.T).T
    without, with_prior = np.diag(covariance), np.diag(total)
    # The prior variance is taken as known, so only the rows' part has finite degrees of freedom (Satterthwaite 1946).
    return total, dof * np.divide(with_prior, without, out=np.ones_like(with_prior), where=without > 0) ** 2
