"""Regression of rows on a few covariates, with the deviation from leaving out each block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array


@dataclass(frozen=True, eq=False)
class Slope:
    """Coefficients, and what leaving out blocks says of them.

    Attributes:
        value: (k,).
        se: (k,).
        dof: Satterthwaite's, from how evenly the blocks carry each, (k,).
    """

    value: Array
    se: Array
    dof: Array


def regress(X: Array, y: Array, block: np.ndarray) -> Slope | None:
    """Least squares y = X b, rows in blocks; None where blocks are too few to be left out.

    Args:
        X: (rows, k).
        y: (rows,).
        block: of each row, (rows,).
    """
    names, place = np.unique(block, return_inverse=True)
    k, many = X.shape[1], len(names)
    A, b = np.zeros((many, k, k)), np.zeros((many, k))
    np.add.at(A, place, X[:, :, None] * X[:, None, :])
    np.add.at(b, place, X * y[:, None])
    whole = A.sum(axis=0)
    if many <= k + 2 or np.linalg.matrix_rank(whole) < k:
        return None
    inverse = np.linalg.inv(whole)
    value = inverse @ b.sum(axis=0)
    without = np.linalg.pinv(whole - A) @ (b.sum(axis=0) - b)[:, :, None]
    shift = without[:, :, 0] - value
    leverage = np.einsum("ki,bij,jk->bk", inverse, A, inverse)
    dof = leverage.sum(axis=0) ** 2 / (leverage**2).sum(axis=0) - 1.0
    return Slope(value, np.sqrt((many - 1) / many * (shift**2).sum(axis=0)), np.maximum(dof, 2.0))
