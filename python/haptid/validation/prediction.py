"""Torque of an estimate along a motion, treated like the measured one: what plots and residuals are made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, freeze, read_only
from haptid.dynamics.inverse import core_momentum, core_torque, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.motion.channels import coordinate_torque
from haptid.motion.treatment import Motion
from haptid.observation.observation import Plan, Signals


@dataclass(frozen=True, eq=False)
class Prediction:
    """Measured and predicted torque of the treated rows.

    Attributes:
        motors: what each row is of, "motor 1" or "joint 5", (motors,).
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
        self.used.flags.writeable = False


def predict(estimate: Estimate, motion: Motion) -> Prediction:
    """Torque of the estimate along a motion, through the same filter and decimation as the measured torque.

    The filter is linear, so filtering the predicted torque is the same as filtering every column of W.
    """
    parts = list(predictions(estimate, motion))
    measured, predicted, used = (
        np.concatenate([getattr(part, name) for part in parts], axis=1) for name in ("measured", "predicted", "used")
    )
    t = np.concatenate([part.t for part in parts])
    return Prediction(parts[0].motors, parts[0].units, t, freeze(measured), freeze(predicted), used)


def predictions(estimate: Estimate, motion: Motion) -> Iterator[Prediction]:
    """The same, stretch after stretch: for motions whose rows would not fit in memory together."""
    model = estimate.model
    plan = Plan.of(model, motion)
    chi = raw_parameters(model, estimate.beta)
    d = motion.treatment.decimation
    rows = [k for k, known in enumerate(model.device.measured) if known]
    names, units = (tuple(every[k] for k in rows) for every in (model.device.row_labels, model.device.torque_units))
    for start, stop in plan.segments():
        low, high = plan.window(start, stop)
        measured = coordinate_torque(model.device, motion, low, high)
        yield Prediction(
            motors=names,
            units=units,
            t=np.asarray(motion.t0 + motion.dt * (plan.first + d * np.arange(start, stop)), dtype=np.float64),
            measured=decimate(measured, plan.filter.taps, d)[rows],
            predicted=treated_torque(plan, model, chi, plan.signals(low, high))[rows],
            used=plan.weights(start, stop)[rows] > 0,
        )


def treated_torque(plan: Plan, model: DynamicModel, chi: Array, signals: Signals) -> Array:
    """Torque of the core's columns under some rows, filtered and decimated as these are, (coordinates, rows), N m or N.

    Args:
        plan: which rows.
        model: the plan's, or one that differs in its terms' settings.
        chi: parameters of the core's columns, (r,), SI.
        signals: what `plan.signals` gives of the samples under the rows.
    """
    c, cd, cdd, own = signals
    shared, d = plan.filter, plan.motion.treatment.decimation
    if cdd is not None:
        return decimate(core_torque(model, chi, c, cd, cdd, own), shared.taps, d)
    assert shared.slope is not None  # without accelerations the filter differentiates
    momentum, rest = core_momentum(model, chi, c, cd, own)
    return decimate(rest, shared.taps, d) + decimate(momentum, shared.slope, d)


def decimate(signals: Array, taps: Array, decimation: int) -> Array:
    """Every window's weighted sum, (channels, samples) to (channels, rows): what the core does to its columns."""
    windows = np.lib.stride_tricks.sliding_window_view(signals, len(taps), axis=1)[:, ::decimation]
    return np.asarray(windows @ taps)
