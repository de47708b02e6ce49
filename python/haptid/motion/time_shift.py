"""Channels some samples later, a fraction of a sample too."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, freeze


def delayed(channels: Array, samples: float) -> Array:
    """Channels so many samples later, which may be a fraction, by cubic interpolation, each (n, channels).

    The first and last `lost(samples)` samples repeat their neighbours.
    """
    whole_part = int(np.floor(samples))
    x = samples - whole_part  # between the samples n - whole_part - 1 (1) and n - whole_part (0)
    weights = {
        -1: -x * (x - 1) * (x - 2) / 6,
        0: (x + 1) * (x - 1) * (x - 2) / 2,
        1: -(x + 1) * x * (x - 2) / 2,
        2: (x + 1) * x * (x - 1) / 6,
    }
    n, ends = len(channels), lost(samples)
    made = np.zeros((channels.shape[1], n))
    for channel, out in zip(channels.T, made, strict=True):
        padded = np.pad(channel, ends, mode="edge")
        for back, weight in weights.items():
            if weight:
                begin = ends - whole_part - back
                out += weight * padded[begin : begin + n]
    return freeze(made).T


def lost(samples: float) -> int:
    """Samples at each end that `delayed` has no neighbours for."""
    return int(np.ceil(abs(samples))) + 2 if samples else 0
