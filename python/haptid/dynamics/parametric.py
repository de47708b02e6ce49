"""The direct model with parameters of its own at every state, as a filter for states and parameters needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device
from haptid.motion.channels import check_linear
from haptid.dynamics.forward import DirectModel, turning
from haptid.simulation.sensitivity import columns


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
        model, column = DirectModel(self.device, self.base @ beta), (c[:, None], cd[:, None])
        cdd = model.acceleration(*column, tau[:, None])
        inverse = np.linalg.inv(model.mass(column[0])[0])
        by_state = -inverse @ np.concatenate(model.slopes(*column, cdd), axis=2)[0]
        Y = columns(self.device, *column, cdd, self.base)[:, :, 0]
        return cdd[:, 0], by_state, -inverse @ Y, inverse
