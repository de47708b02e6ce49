"""The extended Kalman filter for joint state and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._values import Array
from haptid.estimators.kalman import Belief, Filtering, Track, lower
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
        n = len(track.c)
        c, cd, beta = belief.x[:n], belief.x[n : 2 * n], belief.x[2 * n :]
        cdd, by_state, by_beta, inverse = model.linearised(c, cd, track.tau[:, k], beta)
        F, forced = exponential(by_state, track.motion.dt)
        x = belief.x.copy()
        x[: 2 * n] += forced @ np.concatenate([cd, cdd])
        step = np.eye(len(x))
        step[: 2 * n, : 2 * n], step[: 2 * n, 2 * n :] = F, forced[:, n:] @ by_beta
        shaken = np.zeros((len(x), n))
        shaken[: 2 * n] = forced[:, n:] @ (inverse * track.noise[1])
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
