"""The least-squares solution on the triangle, and what the textbooks say of its deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._values import Array
from haptid.errors import TooFewRowsError, UnexcitedError
from haptid.observation import Observation

# A direction of the scaled parameters that carries less than this share of the largest one is not in the log.
EXCITED = 1e-10


@dataclass(frozen=True, eq=False)
class Solution:
    """Least squares with given motor weights.

    Attributes:
        beta: base parameters, (p,), SI.
        R: triangle of the weighted rows, (p, p).
        rest: norm of the weighted residual.
        freedom: rows less parameters.
    """

    beta: Array
    R: Array
    rest: float
    freedom: int

    def textbook_covariance(self, unit_residual: bool) -> Array:
        """Covariance if the residual were white, (p, p).

        Args:
            unit_residual: the weights were one over the deviations (WLS), so the weighted residual has unit
                variance; otherwise it is estimated from the residual (Janot et al. 2007, eqs 15 and 16).
        """
        inverse = linalg.solve_triangular(self.R, np.eye(len(self.R)))
        variance = 1.0 if unit_residual else self.rest**2 / self.freedom
        return np.asarray(variance * inverse @ inverse.T)


def solve(observation: Observation, weights: Array) -> Solution:
    """Minimise the norm of the rows, each motor's multiplied by its weight.

    Raises:
        TooFewRowsError: fewer rows than parameters.
        UnexcitedError: the log leaves a direction of the parameters in the dark.
    """
    p = len(observation.base)
    if observation.rows <= p:
        raise TooFewRowsError(observation.rows, p)
    whole = observation.stack(weights)
    R, z, rest = whole[:-1, :-1], whole[:-1, -1], abs(float(whole[-1, -1]))
    check_excited(observation, R)
    return Solution(linalg.solve_triangular(R, z), R, rest, observation.rows - p)


def check_excited(observation: Observation, R: Array) -> None:
    """Raise UnexcitedError, naming the parameter the log says least about, where R is as good as singular."""
    lengths = np.linalg.norm(R, axis=0)
    names = observation.base.names
    if (lengths == 0).any():
        raise UnexcitedError(names[int(np.argmin(lengths))], 0.0, EXCITED)
    _, singular, directions = np.linalg.svd(R / lengths)
    ratio = float(singular[-1] / singular[0])
    if ratio < EXCITED:
        raise UnexcitedError(names[int(np.argmax(np.abs(directions[-1])))], ratio, EXCITED)
