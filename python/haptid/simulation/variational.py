"""Variational equations of joints that springs alone move, at many states at once."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array


def transitions(F: Array, h: float) -> Array:
    """Steps of the trapezoidal rule of s'' = F (s, s', 1): (s, s') of a step from the one before, change and offset.

    Args:
        F: by states and by parameters, (segments, steps, u, 2u + q).
        h: sampling period, s.

    Returns:
        (segments, steps - 1, 2u, 2u + q).
    """
    u, unit, before, after = F.shape[2], np.eye(F.shape[2]), F[:, :-1], F[:, 1:]
    ahead = 0.25 * h * h * after[..., :u]
    right = 0.5 * h * (before + after)
    right[..., u : 2 * u] = unit + 0.5 * h * before[..., u : 2 * u] + ahead
    made = np.empty((*right.shape[:2], 2 * u, right.shape[3]))
    left = unit - 0.5 * h * after[..., u : 2 * u] - ahead
    lower = made[..., u:, :] = inverses(left.reshape(-1, u, u)).reshape(left.shape) @ right
    np.multiply(0.5 * h, lower, out=made[..., :u, :])
    made[..., :u, :u] += unit
    made[..., :u, u : 2 * u] += 0.5 * h * unit
    return made


def inverses(matrices: Array) -> Array:
    """Of small matrices, (states, u, u), by Gauss-Jordan without pivots, all at once; with pivots where one is zero.

    Mass matrices need none; those of a poor step of a fit may.

    Raises:
        LinAlgError: one has no inverse.
    """
    A = np.array(matrices.transpose(1, 2, 0), order="C")  # a copy, also of one state
    with np.errstate(all="ignore"):
        for k in range(len(A)):
            pivot = 1 / A[k, k]
            row = A[k] * pivot
            row[k] = pivot
            column = A[:, k].copy()
            A[:, k] = 0.0
            A -= column[:, None] * row
            A[k] = row
    return A.transpose(2, 0, 1) if np.isfinite(A).all() else np.asarray(np.linalg.inv(matrices))


def states_first(columns: Array) -> Array:
    """(rows, ..., states) as (states, rows, columns)."""
    return np.ascontiguousarray(columns.reshape(len(columns), -1, columns.shape[-1]).transpose(2, 0, 1))
