"""One estimated parameter, and its texts in a table."""

from __future__ import annotations

from dataclasses import field
from typing import NamedTuple, Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.uncertainty.figures import relative_se_cell, with_digits
from haptid.uncertainty.quantities import LEVEL

# What stands in place of a value that the rows do not tell.
NOT_EXCITED = "not excited"


class HasIntervals(Protocol):
    """A vector of estimates with confidence intervals."""

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals, (k, 2)."""

    @property
    def unexcited(self) -> tuple[int, ...]:
        """Indices of those that the rows leave open."""


def not_told_from_zero(values: Array, se: Array, ends: Array) -> Array:
    """Whether the rows do not tell each value from zero: its interval holds zero, or its standard error is as large.

    Args:
        values, se: (k,); an infinite standard error is as large as any value.
        ends: of the confidence intervals, (k, 2).

    Returns:
        (k,), of bool.
    """
    holds_zero = (ends[:, 0] <= 0) & (ends[:, 1] >= 0)
    return np.asarray(holds_zero | ~(se < np.abs(values)))


class ParameterCells(NamedTuple):
    """A parameter as texts of a table.

    Attributes:
        value: to two digits of the standard error; "not excited" where it means nothing.
        interval: 95 % confidence interval; "unbounded" where both ends are infinite.
        relative, classical: relative standard errors, cluster-robust and classical, per cent; empty without a value.
        prior: prior value, or empty.
    """

    value: str
    interval: str
    relative: str
    classical: str
    prior: str


@displayed
@dataclass(frozen=True)
class Parameter:
    """One estimated parameter.

    Attributes:
        name, unit, grouping: ZZ1R, kg m^2, and what regroups into it.
        value, se: and its cluster-robust standard error, SI.
        classical_se: its classical standard error, valid for white residuals.
        prior: prior value and standard deviation, or None.
        free: value of the unconstrained fit, to which `sd` belongs; `value` without constraints.
        constrained_outside_ci: whether constraints move the value outside of the interval of the unconstrained fit.
        owner, index: the estimate or targets that it is one of, and where.
    """

    name: str
    unit: str
    grouping: str
    value: float
    se: float
    classical_se: float
    prior: tuple[float, float | None] | None
    free: float
    constrained_outside_ci: bool
    owner: HasIntervals = field(repr=False, compare=False)
    index: int = field(repr=False, compare=False)

    def conf_int(self, level: float = LEVEL) -> tuple[float, float]:
        """Confidence interval, SI."""
        low, high = self.owner.conf_int(level)[self.index]
        return float(low), float(high)

    @property
    def relative_se(self) -> float:
        """Relative standard error 100 sd / |value|, per cent (Janot et al. 2007, eq. 17, with absolute value).

        NaN where `constrained_outside_ci`: the standard error then does not describe the value.
        """
        if self.constrained_outside_ci:
            return float("nan")
        return 100 * self.se / abs(self.value) if self.value else float("inf")

    @property
    def excited(self) -> bool:
        """Whether the rows tell the value; see `Estimate.unexcited`."""
        return self.index not in self.owner.unexcited

    @property
    def cells(self) -> ParameterCells:
        """Its texts in a table."""
        low, high = self.conf_int()
        interval = (
            " .. ".join(with_digits(end, self.se) for end in (low, high)) if np.isfinite(high - low) else "unbounded"
        )
        if not self.excited:
            prior = "" if self.prior is None else f"{self.prior[0]:.4g}"
            return ParameterCells(NOT_EXCITED, interval, "", "", prior)
        held = self.constrained_outside_ci
        return ParameterCells(
            f"{self.value:.4g}" if held else with_digits(self.value, self.se),
            interval,
            "" if held else relative_se_cell(self.se, self.value),
            "" if held else relative_se_cell(self.classical_se, self.value),
            "" if self.prior is None else with_digits(self.prior[0], self.se),
        )

    def _shown(self) -> Overview:
        cells = self.cells
        title = f"{self.name} = {cells.value} {self.unit}, 95 % interval {cells.interval}"
        return Overview(title, notes=(f"regroups {self.grouping}",) if self.grouping else ())
