"""Torque channels of a log by motor.

Advice numbers motors as the rows of known torque, a joint that nothing drives among them: its row has zero torque, and
no channel. Channels are numbered as the log has them. Nothing else relates the two numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import torque_map
from haptid.motion.motion import Motion

# Share of the largest entry of the map from channels to rows below which one is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class TorqueChannels:
    """Which channel is whose.

    Attributes:
        enters: whether a channel enters a motor's row, (motors, channels).
        measured: motors whose torque is measured.
        scales: torque of each motor's row per unit of its channel, 1 where it has none, (motors,); None where rows mix
            channels, or a factor varies with the pose.
    """

    enters: np.ndarray
    measured: tuple[int, ...]
    scales: Array | None

    def of(self, motor: int) -> int | None:
        """The channel of a motor; None where it has none of its own."""
        (own,) = np.nonzero(self.enters[motor])
        return int(own[0]) if len(own) == 1 and self.enters[:, own[0]].sum() == 1 else None

    def motors(self, channel: int) -> tuple[int, ...]:
        """Motors whose rows a channel enters."""
        return tuple(np.flatnonzero(self.enters[:, channel]).tolist())


def channels_of_motors(model: DynamicModel, motions: Sequence[Motion]) -> TorqueChannels:
    """Whose the torque channels of logs are.

    Args:
        model: of the device.
        motions: of one fit, with the same channels.
    """
    device, log, rows = model.device, motions[0].log, list(model.measured_rows)
    measured = np.flatnonzero(np.isin(model.known_rows, rows))
    change = np.zeros((len(model.known_rows), motions[0].tau.shape[1]))
    varies = log is not None and log.channels.torque.side == "motor" and bool(device.drive_varies.any())
    if log is None:  # channels are in the order of the rows
        change[measured, np.arange(len(measured))] = 1.0
    elif varies:  # they are the motors', whose factors are not needed to tell where each enters
        change[measured] = (np.abs(device.drive_rates) + device.drive_varies)[device.driven][:, rows].T
    else:
        change[measured] = torque_map(device, log)[rows]
    enters = np.abs(change) > _ROUNDING * np.abs(change).max(initial=0.0)
    found = TorqueChannels(enters, tuple(measured.tolist()), None)
    own = {motor: found.of(motor) for motor in found.measured}
    if varies or None in own.values():
        return found
    scales = np.ones(len(change))
    for motor, channel in own.items():
        scales[motor] = change[motor, channel]
    return TorqueChannels(enters, found.measured, scales)
