"""`Clusters`: the score of each time block of a fit, apart from the rows: for joint tests of several estimates."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.estimation.block_moments import Adjustment
from haptid.estimation.method import Fit

# Blocks whose motion is alike are at most this many groups, and at least a third of the blocks.
_GROUPS = 3
_PASSES = 20


@dataclass(frozen=True, eq=False)
class Clusters:
    """Scores and information of the time blocks of a fit, over all motors.

    In coordinates g with beta = root g, in which the information of all blocks is the unit matrix.

    Attributes:
        root: (p, k).
        G, s: information and score of each block, (blocks, k, k) and (blocks, k).
        shifts: by how much one standard error of each nuisance moves the base parameters, (n, p), SI.
        misfit_shifts: by how much terms that the model lacks would, (m, p), SI: standard errors in comparisons alone.
        moved: the part of `s` by nuisances that are estimated from the same rows, (blocks, k); None without any.
    """

    root: Array
    G: Array
    s: Array
    shifts: Array
    misfit_shifts: Array
    moved: Array | None = None

    def __post_init__(self) -> None:
        k = self.root.shape[1]
        freeze_fields(self, "root", "shifts", "misfit_shifts", G=(len(self.s), k, k), s=(None, k))

    @staticmethod
    def of(fit: Fit, shifts: Array) -> Clusters:
        """Of a fit, and the shifts of its nuisances, (n, p)."""
        moments = fit.pooled_moments
        root, moved = fit.solution.root, fit.moved_scores
        none = np.zeros((0, len(root)))
        return Clusters(root, moments.G, moments.s, shifts, none, None if moved is None else moved[moments.block])

    def __len__(self) -> int:
        return len(self.s)

    @cached_property
    def information(self) -> Array:
        """Inverse of the covariance that white residuals of unit variance would give, (p, p)."""
        inverse = np.linalg.pinv(self.root)
        return freeze(inverse.T @ inverse)

    @cached_property
    def _adjusted(self) -> tuple[Adjustment, Array]:
        adjustment = Adjustment.of(self.G)
        return adjustment, adjustment.times(self.s)

    def covariance(self, C: Array) -> Array:
        """CR2 covariance of combinations C (q, p), with the nuisances, (q, q)."""
        scores, moved = self._adjusted[1] @ (C @ self.root).T, self.shifts @ C.T
        return np.asarray(scores.T @ scores + moved.T @ moved)

    def freedom(self, C: Array) -> float:
        """Degrees of freedom of the Wishart distribution that the covariance of combinations (q, p) has nearly.

        With M_gh the covariance of the scores of blocks g and h of independent rows, in units of their sum,
        q (q + 1) / sum_gh [(tr M_gh)^2 + tr M_gh M_gh]; for a single combination it is Satterthwaite's.

        Source: Pustejovsky and Tipton (2018), Journal of Business and Economic Statistics 36(4), eq. (15), HTZ.
        """
        own = C @ self.root
        own = np.linalg.solve(np.linalg.cholesky(own @ own.T), own)
        b = self._adjusted[0].carried(own)
        squares = 0.0
        for g in range(len(b)):
            M = -np.einsum("ka,hkb->hab", b[g], b)
            M[g] = own @ self.G[g] @ own.T
            squares += float(np.sum(np.einsum("haa->h", M) ** 2) + np.einsum("hab,hba->", M, M))
        q = len(own)
        return q * (q + 1) / squares

    @cached_property
    def misfit(self) -> float:
        """Factor on the covariance for errors of the model that come back with the motion, at least 1.

        Noise of blocks of like motion is independent; errors of the model have the same sign in them. So the scores are
        summed over groups of blocks whose information is alike, and their square is compared with that of single
        blocks: one where there is only noise, the mean number of blocks in a group where there is only misfit. What
        moves with nuisances is not counted: it has few directions, and single groups of blocks would decide.
        """
        groups = alike(self.G, max(2, len(self) // _GROUPS))
        if len(np.unique(groups)) < 2:
            return 1.0
        own = self.s if self.moved is None else self.s - self.moved
        single = self._adjusted[0].times(own)
        count = groups.max() + 1
        G, s = np.zeros((count, *self.G.shape[1:])), np.zeros((count, own.shape[1]))
        np.add.at(G, groups, self.G)
        np.add.at(s, groups, own)
        joined = Adjustment.of(G).times(s)
        return max(1.0, float(np.sum(joined**2) / max(np.sum(single**2), np.finfo(float).tiny)))

    def save(self, path: Path) -> None:
        """Write to a file, of the information the R factor."""
        upper = np.triu_indices(self.root.shape[1])
        np.savez_compressed(
            path,
            root=self.root,
            G=self.G[:, *upper],
            s=self.s,
            shifts=self.shifts,
            misfit_shifts=self.misfit_shifts,
            moved=np.zeros((0, self.root.shape[1])) if self.moved is None else self.moved,
        )

    @staticmethod
    def load(path: Path) -> Clusters:
        """Read such a file.

        Raises:
            OSError, ValueError, KeyError: it is none.
        """
        with np.load(path, allow_pickle=False) as file:
            names = ("root", "G", "s", "shifts", "misfit_shifts")
            root, packed, s, shifts, misfit = (np.asarray(file[name], dtype=float) for name in names)
            moved = np.asarray(file["moved"], dtype=float) if "moved" in file else s[:0]
        k = root.shape[1]
        upper = np.triu_indices(k)
        G = np.zeros((len(packed), k, k))
        G[:, *upper] = packed
        G = G + np.triu(G, 1).transpose(0, 2, 1)
        return Clusters(root, G, s, shifts, misfit, moved if len(moved) else None)


def alike(G: Array, groups: int) -> np.ndarray:
    """Group of each block, (blocks,): k-means of the information of the parameters, relative to its mean.

    Source: Lloyd (1982), IEEE Transactions on Information Theory 28(2), from evenly spaced blocks.
    """
    shares = np.sqrt(np.maximum(np.einsum("bii->bi", G), 0.0))
    shares = shares / np.maximum(shares.mean(axis=0), np.finfo(float).tiny)
    centres = shares[np.linspace(0, len(shares) - 1, groups).astype(int)]
    group = np.zeros(len(shares), dtype=int)
    for _ in range(_PASSES):
        far = ((shares[:, None] - centres[None]) ** 2).sum(axis=2)
        group = np.argmin(far, axis=1)
        for k in np.unique(group):
            centres[k] = shares[group == k].mean(axis=0)
    return np.unique(group, return_inverse=True)[1]
