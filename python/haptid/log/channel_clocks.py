"""Drift of the torques' clock against that of the positions, found without a model.

Torques that another device recorded, joined row by row, are later or earlier by an offset that grows linearly with time.
A constant offset cannot be told from friction and inertia without a model; it is left to the estimate of the torque
delay. A growing one can: every torque is regressed on positions, velocities, accelerations and the signs of the
velocities of all joints, and on its own rate, constant and growing with time. Misfits of this linear model do not grow
with time; the last coefficient is the drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array
from haptid.log.resampling import Spans

# Windows spread over the log, and samples in each at most.
WINDOWS, LONGEST = 64, 512
# Rows of the local polynomial that smooths and differentiates.
_ROWS = 21
# Drift that is reported: standard errors, and steps over the whole log.
CLEAR, LEAST_STEPS = 6.0, 0.5


@dataclass(frozen=True)
class ClockDrift:
    """Growing delay of the torques with respect to the positions.

    Attributes:
        seconds: by which the delay has grown from the first sample to the last, s.
        se: its standard error, by a jackknife over windows, s.
    """

    seconds: float
    se: float


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
    starts = np.unique(np.linspace(0, n - size, min(WINDOWS, n // size)).astype(int))
    starts = [k for k in starts if any(a <= k and k + size <= b for a, b in segments)]
    windows = [_window(position[k : k + size], torque[k : k + size], k / n - 0.5, size / n) for k in starts]
    if len(windows) < 8:
        return None
    shapes, rates, torques = zip(*windows, strict=True)
    scale = np.sqrt(np.mean([np.mean(s**2, axis=0) for s in shapes], axis=0))
    shapes = [s / np.where(scale > 0, scale, 1.0) for s in shapes]
    upper, lower = np.zeros(len(windows)), np.zeros(len(windows))
    for j in range(torque.shape[1]):
        rows = [np.column_stack([s, r[:, :, j]]) for s, r in zip(shapes, rates, strict=True)]
        X, y = np.concatenate(rows), np.concatenate([t[:, j] for t in torques])
        others, growing = X[:, :-1], X[:, -1]
        made = np.linalg.lstsq(others, np.column_stack([growing, y]), rcond=1e-8)[0]
        own, left = growing - others @ made[:, 0], y - others @ made[:, 1]
        noise = float(left @ left)
        if noise <= 0 or not own.any():
            continue
        upper += (own * left).reshape(len(windows), -1).sum(axis=1) / noise
        lower += (own * own).reshape(len(windows), -1).sum(axis=1) / noise
    if not lower.any():
        return None
    slope = float(upper.sum() / lower.sum())
    se = float(np.sqrt(np.sum((upper - slope * lower) ** 2)) / lower.sum())
    if abs(slope) < max(CLEAR * se, LEAST_STEPS):
        return None
    return ClockDrift(-slope * dt, se * dt)


def _window(position: Array, torque: Array, start: float, length: float) -> tuple[Array, Array, Array]:
    """Columns of the model (rows, columns); rates of torque, constant and growing, (rows, 2, torques); torques."""
    inside = slice(_ROWS // 2, -(_ROWS // 2))

    def smooth(x: Array, order: int) -> Array:
        return np.asarray(signal.savgol_filter(x, _ROWS, 3, deriv=order, axis=0))[inside]

    q, qd, qdd = (smooth(position, k) for k in (0, 1, 2))
    tau, rate = smooth(torque, 0), smooth(torque, 1)
    spread = qd.std(axis=0) + 1e-300
    shape = np.column_stack([q, np.sin(q), np.cos(q), qd, qdd, np.tanh(qd / (0.1 * spread)), np.ones(len(q))])
    t = start + length * np.linspace(0, 1, len(q))
    return shape, np.stack([rate, t[:, None] * rate], axis=1), tau
