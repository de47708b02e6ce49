"""Arrays of Arrow as NumPy's."""

from __future__ import annotations

from typing import Any

import numpy as np


def numbers(values: Any) -> np.ndarray:
    """The values of an Arrow array, (n,); those that are missing are NaN.

    By its buffers where they hold numbers: `to_numpy` imports pandas where that is installed, which takes longer than
    most logs take to be read.
    """
    from pyarrow import types

    plain = types.is_integer(values.type) or types.is_float32(values.type) or types.is_float64(values.type)
    if not plain or not len(values):
        return np.asarray(values.to_numpy(zero_copy_only=False))
    there, content = values.buffers()
    part = slice(values.offset, values.offset + len(values))
    whole = np.frombuffer(content, dtype=values.type.to_pandas_dtype())[part]
    if not values.null_count:
        return whole
    known = np.unpackbits(np.frombuffer(there, np.uint8), bitorder="little")[part]
    return np.where(known, whole, np.nan)
