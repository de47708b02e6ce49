"""Drift of the torques' clock against that of the positions, found without a model.

Torques that another device recorded, joined row by row, are late by an offset that grows linearly with time. A constant
offset cannot be distinguished from friction and inertia without a model; it is left to the estimate of the torque
delay. A growing one can: every torque is regressed on positions, velocities, accelerations and the signs of the
velocities of all joints, and on its own rate, constant and growing with time. Misfits of this linear model do not grow
with time; the last coefficient is the drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import polynomial_filter
from haptid.log.resampling import Spans

# Windows spread over the log, and samples in each at most.
WINDOWS, LONGEST = 32, 256
# Rows of the local polynomial that smooths and differentiates.
_ROWS = 21
# Drift that is reported: standard errors, and steps over the whole log.
CLEAR, LEAST_STEPS = 6.0, 0.5
# Largest drift of a clock, as a share of the log: quartz has 1e-4, an RC oscillator 1e-2. More is a missing term.
_LARGEST_SHARE = 0.02


@dataclass(frozen=True)
class ClockDrift:
    """Growing delay of the torques with respect to the positions.

    Attributes:
        seconds: by which the delay has grown from the first sample to the last, s; too small by up to half, as the
            model is linear and the torque's rate is noisy.
        se: its standard error, by a jackknife over windows, s.
    """

    seconds: float
    se: float

    @property
    def sentence(self) -> str:
        """For the user."""
        return (
            f"the torques' clock drifts against the positions': over the log their delay grows by at least "
            f"{1e3 * self.seconds:.2g} ms (standard error {1e3 * self.se:.1g} ms); record both with one clock, or "
            f"identify short parts, each with its own torque delay"
        )


def clock_drift(position: Array, torque: Array, segments: Spans, dt: float) -> ClockDrift | None:
    """Drift of the torques' clock; None where there is none that is clear.

    Args:
        position, torque: (n, channels), also `OnDisk`.
        segments: first sample and one past the last of each part without a gap.
        dt: step, s.
    """
    n = len(position)
    size = min(LONGEST, n // 8)
    if size < 3 * _ROWS:
        return None
    spread = np.unique(np.linspace(0, n - size, min(WINDOWS, n // size)).astype(int))
    starts = [int(k) for k in spread if any(a <= k and k + size <= b for a, b in segments)]
    windows = [_window(position[k : k + size], torque[k : k + size], k / n - 0.5, size / n) for k in starts]
    if len(windows) < 8:
        return None
    shapes, rates, torques = (np.concatenate(parts) for parts in zip(*windows, strict=True))
    scale = np.sqrt(np.mean(shapes**2, axis=0))
    Q = np.linalg.qr(shapes / np.where(scale > 0, scale, 1.0))[0]
    upper, lower = np.zeros(len(windows)), np.zeros(len(windows))
    for rate, y in zip(np.moveaxis(rates, 2, 0), torques.T, strict=True):
        constant, growing, left = (x - Q @ (Q.T @ x) for x in (*rate.T, y))
        power = float(constant @ constant) or 1.0
        growing -= constant * float(constant @ growing) / power
        left -= constant * float(constant @ left) / power
        noise = float(left @ left)
        if noise > 0:
            upper += (growing * left).reshape(len(windows), -1).sum(axis=1) / noise
            lower += (growing * growing).reshape(len(windows), -1).sum(axis=1) / noise
    if not lower.any():
        return None
    slope = float(upper.sum() / lower.sum())
    se = float(np.sqrt(np.sum((upper - slope * lower) ** 2)) / lower.sum())
    if abs(slope) < max(CLEAR * se, LEAST_STEPS) or abs(slope) > _LARGEST_SHARE * n:
        return None
    return ClockDrift(-slope * dt, se * dt)


def _window(position: Array, torque: Array, start: float, length: float) -> tuple[Array, Array, Array]:
    """Columns of the model (rows, columns); rates of torque, constant and growing, (rows, 2, torques); torques."""
    inside = slice(_ROWS // 2, -(_ROWS // 2))

    def smooth(x: Array, order: int) -> Array:
        return polynomial_filter(x, _ROWS, 3, order)[inside]

    q, qd, qdd = (smooth(position, k) for k in (0, 1, 2))
    tau, rate = smooth(torque, 0), smooth(torque, 1)
    spread = qd.std(axis=0) + 1e-300
    shape = np.column_stack([q, np.sin(q), np.cos(q), qd, qdd, np.tanh(qd / (0.1 * spread)), np.ones(len(q))])
    t = start + length * np.linspace(0, 1, len(q))
    return shape, np.stack([rate, t[:, None] * rate], axis=1), tau
