"""Fits of columns added to a model one after another, with their CR2 covariance, from one factor of the model's rows.

The model's columns are the same in all of these fits. Their part of each fit is computed once (the theorem of Frisch,
Waugh and Lovell: the candidates' columns are replaced by what the model's do not explain), and so is the
eigendecomposition of each time block's leverage. An added column borders that diagonal matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, cached_property

import numpy as np
from scipy import linalg, special

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation.block_moments import ALONE, LOW_LEVERAGE
from haptid.estimation.intervals.cluster_robust import LEAST_DOF
from haptid.observation.observation import MotorRows, stacked
from haptid.observation.r_factor import r_factor

# Below 1 - ALONE, and exact in binary, as is one less it.
_SMALLEST = 2.0**-20
# Nodes of the inverse square root: its error is below 1e-12 from _SMALLEST to 1.
_NODES = 28


@cache
def _inverse_root() -> tuple[Array, Array]:
    """Nodes a and weights w, (nodes,), with x^-1/2 = sum w / (a + x) for x from _SMALLEST to 1.

    Source: Hale, Higham and Trefethen (2008), SIAM Journal on Numerical Analysis 46(5), method 3, section 4.
    """
    quarter = special.ellipkm1(_SMALLEST)
    sn, cn, dn, _ = special.ellipj((np.arange(_NODES) + 0.5) * quarter / _NODES, 1.0 - _SMALLEST)
    return _SMALLEST * (sn / cn) ** 2, 2 * quarter * np.sqrt(_SMALLEST) / (np.pi * _NODES) * dn / cn**2


@dataclass(frozen=True, eq=False)
class AddedFit:
    """A fit of the model's columns and some added ones.

    Attributes:
        values: of the added columns, (k,), SI.
        covariance, dof: CR2 over time blocks and its degrees of freedom, as `ClusterRobust`, (k, k) and (k,).
        shift: by how much the parameters of the model's columns change, (p,).
        beta: parameters of all columns, zero for those that are not in the fit.
    """

    values: Array
    covariance: Array
    dof: Array
    shift: Array
    beta: Array


@dataclass(frozen=True, eq=False)
class Bordered:
    """Rows of motors in the model's columns, and candidates for further columns.

    Attributes:
        kept: the model's columns, (p,), and `others`: the candidates' columns, (c,).
        factor: R factor of the weighted rows of [model, candidates, torque], (p + c + 1, p + c + 1).
        inverse: of its model's part, (p, p).
        leverage: eigenvalues of each time block's G, the model's W'W in coordinates in which the sum over all blocks
            is 1, (blocks, p), and `vectors`, its eigenvectors in columns, (blocks, p, p).
        cross: of each block, in the directions of these, the product with the candidates and the torque, both less
            what the model explains of them, (blocks, p, c + 1).
        left: these candidates and torque, (blocks, rows, c + 1).
        count: of all columns.
    """

    kept: np.ndarray
    others: np.ndarray
    factor: Array
    inverse: Array
    leverage: Array
    vectors: Array
    cross: Array
    left: Array
    count: int

    @staticmethod
    def of(motors: Sequence[MotorRows], weights: Array, kept: np.ndarray, others: np.ndarray) -> Bordered | None:
        """Of motors' rows; None where the model's columns are dependent.

        Args:
            motors: their `columns` are the model's and the candidates'.
            weights: of each motor's rows, (motors,).
            kept: columns of the model that are in the fits, (p,).
            others: the candidates' columns, (c,).
        """
        p, count = len(kept), 1 + max(int(max(own.columns, default=-1)) for own in motors)
        count = max(count, 1 + int(max(others, default=-1)))
        order = np.concatenate([kept, others, [count]]).astype(int)
        factor = r_factor(stacked(motors, weights, count)[:, order])
        if (np.diag(factor)[:p] == 0).any():
            return None
        inverse = linalg.solve_triangular(factor[:p, :p], np.eye(p))
        change = np.zeros((count + 1, len(order)))
        change[kept, :p], change[kept, p:] = inverse, -inverse @ factor[:p, p:]
        change[order[p:], range(p, len(order))] = 1.0
        own = [
            (motor.r_factors * (weight * (motor.rows > 0))[:, None, None]) @ change[np.append(motor.columns, count)]
            for motor, weight in zip(motors, weights, strict=True)
        ]
        rows = np.concatenate(own, axis=1)
        U, left = rows[:, :, :p], rows[:, :, p:]
        leverage, vectors = np.linalg.eigh(U.swapaxes(1, 2) @ U)
        cross = vectors.swapaxes(1, 2) @ (U.swapaxes(1, 2) @ left)
        return Bordered(kept, others, factor, inverse, np.maximum(leverage, 0.0), vectors, cross, left, count)

    def fit(self, columns: Sequence[int], independent: float) -> AddedFit | None:
        """With some of the candidates' columns; None where they are collinear with the model's.

        Args:
            columns: of the candidates.
            independent: least share of a column's length that the others do not explain.
        """
        p, k, at = len(self.kept), len(columns), np.searchsorted(self.others, columns)
        own = r_factor(np.column_stack([self.factor[p:, p + at], self.factor[p:, -1]]))
        R, explained = own[:k, :k], self.factor[:p, p + at]
        lengths = np.sqrt((explained**2).sum(axis=0) + (R**2).sum(axis=0))
        if (np.abs(np.diag(R)) <= independent * lengths).any():
            return None
        values = linalg.solve_triangular(R, own[:k, k])
        root = linalg.solve_triangular(R, np.eye(k))
        moved = explained @ values
        beta = np.zeros(self.count)
        beta[self.kept], beta[list(columns)] = self.inverse @ (self.factor[:p, -1] - moved), values
        covariance, dof = self._spread(at, values, root)
        return AddedFit(values, covariance, dof, -self.inverse @ moved, beta)

    def _spread(self, at: np.ndarray, values: Array, root: Array) -> tuple[Array, Array]:
        """CR2 covariance of the added columns' parameters, (k, k), and Satterthwaite degrees of freedom, (k,).

        Args:
            at: places of the columns among the candidates.
            values: their parameters, (k,).
            root: inverse of the R factor of what the model leaves of them, (k, k).
        """
        candidates = self.left[:, :, at]
        e = self.left[:, :, -1] - candidates @ values
        U = candidates @ root
        h, last = self.cross[:, :, at] @ root, U.swapaxes(1, 2) @ U
        first, second = self._corrected(h, last)
        s = self.cross[:, :, -1] - self.cross[:, :, at] @ values, np.einsum("brk,br->bk", U, e)
        scores = (np.einsum("bpk,bp->bk", first, s[0]) + np.einsum("blk,bl->bk", second, s[1])) @ root.T
        shares = np.einsum("qi,bij,qj->bq", root, last, root)
        dof = _freedom(shares, *self._carried(h, last, first, second, root))
        return scores.T @ scores, dof

    def _corrected(self, h: Array, last: Array) -> tuple[Array, Array]:
        """(1 - G)^-1/2 in the columns of the added directions: their part of the model, (blocks, p, k), and their own.

        Args:
            h, last: border of G, (blocks, p, k), and its corner, (blocks, k, k).
        """
        eye = np.eye(last.shape[-1])
        nodes, weights = (own[:, None, None, None] for own in _inverse_root())
        own = h * self._resolvents
        inner = weights * np.linalg.inv((nodes + 1.0) * eye - last - h.swapaxes(1, 2) @ own)
        first, second = (own @ inner).sum(axis=0), inner.sum(axis=0)
        for b in np.flatnonzero(self._alone(h, last)):
            G = np.block([[np.diag(self.leverage[b]), h[b]], [h[b].T, last[b]]])
            found, vectors = np.linalg.eigh(G)
            roots = (vectors * (1.0 - np.minimum(found, ALONE)) ** -0.5) @ vectors[-len(eye) :].T
            first[b], second[b] = roots[: -len(eye)], roots[-len(eye) :]
        return first, second

    @cached_property
    def _resolvents(self) -> Array:
        """1 / (a + 1 - leverage) at the nodes a of the inverse square root, (nodes, blocks, p, 1)."""
        nodes, _ = _inverse_root()
        return np.asarray(1 / (nodes[:, None, None, None] + 1.0 - self.leverage[:, :, None]))

    def _alone(self, h: Array, last: Array) -> np.ndarray:
        """Blocks that alone determine a direction, whose eigenvalues are limited, (blocks,)."""
        gap = ALONE - self.leverage
        heavy = (gap <= 0).any(axis=1)
        inner = ALONE * np.eye(last.shape[-1]) - last - h.swapaxes(1, 2) @ (h / np.where(gap > 0, gap, 1.0)[:, :, None])
        return np.asarray(heavy | (np.linalg.eigvalsh(inner)[:, 0] <= 0))

    def _carried(self, h: Array, last: Array, first: Array, second: Array, root: Array) -> tuple[Array, Array]:
        """G (1 - G)^-1/2 times the added parameters, as `Adjustment.carried`: the model's part and their own."""
        D = self.leverage[:, :, None]
        squares = (self.leverage**2).sum(axis=1) + 2 * (h**2).sum(axis=(1, 2)) + (last**2).sum(axis=(1, 2))
        light = (squares <= LOW_LEVERAGE**2)[:, None, None]
        turned = h.swapaxes(1, 2)
        series = h + 0.5 * (D * h + h @ last), last + 0.5 * (turned @ h + last @ last)
        upper = np.where(light, series[0], D * first + h @ second)
        lower = np.where(light, series[1], turned @ first + last @ second)
        return self.vectors @ (upper @ root.T), lower @ root.T


def _freedom(shares: Array, upper: Array, lower: Array) -> Array:
    """Degrees of freedom (tr P)^2 / tr P^2, (q,), as those of `ClusterRobust`.

    Args:
        shares: diagonal c'G c, (blocks, q).
        upper, lower: b of the blocks, (blocks, p, q) and (blocks, k, q), whose products are the rest of P.
    """
    b = np.concatenate([upper, lower], axis=1).transpose(2, 0, 1)
    pairs = (b @ b.swapaxes(1, 2)) ** 2
    squares = (shares**2).sum(axis=0) + pairs.sum(axis=(1, 2)) - np.einsum("qbb->q", pairs)
    effective = np.divide(shares.sum(axis=0) ** 2, squares, out=np.full(len(squares), np.inf), where=squares > 0)
    return np.asarray(np.maximum(effective, LEAST_DOF))
