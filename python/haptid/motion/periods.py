"""Period of a periodic motion, from the mean square difference of its positions at a lag."""

from __future__ import annotations

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array
from haptid._internal.signals import fast_length
from haptid.motion.motion import Motion

# Mean square of what changes in a period, over twice the positions' own, below which a motion repeats itself; and above
# which it has left where it was.
_ALIKE, _AWAY = 0.01, 0.25
# Periods in a segment, at least.
_FEWEST = 2.5
# Samples of a segment that are used, at most.
_ENOUGH = 1 << 18


def motion_period(motion: Motion) -> float | None:
    """Period of all positions of a motion, s; None where it is not periodic.

    The first deep minimum of the mean square difference between positions a lag apart, refined at multiples of it.

    Source: de Cheveigne and Kawahara (2002), J. Acoust. Soc. Am. 111(4), eqs 6 and 10.

    Args:
        motion: treated signals; its longest part without a gap is looked at.
    """
    start, stop = max(motion.usable_segments, key=lambda part: part[1] - part[0])
    x = np.asarray(motion.q[start : min(stop, start + _ENOUGH)]).T
    x = x - x.mean(axis=1, keepdims=True)
    moving = x.std(axis=1) > 0
    if not moving.any():
        return None
    difference = _differences(x[moving] / x[moving].std(axis=1, keepdims=True))
    n = x.shape[1]
    longest = int(n / _FEWEST)
    departed = np.flatnonzero(difference[:longest] > _AWAY)
    if not departed.size:
        return None
    alike = np.flatnonzero(difference[departed[0] : longest] < _ALIKE) + departed[0]
    if not alike.size:
        return None
    breaks = np.flatnonzero(np.diff(alike) > 1)
    valley = alike[: breaks[0] + 1] if breaks.size else alike
    lag = _minimum(difference, int(valley[np.argmin(difference[valley])]))
    periods = 1
    while 2 * periods * lag < 0.5 * n:  # the minimum many periods away is the more accurate
        periods *= 2
        around = int(0.25 * lag)
        first = round(periods * lag) - around
        near = difference[first : first + 2 * around + 1]
        lag = _minimum(difference, first + int(np.argmin(near))) / periods
    return float(lag * motion.dt)


def _differences(x: Array) -> Array:
    """Mean square of x(t + lag) - x(t) over twice that of x, of all lags, (channels, n) to (n,); its worst channel."""
    n = x.shape[1]
    size = fast_length(2 * n)
    overlap = n - np.arange(n)
    worst = np.zeros(n)
    for channel in x:
        product = fft.irfft(np.abs(fft.rfft(channel, size)) ** 2, size)[:n]
        before = np.append(0.0, np.cumsum(channel**2))
        squares = before[n - np.arange(n)] + before[-1] - before[np.arange(n)]
        worst = np.maximum(worst, (squares - 2 * product) / (2 * overlap))
    return worst


def _minimum(values: Array, k: int) -> float:
    """Place of the minimum of the parabola through three neighbours."""
    if not 0 < k < len(values) - 1:
        return float(k)
    before, centre, after = values[k - 1 : k + 2]
    curvature = before - 2 * centre + after
    return k + float(0.5 * (before - after) / curvature) if curvature > 0 else float(k)
