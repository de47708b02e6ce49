"""Samples of one recording in two logs: a file that was saved again, converted or cut out of another."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import fast_length
from haptid.log.log import Log

# Samples of the pieces that are searched for, at most and at least, how many of them along the shorter log, and which
# share of those with motion has to be found: simulated logs may begin with the same approach.
_LONGEST, _SHORTEST, _PIECES, _FOUND = 1024, 64, 4, 0.75
# Samples of a log that its standard deviations are computed from, about.
_SPREAD = 2_000
# Differences, in standard deviations, up to which samples are the same: files of five digits. Motions that a machine
# repeats differ by its noise, of a thousandth and more.
_SAME = 1e-4
# Rates that differ by more are of different recordings.
_RATES = 1e-3
# Samples of the faster log for one of the slower, at most.
_SLOWEST = 50
# A piece moves where its standard deviation is this share of the log's.
_MOVES = 0.1


def same_samples(one: Log, other: Log) -> tuple[float, float] | None:
    """Where the second log first has samples of the first one, start and stop of a piece of it, s; None where nowhere.

    Of logs whose rates are multiples of each other, the slower one may have every second, third, ... sample. Two files
    of the same bytes are not looked at, nor logs that are not in memory: they share no rows that are not known by their
    times.
    """
    if (one.sha256 and one.sha256 == other.sha256) or not (_in_memory(one) and _in_memory(other)):
        return None
    if one.position.shape[1:] != other.position.shape[1:] or one.torque.shape[1:] != other.torque.shape[1:]:
        return None
    times = max(one.dt / other.dt, other.dt / one.dt)
    every = round(times)
    if abs(times / every - 1.0) > _RATES or every > _SLOWEST:
        return None
    for first in range(every):
        part = slice(first, None, every)
        rows, others = (part, slice(None)) if one.dt < other.dt else (slice(None), part)
        found = _first_piece(_channels(one, rows), _channels(other, others), one.position.shape[1])
        if found:
            return float(other.t[others][found[0]]), float(other.t[others][found[1]])
    return None


def _first_piece(one: Array, other: Array, positions: int) -> tuple[int, int] | None:
    """First and last sample of the second log's first piece that the first one has; None where most are not there.

    Args:
        one, other: positions, and torques beside them, of two logs of one rate, (n, channels) and (m, channels).
        positions: number of the channels that are positions.
    """
    shorter, longer = (other, one) if len(other) <= len(one) else (one, other)
    size = min(_LONGEST, len(shorter) // 2)
    if size < _SHORTEST:
        return None
    spread = shorter[:: max(1, len(shorter) // _SPREAD)].std(axis=0)
    starts = np.linspace(0, len(shorter) - size, _PIECES).astype(int).tolist()
    pieces = [shorter[start : start + size] for start in starts]
    shares = [np.divide(piece.std(axis=0), spread, out=np.zeros_like(spread), where=spread > 0) for piece in pieces]
    moving = [k for k, own in enumerate(shares) if min(own[:positions].max(), own[positions:].max()) > _MOVES]
    found: list[int] = []
    for number, k in enumerate(moving):
        most = int(np.argmax(shares[k]))
        at = _nearest(longer[:, most], pieces[k][:, most])
        difference = longer[at : at + size] - pieces[k]
        if (np.sqrt(np.mean(difference**2, axis=0)) <= _SAME * spread).all():
            found.append(starts[k] if shorter is other else at)
        if number + 1 - len(found) > (1 - _FOUND) * len(moving):
            return None
    return (found[0], found[0] + size - 1) if found else None


def _in_memory(log: Log) -> bool:
    return isinstance(log.position, np.ndarray) and isinstance(log.torque, np.ndarray)


def _channels(log: Log, rows: slice) -> Array:
    """Some rows of positions and torques beside each other, (n, channels)."""
    return np.hstack([np.asarray(log.position[rows]), np.asarray(log.torque[rows])])


def _nearest(whole: Array, piece: Array) -> int:
    """The sample of a channel, (n,), from which it has the least squared difference from a piece of one, (m,)."""
    x, y = whole - piece.mean(), piece - piece.mean()
    sums = np.concatenate([[0.0], np.cumsum(x**2)])
    energy = sums[len(y) :] - sums[: len(x) - len(y) + 1]
    n = fast_length(len(x))
    products = np.fft.irfft(np.fft.rfft(x, n) * np.fft.rfft(y, n).conj(), n)[: len(energy)]
    return int(np.argmin(energy - 2.0 * products))
