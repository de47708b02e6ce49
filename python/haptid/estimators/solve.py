"""The least-squares solution on the triangle, and what the textbooks say of its deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._values import Array
from haptid.errors import TooFewRowsError, UnexcitedError
from haptid.observation import Observation, triangle

# A direction of the scaled parameters that carries less than this share of the largest one is not in the log.
EXCITED = 1e-10


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares with given motor weights.

    Attributes:
        beta: base parameters, (p,), SI; those held at zero are 0.
        R: triangle of the weighted rows of the k parameters that are not held at zero, (k, k).
        root: its inverse, with rows of zeros for those that are: root root' is (W'W)^-1, (p, k).
        rest: norm of the weighted residual.
        freedom: rows less parameters that are not held at zero.
    """

    beta: Array
    R: Array
    root: Array
    rest: float
    freedom: int

    def textbook_covariance(self, unit_residual: bool) -> Array:
        """Covariance if the residual were white, (p, p).

        Args:
            unit_residual: the weights were one over the deviations (WLS), so the weighted residual has unit
                variance; otherwise it is estimated from the residual (Janot et al. 2007, eqs 15 and 16).
        """
        variance = 1.0 if unit_residual else self.rest**2 / self.freedom
        return np.asarray(variance * self.root @ self.root.T)


def solve(observation: Observation, weights: Array, zero: Sequence[int] = ()) -> Solution:
    """Minimise the norm of the rows, each motor's multiplied by its weight.

    Args:
        observation: the rows.
        weights: of each motor's rows, (motors,).
        zero: indices of base parameters that are held at zero.

    Raises:
        TooFewRowsError: fewer rows than parameters.
        UnexcitedError: the log leaves a direction of the parameters in the dark.
    """
    p = len(observation.base)
    kept = [k for k in range(p) if k not in zero]
    if observation.rows <= len(kept):
        raise TooFewRowsError(observation.rows, len(kept))
    whole = observation.stack(weights)
    if len(kept) < p:
        whole = triangle(whole[:, [*kept, p]])
    R, z, rest = whole[:-1, :-1], whole[:-1, -1], abs(float(whole[-1, -1]))
    check_excited([observation.base.names[k] for k in kept], R)
    beta, root = np.zeros(p), np.zeros((p, len(kept)))
    beta[kept] = linalg.solve_triangular(R, z)
    root[kept] = linalg.solve_triangular(R, np.eye(len(kept)))
    return Solution(beta, R, root, rest, observation.rows - len(kept))


def check_excited(names: Sequence[str], R: Array) -> None:
    """Raise UnexcitedError, naming the parameter the log says least about, where R is as good as singular."""
    lengths = np.linalg.norm(R, axis=0)
    if (lengths == 0).any():
        raise UnexcitedError(names[int(np.argmin(lengths))], 0.0, EXCITED)
    _, singular, directions = np.linalg.svd(R / lengths)
    ratio = float(singular[-1] / singular[0])
    if ratio < EXCITED:
        raise UnexcitedError(names[int(np.argmax(np.abs(directions[-1])))], ratio, EXCITED)
