"""Torque channels that show noise alone while their joint moves: not connected, or of a motor that is off."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import kaiser_window, welch
from haptid.log.log import Log
from haptid.log.spectrum import bulk_bandwidth, fastest, spectra
from haptid.uncertainty.distributions import f_tail

# Samples of a log that are looked at, at most, and windows that they are divided into; shape of these.
_ENOUGH, _WINDOWS, _SHAPE = 1 << 17, 2, 6.0
# Bands, in bandwidths of the motion: up to where torques are, and where they have little left. Fewest bins of each.
_BAND, _BESIDE, _BINS = 2.0, (4.0, 12.0), 12
# Power density in the first over that in the second below which a channel may have noise alone: that of torques is tens
# to thousands of times as much.
_LITTLE = 1.5
# Probability in noise of a regression on the motion, below which a channel follows it; means for each of its columns,
# at least: with fewer it would not find a part of a tenth.
_FOLLOWS, _MEANS = 0.01, 6
# Share of the farthest joint's travel, and of a joint's usual speed, below which it stands still.
_STILL, _SLOW = 0.02, 0.2
_FOUND: WeakKeyDictionary[Log, np.ndarray] = WeakKeyDictionary()


def noise_alone(log: Log) -> np.ndarray:
    """Whether each torque channel shows noise alone, (channels,); none where that is not certain.

    Such a channel has no more power at the motion's frequencies than beside them, and while its joint moves no part
    that follows position, velocity, its sign or acceleration of any joint, or of all together. Of a joint that stands
    still nothing is said, nor where positions and torques are not of the same joints, or too few to find a small part.
    """
    if log not in _FOUND:
        start, stop = max(log.segments, key=lambda part: part[1] - part[0])
        part = slice(start, min(stop, start + _ENOUGH))
        torque, position = np.asarray(log.torque[part]), np.asarray(log.position[part])
        flat = np.zeros(torque.shape[1], dtype=bool)
        if torque.shape == position.shape:
            # The choice of a treatment has the spectra of the whole log.
            known = len(position) == len(log.t) and log.usable_bandwidth_hz is None
            edge = bulk_bandwidth(spectra(log)) if known else fastest(position.T, log.dt)
            travels = np.ptp(position, axis=0)
            flat = _flat(torque, edge, log.dt, log.usable_bandwidth_hz) & (travels > _STILL * travels.max())
            flat[flat] = [not _follows(torque, position, edge, log.dt, int(k)) for k in np.flatnonzero(flat)]
        _FOUND[log] = flat
    return _FOUND[log]


def with_torques_of(log: Log, other: Log) -> Log:
    """A log of which it is known that its torques are another's; its positions may differ by noise and filters."""
    _FOUND[log] = noise_alone(other)
    return log


def _flat(torque: Array, edge: float, dt: float, highest: float | None) -> np.ndarray:
    """Whether each channel's power is as flat as that of noise about the motion's bandwidth."""
    none = np.zeros(torque.shape[1], dtype=bool)
    length = len(torque) // _WINDOWS
    if not 0 < edge < np.inf or length < _BINS:
        return none
    f = np.fft.rfftfreq(length, dt)
    top = min(_BESIDE[1] * edge, 0.8 * (highest or f[-1]))
    inside, beside = (f > 2 * f[1]) & (f <= _BAND * edge), (f > _BESIDE[0] * edge) & (f <= top)
    if min(inside.sum(), beside.sum()) < _BINS:
        return none
    window = kaiser_window(length, _SHAPE)
    powers = np.array([welch(channel, dt, window, line=True)[1] for channel in torque.T])
    dense = powers[:, beside].mean(axis=1)
    return np.asarray((powers[:, inside].mean(axis=1) < _LITTLE * dense) & (dense > 0))


def _follows(torque: Array, position: Array, edge: float, dt: float, k: int) -> bool:
    """Whether means of channel k over a quarter of the fastest period, where its joint moves, may follow the motion."""
    size = max(1, int(0.5 / (_BAND * edge * dt)))
    count = len(torque) // size
    if count < _MEANS:
        return True
    q, tau = (x[: count * size].reshape(count, size, -1).mean(axis=1) for x in (position, torque))
    v = np.gradient(q, axis=0)
    speed = np.abs(v[:, k])
    moves = speed > _SLOW * np.percentile(speed, 90)
    shapes = np.stack((np.sin(q), np.cos(q), v, np.sign(v), np.gradient(v, axis=0)), axis=1)[moves]
    n, columns, joints = shapes.shape
    if n < _MEANS * (columns + 1):
        return True
    tests = [shapes[:, :, j] for j in range(joints)]
    if n >= _MEANS * (columns * joints + 1):
        tests.append(shapes.reshape(n, -1))
    return any(_chance(tau[moves, k], one) < _FOLLOWS / len(tests) for one in tests)


def _chance(y: Array, columns: Array) -> float:
    """Probability that columns explain so much of a series about its mean if it is white noise."""
    n, p = columns.shape
    y, X = y - y.mean(), columns - columns.mean(axis=0)
    left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    below = max(float(left @ left) / (n - 1 - p), np.finfo(float).tiny)
    return float(f_tail((y @ y - left @ left) / p / below, p, n - 1 - p))
