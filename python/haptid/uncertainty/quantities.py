"""Numbers with uncertainty: values, standard errors, degrees of freedom and Student t confidence intervals.

Every result that has intervals holds one of the two values here: `Quantities` for named scalars with a joint covariance
(parameters, targets, drive gains, payloads), `Field` for one quantity at many places (apparent mass over poses, a force
over time). The quantile of Student's t times a standard error is computed in `half_width` and nowhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.uncertainty.distributions import t_quantile
from haptid.uncertainty.figures import with_digits

LEVEL = 0.95


def half_width(se: ArrayLike, dof: ArrayLike, level: float = LEVEL) -> Array:
    """Half-width of a two-sided Student t confidence interval: t((1 + level) / 2, dof) se, in the unit of `se`.

    Args:
        se: standard errors, any shape; infinite where they cannot be estimated.
        dof: degrees of freedom, broadcast against `se`; infinite for the normal distribution.
        level: confidence level, between 0 and 1.
    """
    return np.asarray(t_quantile((1 + level) / 2, dof) * np.asarray(se, dtype=float))


@displayed
@dataclass(frozen=True, eq=False)
class Quantities:
    """Named estimates with their joint covariance.

    Attributes:
        names: (k,).
        units: (k,).
        values: (k,), SI.
        covariance: of the errors, (k, k).
        dof: degrees of freedom of each interval, (k,).
        unbounded: indices of those whose standard error cannot be estimated: it counts as infinite.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    dof: Array
    unbounded: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        k = len(self.names)
        object.__setattr__(self, "dof", np.broadcast_to(np.asarray(self.dof, dtype=float), (k,)))
        freeze_fields(self, values=(k,), covariance=(k, k), dof=(k,))

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def se(self) -> Array:
        """Standard errors, (k,); infinite where they cannot be estimated."""
        se = np.sqrt(np.diag(self.covariance))
        se[list(self.unbounded)] = np.inf
        return freeze(se)

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals, (k, 2)."""
        half = half_width(self.se, self.dof, level)
        return freeze(np.column_stack([self.values - half, self.values + half]))

    @cached_property
    def correlation(self) -> Array:
        """Correlations of the errors, (k, k); see `correlations`."""
        return correlations(self.covariance)

    def linear(self, names: Sequence[str], units: Sequence[str], C: Array, dof: ArrayLike) -> Quantities:
        """Linear combinations C values, (q, k), with covariance C V C'.

        Args:
            names, units: of the combinations, (q,).
            C: factors, (q, k).
            dof: degrees of freedom of each combination's interval, (q,).
        """
        values, covariance = C @ self.values, C @ self.covariance @ C.T
        return Quantities(tuple(names), tuple(units), values, covariance, np.asarray(dof, dtype=float))

    def pick(self, indices: Sequence[int]) -> Quantities:
        """Some of them, by index."""
        return replace(
            self,
            names=tuple(self.names[k] for k in indices),
            units=tuple(self.units[k] for k in indices),
            values=self.values[list(indices)],
            covariance=self.covariance[np.ix_(indices, indices)],
            dof=self.dof[list(indices)],
            unbounded=tuple(list(indices).index(k) for k in self.unbounded if k in indices),
        )

    def table(self, level: float = LEVEL) -> str:
        """A text table: value, standard error, confidence interval, unit."""
        rows = [["", "value", "std err", f"{100 * level:g} % interval", "unit"]]
        for name, unit, value, se, (low, high) in zip(
            self.names, self.units, self.values, self.se, self.conf_int(level), strict=True
        ):
            rows.append([name, f"{value:.4g}", f"{se:.2g}", f"{low:.4g} .. {high:.4g}", unit])
        return "\n".join(aligned(rows))

    def to_json(self, level: float = LEVEL) -> list[dict[str, Any]]:
        """One object per quantity: name, unit, value, se, dof, conf_int; null where a number is not finite."""
        return [
            {
                "name": name,
                "unit": unit,
                "value": finite_or_none(value),
                "se": finite_or_none(se),
                "dof": finite_or_none(dof),
                "conf_int": [finite_or_none(low), finite_or_none(high)],
            }
            for name, unit, value, se, dof, (low, high) in zip(
                self.names, self.units, self.values, self.se, self.dof, self.conf_int(level), strict=True
            )
        ]

    def _shown(self) -> Overview:
        intervals = self.conf_int()
        rows = [
            [name, with_digits(value, se), " .. ".join(with_digits(end, se) for end in ends), unit]
            for name, value, se, ends, unit in zip(
                self.names, self.values.tolist(), self.se.tolist(), intervals.tolist(), self.units, strict=True
            )
        ]
        return Overview(f"{len(self)} quantities", ("", "value", "95 % interval", "unit"), rows)


@dataclass(frozen=True, eq=False)
class Field:
    """One quantity at many places, with first-order standard errors.

    Attributes:
        values: NaN where it is not known, any shape.
        se: standard errors, same shape; None where the parameters have no covariance, infinite where they cannot be
            estimated.
        dof: degrees of freedom of its intervals, the least over the places.
        unit: of the values.
    """

    values: Array
    se: Array | None
    dof: float
    unit: str

    def __post_init__(self) -> None:
        freeze_fields(self, "values", se=np.shape(self.values))

    def conf_int(self, level: float = LEVEL) -> Array | None:
        """Confidence intervals, (..., 2); None without standard errors."""
        if self.se is None:
            return None
        half = half_width(self.se, self.dof, level)
        return freeze(np.stack([self.values - half, self.values + half], axis=-1))


def correlations(covariance: Array) -> Array:
    """Correlations from a covariance, (k, k): 1 on the diagonal, NaN next to a zero variance."""
    se = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.clip(covariance / np.outer(se, se), -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    return freeze(correlation)


def covariance_root(covariance: Array) -> Array:
    """Columns whose outer products sum to a covariance, (k, s); directions of no variance are left out."""
    values, vectors = np.linalg.eigh(covariance)
    positive = values > 0
    return np.asarray(vectors[:, positive] * np.sqrt(values[positive]))


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines of a table, the first column flush left and the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]
        lines.append("  ".join(cells).rstrip())
    return lines


def finite_or_none(value: float) -> float | None:
    """The number, or None (JSON null) where it is not finite."""
    return float(value) if np.isfinite(value) else None
