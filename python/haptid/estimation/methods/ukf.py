"""The unscented Kalman filter for joint state and parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ParametricForwardDynamics
from haptid.estimation.methods.kalman import PARTS, Belief, Filtering, Track, lower


@dataclass(frozen=True)
class UKF(Filtering):
    """Unscented Kalman filter: 2 (2n + p) points around the present estimate go through the model, no derivatives.

    Points at plus and minus sqrt(2n + p) deviations, all of one weight (the cubature rule), so that the square root of
    the covariance is a QR of the points. Sources: Julier and Uhlmann (2004), Proc. IEEE 92(3); Arasaratnam and Haykin
    (2009), IEEE Trans. Automatic Control 54(6), section VI.

    Attributes:
        parts: of a sampling period, each a step of Runge and Kutta's method; more where dry friction turns over.
    """

    parts: int = 1

    def ahead(self, forward: ParametricForwardDynamics, belief: Belief, track: Track, k: int) -> Belief:
        """From sample k to the next, without measurement."""
        n, size, tau = len(track.c), len(belief.x), track.tau[:, k]
        points = belief.x[:, None] + np.sqrt(size) * np.column_stack([belief.S, -belief.S])
        dt, mean = track.motion.dt, belief.x
        cdd, *_, inverse = forward.linearised(mean[:n], mean[n : 2 * n], tau, mean[2 * n :])
        parts = self.parts * (PARTS if forward.turning(mean[:n], mean[n : 2 * n], cdd, dt) else 1)
        for _ in range(parts):
            points[: 2 * n] = _step(forward, points[:n], points[n : 2 * n], tau, points[2 * n :].T, dt / parts)
        x = points.mean(axis=1)
        shaken = np.zeros((size, n))
        push = inverse * track.noise[1]
        shaken[:n], shaken[n : 2 * n] = 0.5 * dt**2 * push, dt * push
        apart = (points - x[:, None]) / np.sqrt(2 * size)
        return Belief(x, lower(np.column_stack([apart, shaken])))


def _step(forward: ParametricForwardDynamics, c: Array, cd: Array, tau: Array, beta: Array, h: float) -> Array:
    """One step of Runge and Kutta's method of order four, (2n, points), torque held."""
    held = np.repeat(tau[:, None], c.shape[1], axis=1)
    a1 = forward.acceleration(c, cd, held, beta)
    v2 = cd + 0.5 * h * a1
    a2 = forward.acceleration(c + 0.5 * h * cd, v2, held, beta)
    v3 = cd + 0.5 * h * a2
    a3 = forward.acceleration(c + 0.5 * h * v2, v3, held, beta)
    v4 = cd + h * a3
    a4 = forward.acceleration(c + h * v3, v4, held, beta)
    ahead = cd + 2 * v2 + 2 * v3 + v4, a1 + 2 * a2 + 2 * a3 + a4
    return np.concatenate([c + h / 6 * ahead[0], cd + h / 6 * ahead[1]])
