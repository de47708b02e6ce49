"""The direct model with parameters of its own at every state, as a filter for states and parameters needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics, turning
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import check_linear, columns


@dataclass(frozen=True, eq=False)
class ParametricForwardDynamics:
    """M cdd = tau - h by base parameters.

    Attributes:
        model: the dynamic model, its dry friction smooth.
        base: the core's columns from base parameters, (r, p).

    Raises:
        AccelerationColumnError: a column is made of accelerations.
    """

    model: DynamicModel
    base: Array

    def __post_init__(self) -> None:
        check_linear(self.model)

    def acceleration(self, c: Array, cd: Array, tau: Array, beta: Array) -> Array:
        """cdd, (n, states), of parameters (p,) or (states, p).

        Args:
            c, cd: positions and velocities of the coordinates, (n, states).
            tau: torque of every row, (n, states), N m or N.
            beta: base parameters.

        Raises:
            MasslessError: a mass matrix is not positive definite.
        """
        return ForwardDynamics(self.model, beta @ self.base.T).acceleration(c, cd, tau)

    def turning(self, c: Array, cd: Array, cdd: Array, period: float) -> bool:
        """Whether dry friction may turn over within a period, s, at one state; c, cd and cdd are (n,)."""
        return bool(turning(self.model, c[:, None], cd[:, None], cdd[:, None], period)[0])

    def linearised(self, c: Array, cd: Array, tau: Array, beta: Array) -> tuple[Array, Array, Array, Array]:
        """At one state: cdd (n,), its derivatives by (c, cd) (n, 2n) and by beta (n, p), and M^-1 (n, n).

        Args:
            c, cd, tau: (n,).
            beta: (p,).
        """
        forward, column = ForwardDynamics(self.model, self.base @ beta), (c[:, None], cd[:, None])
        cdd = forward.acceleration(*column, tau[:, None])
        inverse = np.linalg.inv(forward.mass(column[0])[0])
        by_state = -inverse @ np.concatenate(forward.slopes(*column, cdd), axis=2)[0]
        Y = columns(self.model, *column, cdd, self.base)[:, :, 0]
        return cdd[:, 0], by_state, -inverse @ Y, inverse
