"""Torque of an estimate along a motion, treated like the measured one: what plots and residuals are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._values import Array, read_only
from haptid.estimators import Estimate
from haptid.observation import Plan
from haptid.signals import coordinate_torque, coordinates, external
from haptid.treatment import Motion


@dataclass(frozen=True, eq=False)
class Prediction:
    """Measured and predicted torque of the treated rows.

    Attributes:
        motors: names, (motors,).
        units: N m or N, (motors,).
        t: (rows,), s.
        measured, predicted: joint-side torque, (motors, rows).
        used: whether a row counts, or was dropped as too slow, (motors, rows).
    """

    motors: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array
    used: np.ndarray

    def __post_init__(self) -> None:
        for name in ("t", "measured", "predicted"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def predict(estimate: Estimate, motion: Motion) -> Prediction:
    """Torque of the estimate along a motion, through the same filter and decimation as the measured torque.

    The filter is linear, so filtering the predicted torque is the same as filtering every column of W.
    """
    device = estimate.device
    plan = Plan.of(device, motion)
    chi = plan.selection @ estimate.beta
    d, taps = motion.treatment.decimation, plan.taps
    parts = []
    for start, stop in plan.segments():
        low, high = plan.window(start, stop)
        c, cd, cdd = coordinates(device, motion, low, high)
        tau = device.mechanism.torque(c, cd, cdd, external(device, c, cd, cdd), list(plan.columns), list(chi))
        measured = coordinate_torque(device, motion, low, high)
        parts.append((decimate(measured, taps, d), decimate(tau, taps, d), plan.weights(cd, stop - start) > 0))
    measured, predicted, used = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    motors = np.flatnonzero(device.measured).tolist()
    return Prediction(
        motors=tuple(device.row_names[k] for k in motors),
        units=tuple(device.torque_units[k] for k in motors),
        t=motion.t0 + motion.dt * (plan.first + d * np.arange(plan.rows)),
        measured=measured[motors],
        predicted=predicted[motors],
        used=used[motors],
    )


def decimate(signals: Array, taps: Array, decimation: int) -> Array:
    """Every window's weighted sum, (channels, samples) to (channels, rows): what the core does to its columns."""
    windows = np.lib.stride_tricks.sliding_window_view(signals, len(taps), axis=1)[:, ::decimation]
    return np.asarray(windows @ taps)
