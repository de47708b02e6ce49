"""Filtering and decimation as a loop over windows would do it, and the filters that tests draw."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

FILTERS = st.sampled_from([(1, 1), (3, 1), (21, 1), (201, 10), (11, 50), (1, 7), (33, 4)])


def windows(signals, taps, first, decimation, rows):
    half = len(taps) // 2
    starts = first - half + decimation * np.arange(rows)
    return np.stack([np.tensordot(signals[..., s : s + len(taps)], taps, 1) for s in starts], axis=-1)
