"""The least-squares solution on the triangle, and what the textbooks say of its deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid.errors import TooFewRowsError, UnexcitedError
from haptid.estimation.knowledge import Knowledge
from haptid.observation.observation import Observation
from haptid.observation.r_factor import triangle

# A direction of the scaled parameters that carries less than this share of the largest one is not in the log.
EXCITED = 1e-10


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares with given motor weights.

    Attributes:
        beta: base parameters, (p,), SI; those held at zero are 0.
        R: triangle of the weighted rows in the k directions that nothing fixes, (k, k): the parameters themselves,
            without those held at zero, where nothing else is known exactly.
        root: those directions times the inverse of R: root root' is (W'W)^-1, (p, k).
        rest: norm of the weighted residual.
        dof: rows less free directions.
        pull: of knowledge with deviations, its rows in the coordinates of `root`, (known, k); None where there is none.
    """

    beta: Array
    R: Array
    root: Array
    rest: float
    dof: int
    pull: Array | None = None

    def classical_covariance(self, unit_residual: bool) -> Array:
        """Covariance if the residual were white, (p, p).

        Args:
            unit_residual: the weights were one over the deviations (WLS), so the weighted residual has unit
                variance; otherwise it is estimated from the residual (Janot et al. 2007, eqs 15 and 16).
        """
        variance = 1.0 if unit_residual else self.rest**2 / self.dof
        return np.asarray(variance * self.root @ self.root.T)


def solve(
    observation: Observation, weights: Array, zero: Sequence[int] = (), known: Knowledge | None = None
) -> Solution:
    """Minimise the norm of the rows, each motor's multiplied by its weight.

    Args:
        observation: the rows.
        weights: of each motor's rows, (motors,).
        zero: indices of base parameters that are held at zero.
        known: of other combinations; those with a deviation count as rows in its units.

    Raises:
        TooFewRowsError: fewer rows than parameters.
        UnexcitedError: the log leaves a direction of the parameters in the dark.
    """
    p = len(observation.base)
    kept = [k for k in range(p) if k not in zero]
    known = known or Knowledge.nothing(p)
    if observation.rows <= len(kept):
        raise TooFewRowsError(observation.rows, len(kept))
    start, free = directions(known, kept)
    change = np.zeros((p + 1, free.shape[1] + 1))
    change[:p, :-1], change[:p, -1], change[p, -1] = free, -start, 1.0
    own = known.rows @ change
    whole = triangle(np.concatenate([observation.stack(weights) @ change, own]))
    R, z, rest = whole[:-1, :-1], whole[:-1, -1], abs(float(whole[-1, -1]))
    check_excited([observation.base.names[int(np.argmax(np.abs(d)))] for d in free.T], R)
    inverse = linalg.solve_triangular(R, np.eye(len(R)))
    beta = start + free @ linalg.solve_triangular(R, z)
    pull = own[:, :-1] @ inverse if len(own) else None
    return Solution(beta, R, free @ inverse, rest, observation.rows - len(R), pull)


def directions(known: Knowledge, kept: Sequence[int]) -> tuple[Array, Array]:
    """Parameters that meet what is known exactly, (p,), and directions in which they stay free to move, (p, k).

    The directions are the kept parameters themselves where no combination of them is known.
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
    """Raise UnexcitedError, naming the parameter the log says least about, where R is as good as singular."""
    lengths = np.linalg.norm(R, axis=0)
    if (lengths == 0).any():
        raise UnexcitedError(names[int(np.argmin(lengths))], 0.0, EXCITED)
    _, singular, directions = np.linalg.svd(R / lengths)
    ratio = float(singular[-1] / singular[0])
    if ratio < EXCITED:
        raise UnexcitedError(names[int(np.argmax(np.abs(directions[-1])))], ratio, EXCITED)
