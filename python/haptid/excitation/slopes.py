"""Slopes of what a search lowers: by the state at every sample, and from those by the numbers that make the motion.

A motion's rows depend on the state of their own sample only. So one sweep of the core gives the derivatives by all
positions, velocities and accelerations, whatever the number of harmonics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._values import Array, freeze
from haptid.excitation.criteria import Criterion, Scaling
from haptid.excitation.limits import Bounds
from haptid.signals import external

# How sharp the criterion's stand-in is where starts are compared.
STARTING = 4.0
# Steps of the differences by position, velocity and acceleration.
STEPS = (1e-6, 1e-5, 1e-4)
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
        device = self.bounds.device
        kept = device.parameters.S[:, [device.base.kept[k] for k in self.columns]]
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
        _, C = self._unit(self._channels(states))
        return self.criterion.smooth(C, power)[0]

    def _channels(self, states: Array) -> list[Array]:
        """What the core makes rows of, (channels, n) each: the coordinates' motion, a device's own columns, and loops."""
        device = self.bounds.device
        c, cd, cdd = (np.ascontiguousarray(device.frame @ x) for x in states)
        loops = device.loops(c, cd)
        return [c, cd, cdd, external(device, c, cd, cdd), np.zeros((0, c.shape[1])) if loops is None else loops]

    def _unit(self, channels: list[Array]) -> tuple[Array, Array]:
        """Lengths that columns are divided by, (k,), and C of what they are then, (k, k)."""
        *motion, loops = channels
        made = self.bounds.device.mechanism.inner_products(*motion, self.selection[0], loops)
        measured, S = list(self.bounds.device.measured), self.selection[1]
        C = S.T @ (made[measured] * self._factors).sum(axis=0) @ S
        lengths = np.where(self.scaling.unit, np.sqrt(np.diag(C)), 1.0)
        lengths = np.maximum(lengths, np.finfo(float).tiny)
        return lengths, C / lengths / lengths[:, None]

    def _criterion(self, states: Array, power: float) -> tuple[float, Array]:
        channels = self._channels(states)
        lengths, C = self._unit(channels)
        cost, B = self.criterion.smooth(C, power)
        # A column of unit length does not grow: what would change its length is taken off.
        B = (B - np.diag(np.where(self.scaling.unit, (B * C).sum(axis=1), 0.0))) / lengths / lengths[:, None]
        device, (columns, S) = self.bounds.device, self.selection
        forms = np.zeros((device.mechanism.coordinates, len(columns), len(columns)))
        forms[list(device.measured)] = self._factors * (S @ B @ S.T)
        *motion, loops = channels
        by_channel = device.mechanism.form_slopes(*motion, columns, forms, loops)
        return cost, self._by_state(states, channels, by_channel)

    def _by_state(self, states: Array, channels: list[Array], by_channel: Array) -> Array:
        """Slopes by states from those by channels: exact, but for the channels that Python makes, by differences."""
        device, own = self.bounds.device, np.concatenate(channels[3:])
        by_motion, by_own = np.split(by_channel, [len(by_channel) - len(own)])
        by_state = np.asarray(device.frame.T @ by_motion.reshape(states.shape))
        for s, step in enumerate(STEPS if len(own) else ()):
            for j in range(states.shape[1]):
                moved = np.concatenate(self._channels(_moved(states, s, j, step))[3:])
                by_state[s, j] += (by_own * (moved - own)).sum(axis=0) / step
        return by_state

    def _limits(self, states: Array, weight: float) -> tuple[float, Array]:
        """Mean squares of what exceeds the limits, and their slopes."""
        cost, by_state = self._squares(states, self._over, len(STEPS))
        flat, by_position = self._squares(states, self._flat, 1)
        return weight * (cost + flat), weight * (by_state + by_position)

    def _squares(self, states: Array, over: Callable[[Array], Array], kinds: int) -> tuple[float, Array]:
        """Of one function of the first kinds of states, (limits, n); differences where it is not zero."""
        values, by_state, n = over(states), np.zeros_like(states), states.shape[2]
        hot = values.any(axis=0)
        there, here = states[:, :, hot], values[:, hot]
        for s, step in enumerate(STEPS[:kinds]):
            for j in range(states.shape[1] if hot.any() else 0):
                slope = (over(_moved(there, s, j, step)) - here) / step
                by_state[s, j, hot] = 2 / n * (here * slope).sum(axis=0)
        return float((values**2).sum()) / n, by_state

    def _over(self, states: Array) -> Array:
        """What exceeds each limit less a margin, (limits, n)."""
        return np.array([np.maximum(excess + WITHIN, 0.0) for excess, _ in self.bounds.by_sample(states)])

    def _flat(self, states: Array) -> Array:
        """The same of flat loops, (1, n)."""
        return np.maximum(self.bounds.flatness(states[0])[None] + WITHIN, 0.0)


def _moved(states: Array, s: int, j: int, step: float) -> Array:
    made = states.copy()
    made[s, j] += step
    return made
