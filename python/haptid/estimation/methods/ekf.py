"""The extended Kalman filter for joint state and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ParametricForwardDynamics
from haptid.estimation.methods.kalman import PARTS, Belief, Filtering, Track, lower


@dataclass(frozen=True)
class EKF(Filtering):
    """Extended Kalman filter: the model linear about the present estimate, in square-root form.

    A step is exact for the linear model with the torque held (exponential Rosenbrock-Euler), so that stiff friction
    needs no smaller ones. Sources: see `haptid.estimation.methods.kalman`; Hochbruck and Ostermann (2010), Acta Numerica 19,
    eq. 2.38.
    """

    def ahead(self, forward: ParametricForwardDynamics, belief: Belief, track: Track, k: int) -> Belief:
        """From sample k to the next, without measurement."""
        n, x, dt = len(track.c), belief.x.copy(), track.motion.dt
        linear = forward.linearised(x[:n], x[n : 2 * n], track.tau[:, k], x[2 * n :])
        parts = PARTS if forward.turning(x[:n], x[n : 2 * n], linear[0], dt) else 1
        by_start, by_beta, shaken = np.eye(2 * n), np.zeros((2 * n, len(x) - 2 * n)), np.zeros((2 * n, n))
        for part in range(parts):
            if part > 0:
                linear = forward.linearised(x[:n], x[n : 2 * n], track.tau[:, k], x[2 * n :])
            cdd, by_state, slope, inverse = linear
            F, forced = exponential(by_state, dt / parts)
            x[: 2 * n] += forced @ np.concatenate([x[n : 2 * n], cdd])
            by_start, by_beta = F @ by_start, F @ by_beta + forced[:, n:] @ slope
            shaken = F @ shaken + forced[:, n:] @ (inverse * track.noise[1])
        root = np.zeros((len(x), len(x) + n))
        root[: 2 * n, :-n] = by_start @ belief.S[: 2 * n] + by_beta @ belief.S[2 * n :]
        root[: 2 * n, -n:], root[2 * n :, :-n] = shaken, belief.S[2 * n :]
        return Belief(x, lower(root))


def exponential(by_state: Array, dt: float) -> tuple[Array, Array]:
    """exp(A dt), and its integral over the step, each (2n, 2n), of A = [0 1; by_state]."""
    size = by_state.shape[1]
    wide = np.zeros((2 * size, 2 * size))
    wide[: size // 2, size // 2 : size] = np.eye(size // 2)
    wide[size // 2 : size, :size] = by_state
    wide[:size, size:] = np.eye(size)
    made = linalg.expm(wide * dt)
    return made[:size, :size], made[:size, size:]
