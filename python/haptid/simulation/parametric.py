"""The direct model with parameters of its own at every state, as a filter for states and parameters needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._values import Array
from haptid.device import Device
from haptid.signals import check_linear
from haptid.simulation.direct import DirectModel, turning
from haptid.simulation.sensitivity import columns

# Steps of differences by position and velocity.
STEP = 1e-6


@dataclass(frozen=True, eq=False)
class ParametricModel:
    """M cdd = tau - h by base parameters.

    Attributes:
        device: the mechanism, its dry friction smooth.
        base: the core's columns from base parameters, (r, p).

    Raises:
        AccelerationColumnError: a column is made of accelerations.
    """

    device: Device
    base: Array

    def __post_init__(self) -> None:
        check_linear(self.device)

    def acceleration(self, c: Array, cd: Array, tau: Array, beta: Array) -> Array:
        """cdd, (n, states), of parameters (p,) or (states, p).

        Args:
            c, cd: positions and velocities of the coordinates, (n, states).
            tau: torque of every row, (n, states), N m or N.
            beta: base parameters.

        Raises:
            MasslessError: a mass matrix is not positive definite.
        """
        return DirectModel(self.device, beta @ self.base.T).acceleration(c, cd, tau)

    def turning(self, c: Array, cd: Array, cdd: Array, period: float) -> bool:
        """Whether dry friction may turn over within a period, s, at one state; c, cd and cdd are (n,)."""
        return bool(turning(self.device, c[:, None], cd[:, None], cdd[:, None], period)[0])

    def linearised(self, c: Array, cd: Array, tau: Array, beta: Array) -> tuple[Array, Array, Array, Array]:
        """At one state: cdd (n,), its derivatives by (c, cd) (n, 2n) and by beta (n, p), and M^-1 (n, n).

        Args:
            c, cd, tau: (n,).
            beta: (p,).
        """
        n, model = len(c), DirectModel(self.device, self.base @ beta)
        shift = np.column_stack([np.zeros(2 * n), STEP * np.eye(2 * n), -STEP * np.eye(2 * n)])
        shifted = c[:, None] + shift[:n], cd[:, None] + shift[n:]
        cdd = model.acceleration(*shifted, np.repeat(tau[:, None], 4 * n + 1, axis=1))
        by_state = (cdd[:, 1 : 2 * n + 1] - cdd[:, 2 * n + 1 :]) / (2 * STEP)
        inverse = np.linalg.inv(model.mass(c[:, None])[0])
        Y = columns(self.device, c[:, None], cd[:, None], cdd[:, :1], self.base)[:, :, 0]
        return cdd[:, 0], by_state, -inverse @ Y, inverse
