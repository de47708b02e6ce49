"""Columns that are errors of a controller, planned minus measured positions: they have the positions' own noise.

What is planned is smooth, so that the roughness of the error is that of the measured position, with the sign turned or
not: encoder steps of the one are those of the other. Torques have it in another size.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

# Least correlation of the roughness of an error and of its position, and the share by which their sizes differ at most.
_ALIKE, _OF_ONE_SIZE = 0.98, 0.02
# Largest size of an error, as a share of its position's.
_SMALL = 0.2


def errors_among(rows: NDArray[np.float64], columns: Iterable[int], positions: Sequence[int]) -> set[int]:
    """Which columns are errors of one of the positions, that is itself none.

    Args:
        rows: all columns, (columns, n).
        columns: numbers of those that are asked for, which may be among the positions.
        positions: numbers of those that may be measured.
    """
    rough = {k: np.diff(rows[k], 4) for k in {*columns, *positions}}
    size = {k: float(np.std(rows[k])) for k in rough}

    def of(k: int, j: int) -> bool:
        own, whole = float(rough[k] @ rough[k]), float(rough[j] @ rough[j])
        if k == j or size[k] >= _SMALL * size[j] or not own or not whole:
            return False
        both = abs(float(rough[k] @ rough[j]))
        return both > _ALIKE * np.sqrt(own * whole) and abs(both / whole - 1.0) < _OF_ONE_SIZE

    return {k for k in columns if any(of(k, j) for j in positions)}


def smaller_half(rows: NDArray[np.float64], positions: Sequence[int]) -> set[int]:
    """Those of the positions, the first or the second half, that are all far smaller than the others: errors of these.

    For a table whose torques are enough for the other half alone.
    """
    half, odd = divmod(len(positions), 2)
    if odd or not half:
        return set()
    sizes = rows[list(positions)].std(axis=1)
    for small, large in ((slice(half, None), slice(half)), (slice(half), slice(half, None))):
        if (sizes[small] < _SMALL * sizes[large]).all():
            return set(positions[small])
    return set()
