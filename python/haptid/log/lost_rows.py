"""Missing rows of a recording whose stamps jitter by more than rounding each step allows.

A jump of the stamps that stays is a gap: the mean of many stamps after it, less that of as many before, is known
better than any step. Jitter of single stamps comes back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.signals import running_maximum

# Standard error of a jump, steps, that the windows on either side are long enough for; their fewest and most rows.
_KNOWN, _FEWEST, _MOST = 0.12, 8, 400
# Windows that are shorter than that error asks for by this factor do: longer ones have more than one gap in them.
_ENOUGH = 2.0
# Rows of the means from whose differences that error is estimated: wandering stamps average less than noise does.
_MEAN = 32
# Steps, over an ordinary one, from which on a gap is looked for, and the jump that is one.
_LONGER, _JUMP = 0.0, 0.65
# Passes: gaps near each other are counted apart, and the step is found again without them.
_PASSES = 10


def lost_rows(seconds: Array, jitter: float) -> NDArray[np.intp]:
    """Number of missing rows before each row but the first, (rows - 1,); none where the stamps are too rough to tell.

    Args:
        seconds: stamps of a segment, not decreasing, (rows,).
        jitter: of a stamp, standard deviation, steps.
    """
    none = np.zeros(seconds.size - 1, dtype=np.intp)
    m = int(np.clip(2 * (jitter / _KNOWN) ** 2, _FEWEST, _MOST))
    if seconds.size < 4 * m:
        return none
    lost, offset = _counted(seconds, m)
    for _ in range(2):  # rows that are lost, and those counted that are not, are in the first error
        needed = _window(offset)
        if needed <= _ENOUGH * m:
            return lost
        if needed > _MOST or seconds.size < 4 * needed:
            return none
        m = needed
        lost, offset = _counted(seconds, m)
    return lost if _window(offset) <= _ENOUGH * m else none


def _window(offset: Array) -> int:
    """Rows on either side of a row for which a jump is known well enough, from the offsets' means."""
    count = offset.size // _MEAN
    means = offset[: count * _MEAN].reshape(count, _MEAN).mean(axis=1)
    apart = np.diff(means)
    error = 1.4826 * float(np.median(np.abs(apart - np.median(apart)))) if count > 2 else 0.0
    return int(np.ceil(_MEAN * (error / _KNOWN) ** 2))


def _counted(seconds: Array, m: int) -> tuple[NDArray[np.intp], Array]:
    """Missing rows by windows of m rows, (rows - 1,), and what the stamps differ from the grid by, steps, (rows,).

    None are counted where the clock stands still over most windows: it has no step there.
    """
    rows = seconds.size
    lost = np.zeros(rows - 1, dtype=np.intp)
    step = float(np.median(seconds[m:] - seconds[:-m])) / m
    if step <= 0:
        return lost, np.zeros(rows)
    for _ in range(_PASSES):
        slots = np.append(0, np.cumsum(lost + 1))
        offset = (seconds - seconds[0]) / step - slots
        jump = _jump(offset, m)
        longer = np.diff(offset)
        looked = (lost > 0) | ((longer > _LONGER) & (jump > _JUMP))
        clear = np.where(looked, np.abs(jump) + np.abs(longer), 0.0)
        # One in each neighbourhood: another one's jump is in the same means.
        chosen = looked & (clear >= running_maximum(clear, 2 * m + 1))
        change = np.where(chosen, np.maximum(np.rint(jump).astype(np.intp), -lost), 0)
        lost += change
        slots = np.append(0, np.cumsum(lost + 1))
        half = rows // 2
        step = float(np.median((seconds[half:] - seconds[:-half]) / (slots[half:] - slots[:-half])))
        if not change.any():
            break
    return lost, (seconds - seconds[0]) / step - slots


def _jump(offset: Array, m: int) -> Array:
    """Mean of the m offsets from a row on less that of the m before it, for each row but the first, (rows - 1,)."""
    total = np.append(0.0, np.cumsum(offset))
    k = np.arange(1, offset.size)
    low, high = np.maximum(k - m, 0), np.minimum(k + m, offset.size)
    return np.asarray((total[high] - total[k]) / (high - k) - (total[k] - total[low]) / (k - low))
