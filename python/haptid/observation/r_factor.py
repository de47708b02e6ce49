"""R factors of QR decompositions (TSQR), and condition numbers."""

from __future__ import annotations

import math

import numpy as np

from haptid import _core
from haptid._internal.arrays import Array


def r_factor(rows: Array) -> Array:
    """R factor: the square upper triangle R with R'R = rows'rows, (..., columns, columns), of (..., many, columns)."""
    *stacks, count, columns = rows.shape
    flat = np.ascontiguousarray(rows, dtype=float).reshape(math.prod(stacks), count, columns)
    return _core.triangles(flat).reshape(*stacks, columns, columns)


def conditions(W: Array) -> tuple[float, float]:
    """Condition number of a matrix: as it is, and with its columns scaled to unit length."""
    return condition(W), scaled_condition(W)


def condition(W: Array) -> float:
    """Condition number of a matrix; infinite where it is singular."""
    singular = np.linalg.svd(W, compute_uv=False)
    return float(singular[0] / singular[-1]) if len(singular) and singular[-1] > 0 else float("inf")


def scaled_condition(W: Array) -> float:
    """Condition number of a matrix with its columns scaled to unit length."""
    lengths = np.linalg.norm(W, axis=0)
    return condition(W / np.where(lengths > 0, lengths, 1.0))
