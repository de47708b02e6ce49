"""Signals from which candidate columns are computed: the motion, and the torque of the estimate along it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.inverse import core_torque
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.observation.plan import Plan


@dataclass(frozen=True, eq=False)
class ResidualContext:
    """A range of samples of a motion.

    Attributes:
        plan: of the rows.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        low, high: first sample, and one past the last.
    """

    plan: Plan
    chi: Array
    low: int
    high: int

    @property
    def model(self) -> DynamicModel:
        """The dynamic model of the estimate."""
        return self.plan.model

    @cached_property
    def motion(self) -> tuple[Array, Array, Array | None]:
        """Position, velocity, and acceleration where rows have one, each (coordinates, samples), SI."""
        c, cd, cdd, _ = self.plan.signals(self.low, self.high)
        return c, cd, cdd

    @cached_property
    def predicted(self) -> Array:
        """Torque of the estimate, (coordinates, samples), N m or N."""
        return freeze(self.torque(self.chi))

    def torque(self, chi: Array) -> Array:
        """Torque of given parameters of the core's columns, (coordinates, samples), N m or N; static without cdd."""
        c, cd, cdd = self.motion
        return torque_of(self.model, chi, c, cd, np.zeros_like(c) if cdd is None else cdd)


def torque_of(model: DynamicModel, chi: Array, c: Array, cd: Array, cdd: Array) -> Array:
    """Torque of the core's columns and of those that Python computes, (coordinates, samples), N m or N."""
    return core_torque(model, chi, c, cd, cdd, external(model, c, cd, cdd))
