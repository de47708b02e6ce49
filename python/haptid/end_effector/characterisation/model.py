"""Identified parameters of a characterisation: an estimate or published base parameters; propagation of uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.counterparts import parameters_on
from haptid.dynamics.model import DynamicModel
from haptid.errors import unknown_name
from haptid.estimation import Estimate
from haptid.uncertainty.quantities import Field, covariance_root

# Number of places, evenly chosen, over which the least degrees of freedom of a quantity are taken.
DOF_PLACES = 16


@dataclass(frozen=True, eq=False)
class GivenParameters:
    """Base parameters that do not come from an estimate: published or true ones.

    Attributes:
        beta: its base parameters, (p,), SI.
        covariance: of them, (p, p); None where unknown.
        dof: degrees of freedom of intervals from the covariance.
        single_block: indices of parameters whose standard error cannot be estimated; all intervals are then unbounded.
    """

    model: DynamicModel
    beta: Array
    covariance: Array | None = None
    dof: float = float("inf")
    single_block: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        p = len(self.model.base)
        freeze_fields(self, beta=(p,), covariance=(p, p))

    @classmethod
    def of(
        cls, model: DynamicModel, values: Mapping[str, float], se: Mapping[str, float] | None = None
    ) -> GivenParameters:
        """From a table as published; parameters that it does not have are zero.

        Args:
            values: by name of the base parameter, SI.
            se: standard errors by name, taken as independent; None where unknown.

        Raises:
            UnknownNameError: a name that is no base parameter of the device.
        """
        names = model.base.names
        for name in (*values, *(se or ())):
            if name not in names:
                raise unknown_name(f"the device has no base parameter {name!r}.", name, names)
        beta = np.array([values.get(name, 0.0) for name in names])
        covariance = None if se is None else np.diag([se.get(name, 0.0) ** 2 for name in names])
        return cls(model, beta, covariance)


IdentifiedModel = Estimate | GivenParameters


def on_counterpart(identified: IdentifiedModel, other: DynamicModel) -> IdentifiedModel:
    """The parameters of a counterpart of the device (`haptid.dynamics.counterparts`); as they are where it is itself.

    Degrees of freedom are the least of any parameter's.
    """
    if other is identified.model:
        return identified
    T, covariance = parameters_on(identified.model, other), identified.covariance
    least = identified.dof if isinstance(identified, GivenParameters) else float(np.min(identified.dof))
    unknown = tuple(np.flatnonzero(T[:, list(identified.single_block)].any(axis=1)).tolist())
    return GivenParameters(
        other, T @ identified.beta, None if covariance is None else T @ covariance @ T.T, least, unknown
    )


def covariance_factor(identified: IdentifiedModel) -> Array | None:
    """A square root of the base parameters' covariance: columns whose outer products sum to it, (p, s), or None.

    For an estimate with physical constraints it is that of its unconstrained fit, like its own standard errors.
    """
    if identified.covariance is None:
        return None
    return covariance_root(identified.covariance)


def trusted(identified: IdentifiedModel, se: Array) -> Array:
    """Standard errors, infinite where that of some parameter cannot be estimated."""
    return np.where(np.isnan(se), np.nan, np.inf) if identified.single_block else se


def dof(identified: IdentifiedModel, combinations: Array) -> float:
    """Least degrees of freedom of combinations of base parameters, (q, p), as for the estimate's intervals.

    For a given covariance they are given too.
    """
    if not isinstance(identified, Estimate):
        return identified.dof
    known = combinations[np.isfinite(combinations).all(axis=1) & combinations.any(axis=1)]
    if not len(known):
        return float("inf")
    few = known[np.linspace(0, len(known) - 1, min(len(known), DOF_PLACES)).astype(int)]
    return float(identified.spread(few).dof.min())


def linear(identified: IdentifiedModel, of: Callable[[Array], Array], unit: str) -> Field:
    """A quantity that is linear in the base parameters.

    Args:
        identified: the parameters.
        of: the quantity from base parameters, (p,).
        unit: of the quantity.
    """
    return changing(identified, of(identified.beta), of, unit)


def changing(identified: IdentifiedModel, value: Array, slope: Callable[[Array], Array], unit: str) -> Field:
    """A quantity with this value; `slope` is its derivative in a direction of the base parameters, (p,)."""
    columns = covariance_factor(identified)
    if columns is None:
        return Field(value, None, float("inf"), unit)
    variance = np.zeros_like(value)
    for column in columns.T:
        variance += slope(column) ** 2
    se = trusted(identified, np.sqrt(variance))
    return Field(value, se, _least_dof(identified, slope, value.size), unit)


def _least_dof(identified: IdentifiedModel, slope: Callable[[Array], Array], size: int) -> float:
    """Degrees of freedom of a quantity, from some of its places."""
    if not isinstance(identified, Estimate):
        return identified.dof
    few = np.linspace(0, size - 1, min(size, DOF_PLACES)).astype(int)
    gradients = np.array([slope(unit).ravel()[few] for unit in np.eye(len(identified.beta))])
    return dof(identified, gradients.T)
