"""What a characterisation is made from: an estimate with its covariance, or published base parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.model import DynamicModel
from haptid.errors import BaseNameError
from haptid.estimation import Estimate

# Degrees of freedom of a figure are looked at in so many of its places, evenly chosen; the least counts.
LOOKED_AT = 16


@dataclass(frozen=True, eq=False)
class GivenParameters:
    """Base parameters that do not come from an estimate: published ones, or true ones.

    Attributes:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        covariance: of them, (p, p); None where nothing is known of it.
        dof: degrees of freedom of intervals that are made from the covariance.
        single_block: parameters, by index, whose deviation nothing tells: no figure made from them has an interval.
    """

    model: DynamicModel
    beta: Array
    covariance: Array | None = None
    dof: float = float("inf")
    single_block: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        p = len(self.model.base)
        object.__setattr__(self, "beta", read_only(self.beta))
        expect("beta", self.beta.shape, (p,))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", read_only(self.covariance))
            expect("covariance", self.covariance.shape, (p, p))

    @classmethod
    def of(
        cls, model: DynamicModel, values: Mapping[str, float], se: Mapping[str, float] | None = None
    ) -> GivenParameters:
        """From a table as papers print it; parameters that it does not have are zero.

        Args:
            model: the dynamic model.
            values: by name of the base parameter, SI.
            se: deviations by name, taken as independent; None where nothing is known of them.

        Raises:
            BaseNameError: a name that is no base parameter of the device.
        """
        names = model.base.names
        for name in (*values, *(se or ())):
            if name not in names:
                raise BaseNameError(name, names)
        beta = np.array([values.get(name, 0.0) for name in names])
        covariance = None if se is None else np.diag([se.get(name, 0.0) ** 2 for name in names])
        return cls(model, beta, covariance)


IdentifiedModel = Estimate | GivenParameters


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure at many places, and how far to trust it.

    Attributes:
        value: NaN where it is not known, any shape.
        se: its deviation, first order, same shape; None for parameters without covariance, infinite where one stretch
            of the log alone tells a parameter.
        dof: degrees of freedom of its intervals, the least of several places.
        unit: of the value.
    """

    value: Array
    se: Array | None
    dof: float
    unit: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", read_only(self.value))
        if self.se is not None:
            object.__setattr__(self, "sd", read_only(self.se))
            expect("sd", self.se.shape, self.value.shape)

    @cached_property
    def interval95(self) -> Array | None:
        """95 % intervals, (..., 2); None without deviations."""
        if self.se is None:
            return None
        half = stats.t.ppf(0.975, self.dof) * self.se
        return freeze(np.stack([self.value - half, self.value + half], axis=-1))


def spread(identified: IdentifiedModel) -> Array | None:
    """Columns whose outer products sum to the covariance of the base parameters, (p, s); None without one.

    Of an estimate that is held to possible bodies it is that of its free fit, as its own deviations are.
    """
    if identified.covariance is None:
        return None
    values, vectors = np.linalg.eigh(identified.covariance)
    kept = values > 0
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def trusted(identified: IdentifiedModel, se: Array) -> Array:
    """The deviations, infinite where the estimate cannot say how far to trust some parameter."""
    return np.where(np.isnan(se), np.nan, np.inf) if identified.single_block else se


def dof(identified: IdentifiedModel, combinations: Array) -> float:
    """Least degrees of freedom of these combinations of base parameters, (q, p), as the estimate's intervals have them.

    Of a given covariance they are given too.
    """
    if not isinstance(identified, Estimate):
        return identified.dof
    known = combinations[np.isfinite(combinations).all(axis=1) & combinations.any(axis=1)]
    if not len(known):
        return float("inf")
    few = known[np.linspace(0, len(known) - 1, min(len(known), LOOKED_AT)).astype(int)]
    return float(identified.spread(few).dof.min())


def linear(identified: IdentifiedModel, of: Callable[[Array], Array], unit: str) -> Figure:
    """A figure that is linear in the base parameters.

    Args:
        identified: the parameters.
        of: the figure from base parameters, (p,).
        unit: of the figure.
    """
    return changing(identified, of(identified.beta), of, unit)


def changing(identified: IdentifiedModel, value: Array, slope: Callable[[Array], Array], unit: str) -> Figure:
    """A figure of this value, whose change with a change of the base parameters, (p,), is `slope` of it."""
    columns = spread(identified)
    if columns is None:
        return Figure(value, None, float("inf"), unit)
    variance = np.zeros_like(value)
    for column in columns.T:
        variance += slope(column) ** 2
    se = trusted(identified, np.sqrt(variance))
    return Figure(value, se, _freedom_of(identified, slope, value.size), unit)


def _freedom_of(identified: IdentifiedModel, slope: Callable[[Array], Array], size: int) -> float:
    """Degrees of freedom of a figure, from some of its places."""
    if not isinstance(identified, Estimate):
        return identified.dof
    few = np.linspace(0, size - 1, min(size, LOOKED_AT)).astype(int)
    gradients = np.array([slope(unit).ravel()[few] for unit in np.eye(len(identified.beta))])
    return dof(identified, gradients.T)
