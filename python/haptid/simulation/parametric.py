"""The direct model with parameters of its own at every state, as a filter for states and parameters needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._values import Array
from haptid.device import Device
from haptid.errors import MasslessError
from haptid.signals import check_linear
from haptid.simulation.direct import INVERTIBLE, turning
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

    def parts(self, c: Array, cd: Array) -> tuple[Array, Array]:
        """Columns of M and of h: (states, n, n, p), its second axis that of the acceleration, and (states, n, p).

        Args:
            c, cd: positions and velocities of the coordinates, (n, states).
        """
        n, states = c.shape
        unit = np.repeat(np.eye(n, n + 1), states, axis=1)
        made = columns(self.device, np.tile(c, n + 1), np.tile(cd, n + 1), unit, self.base)
        made = made.reshape(n, -1, n + 1, states).transpose(3, 2, 0, 1)
        return made[:, :n] - made[:, n:], made[:, n]

    def acceleration(self, c: Array, cd: Array, tau: Array, beta: Array) -> Array:
        """cdd, (n, states), of parameters (p,) or (states, p).

        Raises:
            MasslessError: a mass matrix cannot be inverted.
        """
        by_M, by_h = self.parts(c, cd)
        beta = np.broadcast_to(beta, (len(by_h), by_h.shape[2]))
        M = np.einsum("sanp,sp->sna", by_M, beta)
        return self._solved(M, tau.T - np.einsum("snp,sp->sn", by_h, beta)).T

    def _solved(self, M: Array, force: Array) -> Array:
        """M^-1 force, (states, n)."""
        try:
            return np.asarray(np.linalg.solve(M, force[:, :, None])[:, :, 0])
        except np.linalg.LinAlgError:
            raise MasslessError(self.device.row_labels[0], 0.0, INVERTIBLE) from None

    def turning(self, c: Array, cd: Array, tau: Array, beta: Array, period: float) -> bool:
        """Whether dry friction may turn over within a period, s, at one state; c, cd and tau are (n,), beta (p,)."""
        column, speed = c[:, None], cd[:, None]
        cdd = self.acceleration(column, speed, tau[:, None], beta)
        return bool(turning(self.device, column, speed, cdd, period)[0])

    def linearised(self, c: Array, cd: Array, tau: Array, beta: Array) -> tuple[Array, Array, Array, Array]:
        """At one state: cdd (n,), its derivatives by (c, cd) (n, 2n) and by beta (n, p), and M^-1 (n, n).

        Args:
            c, cd, tau: (n,).
            beta: (p,).
        """
        n = len(c)
        shift = np.column_stack([np.zeros(2 * n), STEP * np.eye(2 * n), -STEP * np.eye(2 * n)])
        by_M, by_h = self.parts(c[:, None] + shift[:n], cd[:, None] + shift[n:])
        M = np.einsum("sanp,p->sna", by_M, beta)
        cdd = self._solved(M, tau - by_h @ beta)
        by_state = (cdd[1 : 2 * n + 1] - cdd[2 * n + 1 :]).T / (2 * STEP)
        inverse = np.linalg.inv(M[0])
        Y = np.einsum("anp,a->np", by_M[0], cdd[0]) + by_h[0]
        return cdd[0], by_state, -inverse @ Y, inverse
