"""Motors whose torque shows noise alone: which rows that are not used, and the sentence about them."""

from __future__ import annotations

import numpy as np

from haptid.device import Device
from haptid.log import Log
from haptid.log.noise_alone import noise_alone
from haptid.motion.channels import torque_map

# Share of the RMS torque of its unit up to which a motor's noise does not matter to the others: its rows are kept.
_HARDLY = 0.02
# Samples of which the torque's size is taken, at most.
_ENOUGH = 1 << 17


def rows_of_noise(device: Device, log: Log, least: float = _HARDLY) -> np.ndarray:
    """Whether the torque of each row of a log shows noise alone and weighs beside the others, (rows,).

    None where all do, where torques of several channels act on a row, or where the torque is too small to matter: up to
    a share of the RMS torque of its unit.
    """
    rows = np.zeros(len(device.row_names), dtype=bool)
    found = noise_alone(log)
    if not found.any() or device.drive_varies.any():
        return rows
    change = torque_map(device, log)
    if (np.count_nonzero(change, axis=0) != 1).any() or (np.count_nonzero(change, axis=1) > 1).any():
        return rows
    place = np.argmax(change != 0, axis=0)
    rms = np.zeros(len(rows))
    rms[place] = np.abs(change).max(axis=0) * np.sqrt(np.mean(np.square(log.torque[:_ENOUGH]), axis=0))
    units = np.array(device.torque_units)
    whole = np.sqrt([np.sum(rms[units == unit] ** 2) for unit in units])
    rows[place[found]] = True
    rows &= rms > least * whole
    return rows if not rows[place].all() else np.zeros(len(rows), dtype=bool)


def said_of_noise(device: Device, log: Log) -> tuple[str, ...]:
    """A sentence for each motor whose rows are not used because its torque shows noise alone; one where all do."""
    if noise_alone(log).all():
        return (
            f"{log.path.name}: no torque follows the motion, while the joints move: all channels are noise, and "
            "nothing can be identified from it. Check that the channels are connected and are the motors' torques; "
            "where the motors were off, record again with them on.",
        )
    return tuple(_sentence(device, log, int(k)) for k in np.flatnonzero(rows_of_noise(device, log)))


def said_of_unseen_noise(device: Device, log: Log) -> dict[int, str]:
    """By row, a sentence for each row of a validation log whose torque shows noise alone, however small; or all do."""
    if noise_alone(log).all():
        return dict.fromkeys(range(len(device.row_names)), said_of_noise(device, log)[0])
    return {int(k): _sentence(device, log, int(k)) for k in np.flatnonzero(rows_of_noise(device, log, 0.0))}


def _sentence(device: Device, log: Log, row: int) -> str:
    channel = int(np.flatnonzero(torque_map(device, log)[row])[0])
    names, unit = log.channels.torque.channels, log.channels.torque_units[channel]
    size = float(np.std(log.torque[:_ENOUGH][:, channel]))
    used = not rows_of_noise(device, log)[row]
    return (
        f"{log.path.name}: torque of {device.row_labels[row]} shows no part that follows the motion, while its joint "
        f"moves: channel {names[channel]} is noise, with a standard deviation of {size:.3g} {unit}. "
        f"{'Its error is of noise' if used else 'Its rows are not used, and count in no error'}. "
        "Check that the channel is connected and is that of this motor; where the motor was off, record again with it "
        "on."
    )
