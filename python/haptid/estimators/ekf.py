"""The extended Kalman filter for joint state and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._values import Array
from haptid.estimators.kalman import PARTS, Belief, Filtering, Track, lower
from haptid.simulation.parametric import ParametricModel


@dataclass(frozen=True)
class EKF(Filtering):
    """Extended Kalman filter: the model linear about the present estimate, in square-root form.

    A step is exact for the linear model with the torque held (exponential Rosenbrock-Euler), so that stiff friction
    needs no smaller ones. Sources: see `haptid.estimators.kalman`; Hochbruck and Ostermann (2010), Acta Numerica 19,
    eq. 2.38.
    """

    def ahead(self, model: ParametricModel, belief: Belief, track: Track, k: int) -> Belief:
        """From sample k to the next, without measurement."""
        n, x, dt = len(track.c), belief.x.copy(), track.motion.dt
        step, shaken = np.eye(len(x)), np.zeros((len(x), n))
        parts = PARTS if model.turning(x[:n], x[n : 2 * n], track.tau[:, k], x[2 * n :], dt) else 1
        for _ in range(parts):
            cdd, by_state, by_beta, inverse = model.linearised(x[:n], x[n : 2 * n], track.tau[:, k], x[2 * n :])
            F, forced = exponential(by_state, dt / parts)
            x[: 2 * n] += forced @ np.concatenate([x[n : 2 * n], cdd])
            own = np.eye(len(x))
            own[: 2 * n, : 2 * n], own[: 2 * n, 2 * n :] = F, forced[:, n:] @ by_beta
            step, shaken = own @ step, own @ shaken
            shaken[: 2 * n] += forced[:, n:] @ (inverse * track.noise[1])
        S = lower(np.column_stack([step @ belief.S, shaken]))
        return Belief(x, S)


def exponential(by_state: Array, dt: float) -> tuple[Array, Array]:
    """exp(A dt), and its integral over the step, each (2n, 2n), of A = [0 1; by_state]."""
    size = by_state.shape[1]
    wide = np.zeros((2 * size, 2 * size))
    wide[: size // 2, size // 2 : size] = np.eye(size // 2)
    wide[size // 2 : size, :size] = by_state
    wide[:size, size:] = np.eye(size)
    made = linalg.expm(wide * dt)
    return made[:size, :size], made[:size, size:]
