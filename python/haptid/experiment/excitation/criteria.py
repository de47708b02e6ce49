"""Optimality criteria of an exciting motion (condition number, D-optimality, standard errors), and their gradients.

For descents every criterion has a smooth approximation, a function of C = V'V, where V is W of all motors with every
entry scaled and some columns then scaled to unit length. Its derivative is the symmetric B with dcost = sum(B * dC).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import linalg

from haptid import _core
from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import CoreChannels
from haptid.experiment.bench.trajectories import Trajectory
from haptid.motion.motion import Motion
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, assemble
from haptid.observation.plan import Plan
from haptid.observation.r_factor import condition, scaled_condition


@dataclass(frozen=True, eq=False)
class Quality:
    """Information of a motion on some base parameters: condition numbers, log det, standard errors (computed lazily).

    Attributes:
        observation: the rows of the motion.
        columns: indices of the parameters, (k,).
        values: of the parameters, (k,), SI.
        noise: standard deviation of a row of each motor, (motors,), N m or N.
    """

    observation: Observation
    columns: tuple[int, ...]
    values: Array
    noise: Array

    def __post_init__(self) -> None:
        freeze_fields(self, values=(len(self.columns),), noise=(len(self.observation.motors),))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, (k,)."""
        return tuple(self.observation.base.names[k] for k in self.columns)

    @property
    def rows(self) -> int:
        """Number of rows of all motors."""
        return self.observation.rows

    @cached_property
    def _plain(self) -> Array:
        """R factor of the rows, (p, k), SI."""
        return freeze(self.observation.stack()[:-1, list(self.columns)])

    @cached_property
    def raw(self) -> float:
        """Condition number of the parameters' columns of W, in SI units."""
        return condition(self._plain)

    @cached_property
    def scaled(self) -> float:
        """Condition number of the columns scaled to unit length."""
        return scaled_condition(self._plain)

    @cached_property
    def information(self) -> float:
        """log det of the information matrix W' W / noise^2 per row, parameters in units of their values, or of 1."""
        sized = self._weighted * np.where(self.values != 0, np.abs(self.values), 1.0)
        singular = np.maximum(linalg.svdvals(sized), np.finfo(float).tiny)
        return 2 * float(np.log(singular).sum()) - len(self.names) * float(np.log(self.rows))

    @cached_property
    def se(self) -> Array:
        """Standard error of each parameter under white noise, SI, (k,)."""
        return freeze(self._scales * standard_errors(self._sized))

    @cached_property
    def relative_se(self) -> Array:
        """Relative standard error of each parameter under white noise, per cent of its value, (k,).

        Infinite for a value of zero.
        """
        known = self.values != 0
        return freeze(100 * np.divide(self.se, np.abs(self.values), out=np.full(known.size, np.inf), where=known))

    @cached_property
    def _weighted(self) -> Array:
        """R factor of the rows in units of their noise, (p, k), parameters in SI."""
        return freeze(self.observation.stack(1.0 / self.noise)[:-1, list(self.columns)])

    @cached_property
    def _scales(self) -> Array:
        """Units of the parameters: their values; for a value of zero, one that gives its column unit length, (k,)."""
        lengths = np.maximum(np.linalg.norm(self._weighted, axis=0), np.finfo(float).tiny)
        return freeze(np.where(self.values != 0, np.abs(self.values), 1.0 / lengths))

    @property
    def _sized(self) -> Array:
        """R factor of the rows in units of their noise, parameters in their units, (p, k)."""
        return self._weighted * self._scales


def observed_motion(model: DynamicModel, trajectory: Trajectory) -> Observation:
    """The rows of W of a planned motion, as one R factor for each motor."""
    still = np.zeros((len(trajectory), sum(model.device.measured)))
    rates = (trajectory.qd, trajectory.qdd)
    motion = Motion(trajectory.dt, trajectory.q, still, Treatment(cutoff_hz=None), rates=rates)
    plan = Plan.of(model, motion)
    whole = replace(plan, block=plan.rows)
    return assemble(whole, [whole.reduce(0, whole.rows)])


# Condition number up to which that from a Gram matrix keeps eight digits: its relative error is eps times its square.
_GRAM_KEEPS = 1e4


def motion_condition(model: DynamicModel, trajectory: Trajectory) -> float:
    """Condition number of W of a planned motion, base parameters in SI units: that of `observed_motion`, without rows.

    It comes from the eigenvalues of W'W, and where it is large from the R factor.
    """
    columns, S = model.needed
    states = np.array([trajectory.q.T, trajectory.qd.T, trajectory.qdd.T])
    channels = CoreChannels.of(model, model.device.row_map @ states)
    factors = np.repeat(np.array(model.device.measured, dtype=float)[:, None], len(columns), axis=1)
    W2 = model.mechanism.inner_products(*channels.motion, channels.own, columns, factors, channels.loops)
    smallest, largest = _core.extreme_eigenvalues(W2 if len(S) == S.shape[1] else S.T @ W2 @ S)
    if smallest * _GRAM_KEEPS**2 > largest:
        return math.sqrt(largest / smallest)
    return condition(observed_motion(model, trajectory).stack()[:-1])


def quality(observation: Observation, columns: tuple[int, ...], beta: Array, noise: Array) -> Quality:
    """Quality of a motion for some base parameters, the others left out.

    Args:
        columns: indices of the parameters.
        beta: base parameters, (p,), SI.
        noise: standard deviation of a row of each motor, (motors,), N m or N.
    """
    return Quality(observation, tuple(columns), beta[list(columns)], noise)


def standard_errors(W: Array) -> Array:
    """Standard errors of the least-squares solution of rows with unit noise, (k,); infinite where W is singular."""
    R = np.linalg.qr(W, mode="r")
    if np.abs(np.diag(R)).min() <= np.finfo(float).eps * np.abs(R).max():
        return np.full(W.shape[1], np.inf)
    return np.asarray(np.linalg.norm(linalg.solve_triangular(R, np.eye(len(R))), axis=1))


# Lower bound of the eigenvalues of C relative to the largest: rounding level.
_SINGULAR = 1e-13


@dataclass(frozen=True, eq=False)
class Scaling:
    """Row and column scaling of W for a criterion.

    Attributes:
        factors: of every entry, by motor and parameter, (motors, k).
        unit: which columns are then scaled to unit length, (k,).
    """

    factors: Array
    unit: np.ndarray


class Criterion(Protocol):
    """Protocol of an optimality criterion, to be minimised."""

    def cost(self, found: Quality) -> float:
        """Logarithmic cost of a motion: lower is better."""

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """Scaling of the rows from magnitudes of parameters, (k,), 0 where not known, and noise, (motors,)."""

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """Smooth approximation of the cost, sharper with a larger power, and its derivative B by C, (k, k)."""

    def value(self, C: Array) -> float:
        """The cost that `smooth` approximates."""


class _SmoothCriterion(ABC):
    """What criteria share."""

    @abstractmethod
    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """See Criterion."""

    def value(self, C: Array) -> float:
        """See Criterion."""
        return self.smooth(C, np.inf)[0]


@dataclass(frozen=True)
class ScaledCondition(_SmoothCriterion):
    """Condition number of W with its columns scaled to unit length: independent of units."""

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        return float(np.log(found.scaled))

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return Scaling(np.ones((len(noise), len(values))), np.ones(len(values), dtype=bool))

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """Norms of high power in place of the extreme eigenvalues: the traces of C^power and C^-power."""
        if power in _SMALL_POWERS and (found := _core.smooth_condition(C, int(power))) is not None:
            return found
        eigenvalues, vectors = _eigen(C)
        up, down = eigenvalues / eigenvalues[-1], eigenvalues[0] / eigenvalues
        large, small = (up**power).sum(), (down**power).sum()
        weights = (up**power / large - down**power / small) / (2 * eigenvalues)
        log_condition = np.log(eigenvalues[-1] / eigenvalues[0]) / 2
        return float(log_condition + np.log(large * small) / (2 * power)), (vectors * weights) @ vectors.T

    def value(self, C: Array) -> float:
        """See Criterion."""
        smallest, largest = _core.extreme_eigenvalues(C)
        return -math.log(max(smallest / largest, _SINGULAR) if largest > 0 else _SINGULAR) / 2


@dataclass(frozen=True)
class RawCondition(ScaledCondition):
    """Condition number of W in SI units (Gautier and Khalil 1992, IJRR 11(4)); it depends on units."""

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        return float(np.log(found.raw))

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return Scaling(np.ones((len(noise), len(values))), np.zeros(len(values), dtype=bool))


@dataclass(frozen=True)
class Information(_SmoothCriterion):
    """D-optimality: volume of the parameters' joint confidence ellipsoid (Swevers et al. 1997)."""

    def cost(self, found: Quality) -> float:
        """Logarithm of the geometric mean standard error."""
        return -0.5 * found.information / len(found.names)

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion; the units of parameters whose values are not known do not count."""
        return replace(_in_units_of(values, noise), unit=np.zeros(len(values), dtype=bool))

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """The cost itself up to a constant, for any power: it is smooth."""
        del power
        eigenvalues, vectors = _eigen(C)
        share = -0.5 / len(C)
        return float(share * np.log(eigenvalues).sum()), share * (vectors / eigenvalues) @ vectors.T


@dataclass(frozen=True)
class AverageVariance(_SmoothCriterion):
    """A-optimality: mean squared relative standard error of all nonzero parameters."""

    def cost(self, found: Quality) -> float:
        """Logarithm of its root."""
        finite = found.relative_se[np.isfinite(found.relative_se)]
        return 0.5 * float(np.log((finite**2).mean())) if len(finite) else np.inf

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return _in_units_of(values, noise)

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """The cost itself up to a constant, for any power; zero-valued parameters are included."""
        del power
        eigenvalues, vectors = _eigen(C)
        total = float((1 / eigenvalues).sum())
        return 0.5 * float(np.log(total / len(C))), -0.5 / total * (vectors / eigenvalues**2) @ vectors.T


@dataclass(frozen=True)
class LargestDeviation(_SmoothCriterion):
    """Largest relative standard error of all nonzero parameters.

    Attributes:
        weights: factor of each parameter's, 0 for those that do not count; one for all where empty.
    """

    weights: tuple[float, ...] = ()

    def cost(self, found: Quality) -> float:
        """Its logarithm."""
        weighted = found.relative_se * self._factors(len(found.names))
        finite = weighted[np.isfinite(weighted)]
        return float(np.log(finite.max())) if len(finite) else np.inf

    def _factors(self, many: int) -> Array:
        return np.array(self.weights) if self.weights else np.ones(many)

    def scaling(self, values: Array, noise: Array) -> Scaling:
        """See Criterion."""
        return _in_units_of(values, noise)

    def smooth(self, C: Array, power: float) -> tuple[float, Array]:
        """A norm of high power of the variances in place of the largest; zero-valued parameters are included."""
        eigenvalues, vectors = _eigen(C)
        covariance, squares = (vectors / eigenvalues) @ vectors.T, self._factors(len(C)) ** 2
        variances = squares * np.diag(covariance)
        norm = float(np.sum((variances / variances.max()) ** power))
        weights = squares * (variances / variances.max()) ** (power - 1) / norm / variances.max()
        return float((np.log(variances.max()) + np.log(norm) / power) / 2), -0.5 * (covariance * weights) @ covariance


# Criteria by the names that options have.
CRITERIA: Mapping[str, Criterion] = {
    "condition": ScaledCondition(),
    "raw-condition": RawCondition(),
    "d-optimal": Information(),
    "a-optimal": AverageVariance(),
    "largest-error": LargestDeviation(),
}


def _in_units_of(values: Array, noise: Array) -> Scaling:
    known = values > 0
    return Scaling(np.where(known, values, 1.0) / noise[:, None], ~known)


# Powers of which products take less time than eigenvalues.
_SMALL_POWERS = (1, 2, 3, 4, 8)


def _eigen(C: Array) -> tuple[Array, Array]:
    eigenvalues, vectors = np.linalg.eigh(C)
    return np.maximum(eigenvalues, _SINGULAR * eigenvalues[-1]), vectors
