"""What a search lowers: criteria of a motion's quality, and smooth stand-ins for them with their derivatives.

A stand-in is a function of C = V'V, V being the rows of all motors, each entry scaled, and some columns then brought to
unit length. Its derivative is B, symmetric, with change of cost = sum of B * change of C.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid.experiment.excitation.quality import Quality

# Least eigenvalue of C beside the largest: below, it is rounding.
SINGULAR = 1e-13


@dataclass(frozen=True, eq=False)
class Scaling:
    """How rows of W become those that a criterion is made of.

    Attributes:
        factors: of every entry, by motor and parameter, (motors, k).
        unit: which columns are then brought to unit length, (k,).
    """

    factors: Array
    unit: np.ndarray


class Criterion(Protocol):
    """What a search lowers."""

    def cost(self, found: Quality) -> float:
        """Lower is better; about one for a factor of e."""

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """How the rows are scaled, from sizes of parameters, (k,), 0 where not known, and noise, (motors,)."""

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """A smooth stand-in for the cost, sharper with a larger power, and its derivative B, both by C, (k, k)."""


@dataclass(frozen=True)
class ScaledCondition:
    """The condition number of W with its columns scaled to unit length: it does not depend on units."""

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        return float(np.log(found.scaled))

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return Scaling(np.ones((len(noise), len(values))), np.ones(len(values), dtype=bool))

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """See Criterion."""
        return _condition(C, power)


@dataclass(frozen=True)
class RawCondition:
    """The condition number of W as it is (Gautier and Khalil 1992, IJRR 11(4)); it depends on units."""

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        return float(np.log(found.raw))

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return Scaling(np.ones((len(noise), len(values))), np.zeros(len(values), dtype=bool))

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """See Criterion."""
        return _condition(C, power)


@dataclass(frozen=True)
class Information:
    """The volume of the parameters' common interval: D-optimality (Swevers et al. 1997)."""

    def cost(self, found: Quality) -> float:
        """Logarithm of the mean deviation."""
        return -0.5 * found.information / len(found.names)

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return _in_units_of(values, noise)

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """The cost itself but for a constant, whatever the power: it is smooth."""
        del power
        eigenvalues, vectors = _eigen(C)
        share = -0.5 / len(C)
        return float(share * np.log(eigenvalues).sum()), share * (vectors / eigenvalues) @ vectors.T


@dataclass(frozen=True)
class LargestDeviation:
    """The largest relative deviation of all parameters that are not zero."""

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        finite = found.relative_se[np.isfinite(found.relative_se)]
        return float(np.log(finite.max())) if len(finite) else np.inf

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return _in_units_of(values, noise)

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """A norm of the variances, of high power, in place of the largest; zero-valued parameters take part."""
        eigenvalues, vectors = _eigen(C)
        covariance = (vectors / eigenvalues) @ vectors.T
        variances = np.diag(covariance)
        norm = float(np.sum((variances / variances.max()) ** power))
        weights = (variances / variances.max()) ** (power - 1) / norm / variances.max()
        return float((np.log(variances.max()) + np.log(norm) / power) / 2), -0.5 * (covariance * weights) @ covariance


def _in_units_of(values: Array, noise: Array) -> Scaling:
    known = values > 0
    return Scaling(np.where(known, values, 1.0) / noise[:, None], ~known)


def _eigen(C: Array) -> tuple[Array, Array]:
    eigenvalues, vectors = np.linalg.eigh(C)
    return np.maximum(eigenvalues, SINGULAR * eigenvalues[-1]), vectors


def _condition(C: Array, power: float) -> tuple[float, Array]:
    """Logarithm of the condition number of V, norms of high power in place of the extreme eigenvalues."""
    eigenvalues, vectors = _eigen(C)
    up, down = eigenvalues / eigenvalues[-1], eigenvalues[0] / eigenvalues
    large, small = (up**power).sum(), (down**power).sum()
    bend = (up**power / large - down**power / small) / (2 * eigenvalues)
    spread = np.log(eigenvalues[-1] / eigenvalues[0]) / 2
    return float(spread + np.log(large * small) / (2 * power)), (vectors * bend) @ vectors.T
