"""Header of a matrix in a MAT file of level 4, which has no mark of its own at its beginning.

Source: MathWorks, MAT-File Format, Level 4: five 32-bit integers (type MOPT, rows, columns, imaginary flag, length of
the name), the name with a zero, and the numbers by columns. Recorders of real-time targets leave that zero out.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

HEADER_BYTES = 20
_LONGEST_NAME = 256
_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
# Numbers, a text, a sparse matrix.
_CLASSES = (0, 1, 2)


class Mat4Header(NamedTuple):
    """Header of a matrix: byte order, type of its numbers, whether it is real numbers or letters, and its sizes."""

    dtype: np.dtype[np.generic]
    real: bool
    text: bool
    rows: int
    columns: int
    name_bytes: int
    bytes: int


def is_mat4(head: bytes) -> bool:
    """Whether a file that begins so is of level 4: its first header is one, and a name follows."""
    found = mat4_header(head)
    if found is None:
        return False
    name = head[HEADER_BYTES : HEADER_BYTES + found.name_bytes]
    return len(name) == found.name_bytes and name.removesuffix(b"\0").decode("latin-1").isidentifier()


def mat4_header(head: bytes) -> Mat4Header | None:
    """The header that bytes begin with; None where they are none."""
    if len(head) < HEADER_BYTES:
        return None
    for machine, order in enumerate("<>"):
        mopt, rows, count, imaginary, length = struct.unpack(f"{order}5i", head[:HEADER_BYTES])
        kind, what = divmod(mopt - 1000 * machine, 10)
        sizes = min(rows, count) >= 0 and imaginary in (0, 1) and 0 < length <= _LONGEST_NAME
        if sizes and 0 <= kind < len(_TYPES) and what in _CLASSES:
            dtype = np.dtype(order + _TYPES[kind])
            total = rows * count * dtype.itemsize * (1 + imaginary)
            return Mat4Header(dtype, what == 0 and not imaginary, what == 1, rows, count, length, total)
    return None
