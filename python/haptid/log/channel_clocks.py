"""Drift of the torques' clock against that of the positions, found without a model.

Torques that another device recorded, joined row by row, are late by an offset that grows linearly with time. A constant
offset cannot be distinguished from friction and inertia without a model; it is left to the estimate of the torque
delay. A growing one can: every torque is regressed on positions, velocities, accelerations and the signs of the
velocities of all joints, and on its own rate, constant and growing with time. Misfits of this linear model do not grow
with time; the last coefficient is the drift.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
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
    if len(starts) < 8:
        return None
    q, tau = (np.stack([channels[k : k + size] for k in starts], axis=1) for channels in (position, torque))
    times = np.array(starts) / n - 0.5 + size / n * np.linspace(0, 1, size - _ROWS + 1)[:, None]
    shapes, rates, torques = (_one_after_another(x) for x in _columns(q, tau, times))
    scale = np.sqrt(np.mean(shapes**2, axis=0))
    Q = np.linalg.qr(shapes / np.where(scale > 0, scale, 1.0))[0]
    upper, lower = np.zeros(len(starts)), np.zeros(len(starts))
    for rate, y in zip(np.moveaxis(rates, 2, 0), torques.T, strict=True):
        constant, growing, left = (x - Q @ (Q.T @ x) for x in (*rate.T, y))
        power = float(constant @ constant) or 1.0
        growing -= constant * float(constant @ growing) / power
        left -= constant * float(constant @ left) / power
        noise = float(left @ left)
        if noise > 0:
            upper += (growing * left).reshape(len(starts), -1).sum(axis=1) / noise
            lower += (growing * growing).reshape(len(starts), -1).sum(axis=1) / noise
    if not lower.any():
        return None
    slope = float(upper.sum() / lower.sum())
    se = float(np.sqrt(np.sum((upper - slope * lower) ** 2)) / lower.sum())
    if abs(slope) < max(CLEAR * se, LEAST_STEPS) or abs(slope) > _LARGEST_SHARE * n:
        return None
    return ClockDrift(-slope * dt, se * dt)


def _columns(position: Array, torque: Array, times: Array) -> tuple[Array, Array, Array]:
    """Columns of the model; rates of the torques, constant and growing, (2, torques); the torques, smoothed.

    Windows are filtered together, as calls for one of them take longer than its numbers. Each result is (rows, windows,
    ...).

    Args:
        position, torque: (samples of a window, windows, channels).
        times: of the rows, as shares of the log, (rows, windows).
    """
    inside = slice(_ROWS // 2, -(_ROWS // 2))
    q, qd, qdd = (polynomial_filter(position, _ROWS, 3, order)[inside] for order in (0, 1, 2))
    tau, rate = (polynomial_filter(torque, _ROWS, 3, order)[inside] for order in (0, 1))
    sign = np.tanh(qd / (0.1 * (qd.std(axis=0) + 1e-300)))
    shape = np.concatenate([q, np.sin(q), np.cos(q), qd, qdd, sign, np.ones((*times.shape, 1))], axis=2)
    return shape, np.stack([rate, times[..., None] * rate], axis=2), tau


def _one_after_another(windows: Array) -> Array:
    """Rows of all windows, (rows, windows, ...) to (windows x rows, ...)."""
    return np.swapaxes(windows, 0, 1).reshape(-1, *windows.shape[2:])
