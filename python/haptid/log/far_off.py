"""Single values far beyond all others of a channel, as of rows that were damaged when they were written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Values of a channel that may be damaged, at most, and at least so many of them in all; times by which the largest is
# beyond that which is not.
_MOST, _ENOUGH, _BEYOND = 10, 1000, 3.0


def far_off(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the values, (n,), are far beyond all others in size: ten at most, of a thousand and more; NaN is none.

    A motion or a torque that is sampled is at its largest for longer than that.
    """
    sizes = np.abs(np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0))
    if sizes.size < _ENOUGH:
        return np.zeros(sizes.shape, dtype=bool)
    usual = float(np.partition(sizes, -_MOST - 1)[-_MOST - 1])
    return np.asarray((sizes > _BEYOND * usual) & (usual > 0))
