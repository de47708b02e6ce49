"""Predicted torque of an estimate along a motion, treated like the measured torque, for plots and residuals."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.motion.motion import Motion
from haptid.observation.rows import chunks


@dataclass(frozen=True, eq=False)
class Prediction:
    """Measured and predicted torque of the treated rows.

    Attributes:
        motors: label of each row, "motor 1" or "joint 5", (motors,).
        units: N m or N, (motors,).
        t: (rows,), s.
        measured, predicted: joint-side torque, (motors, rows).
        used: whether each row is used, or was dropped as too slow, (motors, rows).
    """

    motors: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array
    used: np.ndarray

    def __post_init__(self) -> None:
        freeze_fields(self, "t", "measured", "predicted")
        self.used.flags.writeable = False


def predict(estimate: Estimate, motion: Motion) -> Prediction:
    """Torque of an estimate along a motion, through the same filter and decimation as the measured torque.

    The filter is linear, so filtering the predicted torque is equivalent to filtering every column of W.
    """
    parts = list(predictions(estimate, motion))
    measured, predicted, used = (
        np.concatenate([getattr(part, name) for part in parts], axis=1) for name in ("measured", "predicted", "used")
    )
    t = np.concatenate([part.t for part in parts])
    return Prediction(parts[0].motors, parts[0].units, t, freeze(measured), freeze(predicted), used)


def predictions(estimate: Estimate, motion: Motion) -> Iterator[Prediction]:
    """Predictions chunk by chunk, for motions whose rows do not fit in memory together."""
    device, chi = estimate.model.device, raw_parameters(estimate.model, estimate.beta)
    rows = [k for k, known in enumerate(device.known) if known]
    names, units = (tuple(every[k] for k in rows) for every in (device.row_labels, device.torque_units))
    for chunk in chunks(estimate.model, motion):
        yield Prediction(names, units, chunk.t, chunk.measured(), chunk.torque(chi), chunk.used)
