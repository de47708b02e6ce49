"""Least squares on the R factor of the rows, with equality constraints and prior rows, and its classical covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.errors import IdentifiabilityError, NoRowsError
from haptid.observation.observation import Observation
from haptid.observation.r_factor import r_factor

# Least ratio of singular values of the R factor with unit columns: below it a direction is not excited.
EXCITED = 1e-10
# Part of a column, of unit length, that is not explained by others, below which it is not excited on its own.
_ON_ITS_OWN = 1e-7
# Share of a parameter in a direction that is not excited, above which its value is unknown.
_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Linear constraints and priors on base parameters, A beta = b, exact or with a standard deviation.

    Attributes:
        A: (m, p).
        b: (m,), SI.
        std: standard deviation of each, zero where it is exact, (m,).
    """

    A: Array
    b: Array
    std: Array

    def __post_init__(self) -> None:
        m = np.shape(self.b)[0]
        freeze_fields(self, "b", A=(m, None), std=(m,))

    @property
    def exact(self) -> tuple[Array, Array]:
        """The equality constraints, A and b."""
        return self.A[self.std == 0], self.b[self.std == 0]

    @property
    def rows(self) -> Array:
        """The priors as rows of unit variance, [A b] / sd, (k, p + 1)."""
        uncertain = self.std > 0
        return np.asarray(np.column_stack([self.A, self.b])[uncertain] / self.std[uncertain, None])

    @staticmethod
    def nothing(p: int) -> Knowledge:
        """No constraint and no prior on p base parameters."""
        return Knowledge(np.zeros((0, p)), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares solution for given motor weights.

    Attributes:
        beta: base parameters, (p,), SI; those fixed at zero are 0.
        R: R factor of the weighted rows in the k unconstrained directions, (k, k): without equality constraints these
            are the parameters themselves, without those fixed at zero.
        root: the directions times the inverse of R: root root' is (W'W)^-1, (p, k).
        rest: norm of the weighted residual.
        dof: residual degrees of freedom: rows less unconstrained directions.
        pull: prior rows in the coordinates of `root`, (known, k); None without a prior.
    """

    beta: Array
    R: Array
    root: Array
    rest: float
    dof: int
    pull: Array | None = None

    def classical_covariance(self, unit_residual: bool) -> Array:
        """Classical (nonrobust) covariance, valid for white residuals, (p, p).

        Args:
            unit_residual: the weights were one over the residual standard deviations (WLS), so the weighted residual
                has unit variance; otherwise it is estimated from the residual (Janot et al. 2007, eqs 15 and 16).
        """
        variance = 1.0 if unit_residual else self.rest**2 / self.dof
        return np.asarray(variance * self.root @ self.root.T)


def solve(
    observation: Observation, weights: Array, zero: Sequence[int] = (), known: Knowledge | None = None
) -> Solution:
    """Minimise the norm of the rows, each motor's multiplied by its weight, subject to constraints.

    Args:
        weights: of each motor's rows, (motors,).
        zero: indices of base parameters fixed at zero.
        known: equality constraints, and priors that count as rows of unit variance.

    Raises:
        NoRowsError: fewer rows than parameters.
        IdentifiabilityError: the motion does not excite a direction of the parameters.
    """
    p = len(observation.base)
    kept = [k for k in range(p) if k not in zero]
    known = known or Knowledge.nothing(p)
    if observation.rows <= len(kept):
        raise NoRowsError(
            f"{observation.rows} rows are not enough for {len(kept)} parameters.",
            found=observation.rows,
            limit=len(kept),
            advice="Record a longer motion"
            + (", or decimate less." if any(m.treatment.decimation > 1 for m in observation.motions) else "."),
        )
    start, free = directions(known, kept)
    change = np.zeros((p + 1, free.shape[1] + 1))
    change[:p, :-1], change[:p, -1], change[p, -1] = free, -start, 1.0
    own = known.rows @ change
    factor = r_factor(np.concatenate([observation.stack(weights) @ change, own]))
    R, z, rest = factor[:-1, :-1], factor[:-1, -1], abs(float(factor[-1, -1]))
    check_excited([observation.base.names[int(np.argmax(np.abs(d)))] for d in free.T], R)
    inverse = linalg.solve_triangular(R, np.eye(len(R)))
    beta = start + free @ linalg.solve_triangular(R, z)
    pull = own[:, :-1] @ inverse if len(own) else None
    return Solution(beta, R, free @ inverse, rest, observation.rows - len(R), pull)


def directions(known: Knowledge, kept: Sequence[int]) -> tuple[Array, Array]:
    """A point that satisfies the equality constraints, (p,), and a basis of their null space, (p, k).

    The basis is that of the kept parameters themselves where there is no constraint.
    """
    p = known.A.shape[1]
    free = np.eye(p)[:, kept]
    A, b = known.exact
    if not len(b):
        return np.zeros(p), free
    sizes = np.linalg.norm(A[:, kept], axis=1)
    A, b = A[:, kept] / sizes[:, None], b / sizes
    return free @ np.linalg.lstsq(A, b, rcond=None)[0], free @ linalg.null_space(A)


def check_excited(names: Sequence[str], R: Array) -> None:
    """Raise IdentifiabilityError, naming the least excited parameter, where R is numerically singular."""
    k, ratio = weakest_direction(R)
    if ratio < EXCITED:
        raise IdentifiabilityError(
            f"base parameter {names[k]} is not excited by this log: the ratio of singular values of the regressor is "
            f"{ratio:.1e} (limit {EXCITED:.1e}).",
            where=names[k],
            found=ratio,
            limit=EXCITED,
            advice="Record motion that moves its link, or leave the term out of the device file.",
        )


def weakest_direction(R: Array) -> tuple[int, float]:
    """The least excited column of an R factor with columns of unit length, and its ratio of singular values.

    The column with the largest part in the last singular vector; a zero column, and 0, where there is one.
    """
    lengths = np.linalg.norm(R, axis=0)
    if not lengths.all():
        return int(np.argmin(lengths)), 0.0
    _, singular, directions = np.linalg.svd(R / lengths)
    return int(np.argmax(np.abs(directions[-1]))), float(singular[-1] / singular[0])


def unexcited(R: Array) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Columns of an R factor to leave out so that the others are independent, and those whose parameters are unknown.

    Unknown are those left out and all that share a direction with them.
    """
    lengths = np.linalg.norm(R, axis=0)
    unit = R / np.where(lengths > 0, lengths, 1.0)
    _, triangular, order = linalg.qr(unit, pivoting=True, mode="economic")
    sizes = np.abs(np.diag(triangular))
    rank = int((sizes > _ON_ITS_OWN * max(sizes[0], np.finfo(float).tiny)).sum())
    if rank == len(order):
        return (), ()
    shared = linalg.solve_triangular(triangular[:rank, :rank], triangular[:rank, rank:])
    unknown = [*order[rank:], *order[:rank][(np.abs(shared) > _SHARE).any(axis=1)]]
    return tuple(sorted(map(int, order[rank:]))), tuple(sorted(map(int, unknown)))


def untold(R: Array, combinations: Array) -> np.ndarray:
    """Combinations of parameters, (q, p), that an R factor's rows do not tell, as indices."""
    lengths = np.linalg.norm(R, axis=0)
    scale = 1.0 / np.where(lengths > 0, lengths, 1.0)
    _, sizes, directions = np.linalg.svd(R * scale)
    open_ones = directions[sizes <= _ON_ITS_OWN * max(sizes[0], np.finfo(float).tiny)]
    # Of a column that is zero the unit is arbitrary; any part in it is a part in what is not told.
    wide = combinations * scale
    return np.flatnonzero(np.abs(wide @ open_ones.T).max(axis=1, initial=0.0) > _SHARE * np.abs(wide).max(axis=1))
