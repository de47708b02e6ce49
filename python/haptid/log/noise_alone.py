"""Torque channels that show noise alone: at the frequencies of the motion they have no more power than beside them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import kaiser_window, welch
from haptid.errors import LogDataError
from haptid.log.formats.sniff import channel_list
from haptid.log.log import Log
from haptid.log.spectrum import fastest

# Samples of a log that are looked at, at most, and windows that they are divided into; shape of these.
_ENOUGH, _WINDOWS, _SHAPE = 1 << 17, 2, 6.0
# Bands, in bandwidths of the motion: up to where torques are, and where they have little left. Fewest bins of each.
_BAND, _BESIDE, _BINS = 2.0, (4.0, 12.0), 12
# Power density in the first over that in the second below which a channel has noise alone: with twice as much, half of
# the power at the motion's frequencies would be torque. That of torques is tens to thousands of times as much.
_LITTLE = 1.5
# Share of a channel's variance at those frequencies, by the positions and their rates, from which on it is no noise: a
# controller that switches has as much power beside the motion. Fewest means for each column of that regression.
_FOLLOWS, _MEANS = 0.3, 4
# Share of the farthest joint's travel below which a joint stands still.
_STILL = 0.02
_FOUND: WeakKeyDictionary[Log, np.ndarray] = WeakKeyDictionary()


def noise_alone(log: Log) -> np.ndarray:
    """Whether each torque channel shows noise alone, (channels,); none where the log is too short to tell.

    None of a joint that stands still in this log, as in logs of one axis after the other: noise is what it has to show.
    """
    if log not in _FOUND:
        part = _looked_at(log)
        torque, position = np.asarray(log.torque[part]), np.asarray(log.position[part])
        edge = fastest(position.T, log.dt)
        flat = _flat(torque, edge, log.dt, log.usable_bandwidth_hz) & ~_at_rest(torque, position)
        _FOUND[log] = flat & ~_follows(torque, position, edge, log.dt) if flat.any() else flat
    return _FOUND[log]


def check_torques(log: Log) -> tuple[str, ...]:
    """Refuse torque channels that show noise alone; returns a note where they may.

    Raises:
        LogDataError: one does, and its signal is not marked with `constant_ok`.
    """
    found = np.flatnonzero(noise_alone(log))
    if not found.size:
        return ()
    signal, k = log.channels.torque, int(found[0])
    names, one = channel_list([signal.channels[k] for k in found]), found.size == 1
    size = float(np.std(log.torque[_looked_at(log)][:, k]))  # of a log on disk rows alone are sliced
    text = (
        f"torque channel{'' if one else 's'} {names} show{'s' if one else ''} noise alone (standard deviation "
        f"{size:.3g} {log.channels.torque_unit}{'' if one else ' of the first'}), and no part that follows the motion"
    )
    if signal.constant_ok:
        return (f"{text}, as allowed: what {'its motor does' if one else 'their motors do'} is not known.",)
    raise LogDataError(
        f"{log.path}: {text}: it is not connected, its motor was off, or it is of something else.",
        where=signal.channels[k],
        found=size,
        advice="Map the channel of this motor; where the motor is off, and its joint at rest, hold the joint in the "
        "device file (haptid import --hold). To identify the others, give the torque `constant_ok = true`.",
    )


def _looked_at(log: Log) -> slice:
    """Samples of the longest part without a gap, not more than are enough."""
    start, stop = max(log.segments, key=lambda part: part[1] - part[0])
    return slice(start, min(stop, start + _ENOUGH))


def _at_rest(torque: Array, position: Array) -> np.ndarray:
    """Whether the joint of each torque channel stands still; none where positions are more or fewer."""
    travels = np.ptp(position, axis=0)
    return travels < _STILL * travels.max() if torque.shape == position.shape else np.zeros(torque.shape[1], dtype=bool)


def _flat(torque: Array, edge: float, dt: float, highest: float | None) -> np.ndarray:
    """Whether each channel's power is as flat as that of noise about the motion's bandwidth."""
    none = np.zeros(torque.shape[1], dtype=bool)
    length = len(torque) // _WINDOWS
    if not 0 < edge < np.inf or length < _BINS:
        return none
    window = kaiser_window(length, _SHAPE)
    f = np.fft.rfftfreq(length, dt)
    top = min(_BESIDE[1] * edge, 0.8 * (highest or f[-1]))
    inside, beside = (f > 2 * f[1]) & (f <= _BAND * edge), (f > _BESIDE[0] * edge) & (f <= top)
    if min(inside.sum(), beside.sum()) < _BINS:
        return none
    powers = np.array([welch(channel, dt, window, line=True)[1] for channel in torque.T])
    dense = powers[:, beside].mean(axis=1)
    return np.asarray((powers[:, inside].mean(axis=1) < _LITTLE * dense) & (dense > 0))


def _follows(torque: Array, position: Array, edge: float, dt: float) -> np.ndarray:
    """Whether means of each channel over a quarter of the fastest period are those of positions and their rates."""
    size = max(1, int(0.5 / (_BAND * edge * dt)))
    count = len(torque) // size
    q, tau = (x[: count * size].reshape(count, size, -1).mean(axis=1) for x in (position, torque))
    v = np.gradient(q, axis=0)
    shapes = np.column_stack((np.ones(count), np.sin(q), np.cos(q), v, np.sign(v), np.gradient(v, axis=0)))
    if count < _MEANS * shapes.shape[1]:
        return np.ones(torque.shape[1], dtype=bool)
    left = tau - shapes @ np.linalg.lstsq(shapes, tau, rcond=None)[0]
    own = (left**2).sum(axis=0) / (count - shapes.shape[1])
    return np.asarray(1 - own / np.maximum(tau.var(axis=0, ddof=1), np.finfo(float).tiny) > _FOLLOWS)
