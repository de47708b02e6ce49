"""What a search lowers: criteria of a motion's quality, and smooth stand-ins for them with their derivatives.

A stand-in is a function of C = V'V, V being the rows of all motors, each entry scaled, and some columns then brought to
unit length. Its derivative is B, symmetric, with change of cost = sum of B * change of C.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.trajectories import Trajectory
from haptid.motion.treatment import Motion, Treatment
from haptid.observation.observation import Observation, Plan, assemble, condition, scaled_condition


@dataclass(frozen=True, eq=False)
class Quality:
    """What a motion tells of some base parameters. A search asks each motion for one figure: none is made unasked.

    Attributes:
        observation: the rows of the motion.
        columns: indices of the parameters, (k,).
        values: of the parameters, (k,), SI.
        noise: deviation of a row of each motor, (motors,), N m or N.
    """

    observation: Observation
    columns: tuple[int, ...]
    values: Array
    noise: Array

    def __post_init__(self) -> None:
        for name, length in (("values", len(self.columns)), ("noise", len(self.observation.motors))):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, (length,))

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters, (k,)."""
        return tuple(self.observation.base.names[k] for k in self.columns)

    @property
    def rows(self) -> int:
        """Of all motors."""
        return self.observation.rows

    @cached_property
    def _plain(self) -> Array:
        """Triangle of the rows, (p, k), SI."""
        return freeze(self.observation.stack()[:-1, list(self.columns)])

    @cached_property
    def raw(self) -> float:
        """Condition number of the parameters' columns of W, as they are."""
        return condition(self._plain)

    @cached_property
    def scaled(self) -> float:
        """Condition number of the same columns, scaled to unit length."""
        return scaled_condition(self._plain)

    @cached_property
    def information(self) -> float:
        """log det of the information W' W / noise^2 per row, parameters in units of their values."""
        singular = np.maximum(linalg.svdvals(self._sized), np.finfo(float).tiny)
        return 2 * float(np.log(singular).sum()) - len(self.names) * float(np.log(self.rows))

    @cached_property
    def relative_sd(self) -> Array:
        """Deviation of each, white noise of the given deviation on every row, per cent of its value, (k,).

        Infinite for a value of zero.
        """
        return freeze(np.where(self.values != 0, 100 * deviations(self._sized), np.inf))

    @cached_property
    def _sized(self) -> Array:
        """Triangle of the rows in units of their noise, (p, k), parameters in units of their values.

        Columns of zero parameters have unit length.
        """
        weighted = self.observation.stack(1.0 / self.noise)[:-1, list(self.columns)]
        lengths = np.maximum(np.linalg.norm(weighted, axis=0), np.finfo(float).tiny)
        return weighted * np.where(self.values != 0, np.abs(self.values), 1.0 / lengths)


def observed(model: DynamicModel, trajectory: Trajectory) -> Observation:
    """The rows of W that a planned motion would give, as one triangle for each motor."""
    still = np.zeros((len(trajectory), sum(model.device.measured)))
    rates = (trajectory.qd, trajectory.qdd)
    motion = Motion(trajectory.dt, trajectory.q, still, Treatment(cutoff_hz=None), rates=rates)
    plan = Plan.of(model, motion)
    whole = replace(plan, block=plan.rows)
    return assemble(whole, [whole.reduce(0, whole.rows)])


def quality(observation: Observation, columns: tuple[int, ...], beta: Array, noise: Array) -> Quality:
    """What the rows of a motion tell of some base parameters, the others left out.

    Args:
        observation: the rows.
        columns: indices of the parameters.
        beta: base parameters, (p,), SI.
        noise: deviation of a row of each motor, (motors,), N m or N.
    """
    return Quality(observation, tuple(columns), beta[list(columns)], noise)


def deviations(W: Array) -> Array:
    """Of the least-squares solution of rows with unit noise, (k,); infinite where W is singular."""
    R = np.linalg.qr(W, mode="r")
    if np.abs(np.diag(R)).min() <= np.finfo(float).eps * np.abs(R).max():
        return np.full(W.shape[1], np.inf)
    return np.asarray(np.linalg.norm(linalg.solve_triangular(R, np.eye(len(R))), axis=1))


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
        finite = found.relative_sd[np.isfinite(found.relative_sd)]
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
