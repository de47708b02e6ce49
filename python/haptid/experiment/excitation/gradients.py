"""Gradient of criterion and limit penalties with respect to the state at every sample.

Rows depend on the state of their own sample only, so one adjoint sweep of the core gives the derivatives with respect
to all positions, velocities and accelerations, whatever the number of harmonics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.dynamics.regressor import DIFFERENCE_STEPS, CoreChannels, moved
from haptid.experiment.excitation.criteria import Criterion, Scaling
from haptid.experiment.excitation.limits import MotionBounds

# Power of the smooth criterion when starting points are compared.
STARTING = 4.0
# Safety margin to every limit, relative to its size, so that the search ends on the feasible side.
WITHIN = 0.01


@dataclass(frozen=True, eq=False)
class Gradients:
    """Criterion and limit penalties as differentiable functions of the states of a motion.

    Attributes:
        bounds: the limits.
        criterion: to be minimised.
        columns: indices of the base parameters in the criterion, (k,).
        scaling: of their rows.
    """

    bounds: MotionBounds
    criterion: Criterion
    columns: tuple[int, ...]
    scaling: Scaling

    @staticmethod
    def of(bounds: MotionBounds, criterion: Criterion, columns: tuple[int, ...], noise: Array) -> Gradients:
        """For base parameters `bounds.beta` and noise, (motors,)."""
        values = np.abs(bounds.beta[list(columns)])
        return Gradients(bounds, criterion, columns, criterion.scaling(values, noise))

    def __call__(self, states: Array, power: float, weight: float) -> tuple[float, Array]:
        """Cost plus limit penalties, and the gradient by states, (3, active, n).

        Args:
            states: positions, velocities and accelerations of the active joints, (3, active, n).
            power: of the smooth criterion.
            weight: of the penalties.
        """
        cost, by_state = self._criterion(states, power)
        penalty, more = self._limits(states, weight)
        return cost + penalty, by_state + more

    @cached_property
    def selection(self) -> tuple[list[int], Array]:
        """Core columns that the parameters need, and the map (columns, k) from parameters to them."""
        model = self.bounds.model
        kept = model.device.parameters.S[:, [model.base.independent_columns[k] for k in self.columns]]
        needed = np.flatnonzero(kept.any(axis=1))
        return needed.tolist(), freeze(np.ascontiguousarray(kept[needed]))

    @cached_property
    def _factors(self) -> Array:
        """Scale factors of products of core columns, by measured torque, (motors, columns, columns).

        Every core column belongs to at most one parameter.
        """
        factors = self.scaling.factors @ self.selection[1].T
        return freeze(factors[:, :, None] * factors[:, None])

    def cost(self, states: Array, power: float = STARTING) -> float:
        """The smooth criterion without penalties."""
        _, C = self._unit(self.bounds.channels(states))
        return self.criterion.smooth(C, power)[0]

    def _unit(self, channels: CoreChannels) -> tuple[Array, Array]:
        """Column lengths that are divided out, (k,), and C of the scaled columns, (k, k)."""
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
        # The length of a unit column is constant: the derivative along it is projected out.
        B = (B - np.diag(np.where(self.scaling.unit, (B * C).sum(axis=1), 0.0))) / lengths / lengths[:, None]
        forms = np.zeros((model.mechanism.coordinates, len(columns), len(columns)))
        forms[list(model.device.measured)] = self._factors * (S @ B @ S.T)
        by_channel = model.mechanism.form_slopes(*channels.motion, channels.own, columns, forms, channels.loops)
        return cost, np.asarray(model.device.row_map.T @ channels.by_motion(by_channel))

    def _limits(self, states: Array, weight: float) -> tuple[float, Array]:
        """Mean squared violations of the limits, and their gradient."""
        violations = np.array([excess for excess, _ in self.bounds.by_sample(states)])
        over, n, by_state = np.maximum(violations + WITHIN, 0.0), states.shape[2], np.zeros_like(states)
        violated = over.any(axis=0)
        if violated.any():
            there = np.ascontiguousarray(states[:, :, violated])
            by_state[:, :, violated] = self.bounds.gradients(there, 2 / n * over[:, violated])
        flat, by_position = self._flatness(states)
        by_state[0] += by_position
        return weight * (float((over**2).sum()) / n + flat), weight * by_state

    def _flatness(self, states: Array) -> tuple[float, Array]:
        """The same for flat loops, by positions, (active, n): finite differences where it is not zero."""
        flat, n, by_position = self._flat(states), states.shape[2], np.zeros_like(states[0])
        violated = flat > 0
        there, here = states[:, :, violated], flat[violated]
        for j in range(len(by_position) if violated.any() else 0):
            by_position[j, violated] = (
                2 / n * here * (self._flat(moved(there, 0, j, DIFFERENCE_STEPS[0])) - here) / DIFFERENCE_STEPS[0]
            )
        return float((flat**2).sum()) / n, by_position

    def _flat(self, states: Array) -> Array:
        """Violation of the least distance from flat loops, with the margin, (n,)."""
        return np.maximum(self.bounds.flatness(states[0]) + WITHIN, 0.0)
