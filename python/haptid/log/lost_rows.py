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
_KNOWN, _FEWEST, _MOST = 0.12, 8, 200
# Steps, over an ordinary one, from which on a gap is looked for, and the jump that is one.
_LONGER, _JUMP = 0.0, 0.65
# Passes: gaps near each other are counted apart, and the step is found again without them.
_PASSES = 10


def lost_rows(seconds: Array, jitter: float) -> NDArray[np.intp]:
    """Number of missing rows before each row but the first, (rows - 1,).

    Args:
        seconds: stamps of a segment, not decreasing, (rows,).
        jitter: of a stamp, standard deviation, steps.
    """
    rows = seconds.size
    m = int(np.clip(2 * (jitter / _KNOWN) ** 2, _FEWEST, _MOST))
    lost = np.zeros(rows - 1, dtype=np.intp)
    if rows < 4 * m:
        return lost
    step = float(np.median(seconds[m:] - seconds[:-m])) / m
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
    return lost


def _jump(offset: Array, m: int) -> Array:
    """Mean of the m offsets from a row on less that of the m before it, for each row but the first, (rows - 1,)."""
    total = np.append(0.0, np.cumsum(offset))
    k = np.arange(1, offset.size)
    low, high = np.maximum(k - m, 0), np.minimum(k + m, offset.size)
    return np.asarray((total[high] - total[k]) / (high - k) - (total[k] - total[low]) / (k - low))
