"""Slopes of what a search lowers: by the state at every sample, and from those by the numbers that make the motion.

A motion's rows depend on the state of their own sample only. So one sweep of the core gives the derivatives by all
positions, velocities and accelerations, whatever the number of harmonics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.regressor import STEPS, CoreChannels, moved
from haptid.experiment.excitation.criteria import Criterion, Scaling
from haptid.experiment.excitation.limits import Bounds

# How sharp the criterion's stand-in is where starts are compared.
STARTING = 4.0
# A search aims for so much within every limit, of its size, to end on the right side.
WITHIN = 0.01


@dataclass(frozen=True, eq=False)
class Slopes:
    """A criterion and limits as functions of the states of a motion.

    Attributes:
        bounds: the limits.
        criterion: what to lower.
        columns: indices of the base parameters that count, (k,).
        scaling: of their rows.
    """

    bounds: Bounds
    criterion: Criterion
    columns: tuple[int, ...]
    scaling: Scaling

    @staticmethod
    def of(bounds: Bounds, criterion: Criterion, columns: tuple[int, ...], noise: Array) -> Slopes:
        """For parameters of the sizes that the bounds know, and noise of (motors,)."""
        values = np.abs(bounds.beta[list(columns)])
        return Slopes(bounds, criterion, columns, criterion.scaling(values, noise))

    def __call__(self, states: Array, power: float, weight: float) -> tuple[float, Array]:
        """Cost and what exceeding the limits costs, and the derivative by states.

        Args:
            states: positions, velocities and accelerations of the active joints, (3, active, n).
            power: how sharp the criterion's stand-in is.
            weight: of the limits.
        """
        cost, by_state = self._criterion(states, power)
        penalty, more = self._limits(states, weight)
        return cost + penalty, by_state + more

    @cached_property
    def selection(self) -> tuple[list[int], Array]:
        """The core's columns that the parameters need, and the combinations (columns, k) that make them of these."""
        model = self.bounds.model
        kept = model.device.parameters.S[:, [model.base.independent_columns[k] for k in self.columns]]
        needed = np.flatnonzero(kept.any(axis=1))
        return needed.tolist(), freeze(np.ascontiguousarray(kept[needed]))

    @cached_property
    def _factors(self) -> Array:
        """What scales products of the core's columns, by measured torque, (motors, columns, columns).

        A column of the core is part of one parameter at most.
        """
        factors = self.scaling.factors @ self.selection[1].T
        return freeze(factors[:, :, None] * factors[:, None])

    def cost(self, states: Array, power: float = STARTING) -> float:
        """The criterion's stand-in alone."""
        _, C = self._unit(self.bounds.channels(states))
        return self.criterion.smooth(C, power)[0]

    def _unit(self, channels: CoreChannels) -> tuple[Array, Array]:
        """Lengths that columns are divided by, (k,), and C of what they are then, (k, k)."""
        model, (columns, S) = self.bounds.model, self.selection
        made = model.mechanism.inner_products(*channels.motion, channels.own, columns, channels.loops)
        C = S.T @ (made[list(model.device.measured)] * self._factors).sum(axis=0) @ S
        lengths = np.where(self.scaling.unit, np.sqrt(np.diag(C)), 1.0)
        lengths = np.maximum(lengths, np.finfo(float).tiny)
        return lengths, C / lengths / lengths[:, None]

    def _criterion(self, states: Array, power: float) -> tuple[float, Array]:
        model, (columns, S) = self.bounds.model, self.selection
        channels = self.bounds.channels(states)
        lengths, C = self._unit(channels)
        cost, B = self.criterion.smooth(C, power)
        # A column of unit length does not grow: what would change its length is taken off.
        B = (B - np.diag(np.where(self.scaling.unit, (B * C).sum(axis=1), 0.0))) / lengths / lengths[:, None]
        forms = np.zeros((model.mechanism.coordinates, len(columns), len(columns)))
        forms[list(model.device.measured)] = self._factors * (S @ B @ S.T)
        by_channel = model.mechanism.form_slopes(*channels.motion, channels.own, columns, forms, channels.loops)
        return cost, np.asarray(model.device.row_map.T @ channels.by_motion(by_channel))

    def _limits(self, states: Array, weight: float) -> tuple[float, Array]:
        """Mean squares of what exceeds the limits, and their slopes."""
        over, n, by_state = self._over(states), states.shape[2], np.zeros_like(states)
        hot = over.any(axis=0)
        if hot.any():
            there = np.ascontiguousarray(states[:, :, hot])
            by_state[:, :, hot] = self.bounds.slopes(there, 2 / n * over[:, hot])
        flat, by_position = self._flatness(states)
        by_state[0] += by_position
        return weight * (float((over**2).sum()) / n + flat), weight * by_state

    def _flatness(self, states: Array) -> tuple[float, Array]:
        """The same of flat loops alone, by positions, (active, n): differences where it is not zero."""
        flat, n, by_position = self._flat(states), states.shape[2], np.zeros_like(states[0])
        hot = flat > 0
        there, here = states[:, :, hot], flat[hot]
        for j in range(len(by_position) if hot.any() else 0):
            by_position[j, hot] = 2 / n * here * (self._flat(moved(there, 0, j, STEPS[0])) - here) / STEPS[0]
        return float((flat**2).sum()) / n, by_position

    def _over(self, states: Array) -> Array:
        """What exceeds each limit less a margin, (limits, n)."""
        return np.maximum(np.array([excess for excess, _ in self.bounds.by_sample(states)]) + WITHIN, 0.0)

    def _flat(self, states: Array) -> Array:
        """The same of flat loops, (n,)."""
        return np.maximum(self.bounds.flatness(states[0]) + WITHIN, 0.0)
