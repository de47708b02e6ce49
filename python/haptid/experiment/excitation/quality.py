"""How well a motion excites a device's parameters, before anything moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.trajectories import Trajectory
from haptid.motion.treatment import Motion, Treatment
from haptid.observation.observation import Observation, assemble
from haptid.observation.plan import Plan
from haptid.observation.r_factor import condition, scaled_condition


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
    def relative_se(self) -> Array:
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
