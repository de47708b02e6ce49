"""Normal equations and scores of blocks of rows, and what their leverage does to them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Leverage above which a block alone determines a direction: without it the fit is singular.
ALONE = 1.0 - 1e-6
# A combination depends on such a block when this share of its variance lies in that direction.
MOSTLY = 0.1
# Blocks processed at a time, so that intermediate arrays stay in the caches.
BATCH = 32
# Blocks of at most this leverage (Frobenius norm) are corrected by a binomial series instead of eigenvalues.
LOW_LEVERAGE = 0.5
# Relative size of the terms of that series that are dropped.
_NEGLIGIBLE = 1e-13


@dataclass(frozen=True, eq=False)
class Adjustment:
    """(1 - G)^-1/2 of every block, the CR2 correction of its residual for its leverage.

    Attributes:
        G: (blocks, k, k).
        heavy: blocks of high leverage, as indices.
        roots: of those, (heavy, k, k).
        eigen: eigenvalues (heavy, k) and eigenvectors of their G.
    """

    G: Array
    heavy: np.ndarray
    roots: Array
    eigen: tuple[Array, Array]

    @staticmethod
    def of(G: Array) -> Adjustment:
        """Of the blocks' matrices."""
        heavy = np.flatnonzero(np.einsum("bij,bij->b", G, G) > LOW_LEVERAGE**2)
        values, vectors = np.linalg.eigh(G[heavy])
        scale = (1.0 - np.minimum(values, ALONE)) ** -0.5
        roots = (vectors * scale[:, None, :]) @ vectors.transpose(0, 2, 1)
        return Adjustment(G, heavy, roots, (values, vectors))

    def times(self, s: Array) -> Array:
        """Times a vector of each block, (blocks, k); the binomial series for blocks of low leverage."""
        total, term, n = s.copy(), s, 1
        light = np.ones(len(s), dtype=bool)
        light[self.heavy] = False
        while np.abs(term[light]).max(initial=0.0) > _NEGLIGIBLE * np.abs(total[light]).max(initial=0.0):
            term = np.einsum("bij,bj->bi", self.G, term) * ((2 * n - 1) / (2 * n))
            total, n = total + term, n + 1
        total[self.heavy] = np.einsum("bij,bj->bi", self.roots, s[self.heavy])
        return total

    def carried(self, combinations: Array) -> Array:
        """G (1 - G)^-1/2 times combinations (q, k), (blocks, k, q); second order in G for blocks of low leverage."""
        once = self.G @ combinations.T
        carried = once + 0.5 * self.G @ once
        carried[self.heavy] = self.G[self.heavy] @ (self.roots @ combinations.T)
        return carried


@dataclass(frozen=True, eq=False)
class BlockMoments:
    """Normal equations and scores of each block of rows, in coordinates g with beta = root g, in which the sum is 1.

    sum G + pull'pull is the unit matrix; the scores s add up to zero.

    Attributes:
        G: W'W of each cell, (cells, k, k); a cell is one block of one motor, or of all motors.
        s: W'e of each cell, its score, (cells, k).
        block: of each cell, (cells,).
    """

    G: Array
    s: Array
    block: np.ndarray

    @cached_property
    def adjustment(self) -> Adjustment:
        """For the leverage of each cell."""
        return Adjustment.of(self.G)

    def with_scores(self, s: Array) -> BlockMoments:
        """Other scores of the same cells, (cells, k); the adjustment, which they do not change, is shared."""
        made = BlockMoments(self.G, s, self.block)
        vars(made)["adjustment"] = self.adjustment
        return made

    @cached_property
    def _high_leverage(self) -> tuple[np.ndarray, Array, Array]:
        """Cells that may determine a direction alone; eigenvalues (heavy, k) and eigenvectors in columns of their G.

        No eigenvalue is larger than the Frobenius norm, so most cells need no eigendecomposition.
        """
        cells = np.flatnonzero(np.einsum("bij,bij->b", self.G, self.G) > ALONE**2)
        values, vectors = np.linalg.eigh(self.G[cells])
        return cells, values, vectors

    @cached_property
    def leave_out_shifts(self) -> Array:
        """Change of g when each cell is left out, with opposite sign, (1 - G)^-1 s, (cells, k)."""
        heavy, values, vectors = self._high_leverage
        light = np.setdiff1d(np.arange(len(self.s)), heavy)
        shrink = 1.0 / (1.0 - np.minimum(values, ALONE))
        shifts = np.empty_like(self.s)
        shifts[heavy] = np.einsum("bij,bj->bi", vectors, np.einsum("bij,bi->bj", vectors, self.s[heavy]) * shrink)
        eye = np.eye(self.s.shape[1])
        for batch in np.array_split(light, 1 + len(light) // BATCH):
            shifts[batch] = np.linalg.solve(eye - self.G[batch], self.s[batch, :, None])[..., 0]
        return shifts

    def alone(self, combinations: Array, known: tuple[Array, Array] | None = None) -> np.ndarray:
        """Combinations (q, k) of g that only a single cell excites, as indices.

        Args:
            combinations: (q, k).
            known: eigenvalues (cells, k) and eigenvectors of the G of all cells of high leverage, if they have been
                computed.
        """
        values, vectors = known or self._high_leverage[1:]
        cells = np.flatnonzero((values > ALONE).any(axis=1))
        single = np.where(values[cells, None] > ALONE, np.abs(combinations @ vectors[cells]), 0.0)
        return np.flatnonzero(((single**2).sum(axis=2) > MOSTLY * (combinations**2).sum(axis=1)).any(axis=0))

    def shares(self, combinations: Array) -> Array:
        """Share of each cell in the information on combinations (q, k) of g, (cells, q)."""
        return np.asarray(np.einsum("bqj,qj->bq", combinations @ self.G, combinations))
