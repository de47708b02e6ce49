"""Honest intervals: every second of the log asks the estimate to move, and how differently they ask is its deviation.

Residuals in this field are serially correlated, and motors share what the model lacks, so deviations that take the
rows as independent are far too small. A time block of all motors is taken as one draw. What the fit itself has taken
off a block's residual is given back (bias-reduced linearisation), and the few blocks there are cost degrees of freedom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation.fit import ALONE, Fit, Moments, together
from haptid.estimation.intervals.spread import Spread, believing
from haptid.estimation.least_squares import Solution
from haptid.observation.observation import Observation

# With fewer effective blocks than this an interval means nothing; Student's t is held here.
LEAST_FREEDOM = 2.0
# A block whose matrix has at most this Frobenius norm is summed as a series, which needs no eigenvalues.
LIGHT = 0.5
# Terms of that series below this share of the sum are left out.
NEGLIGIBLE = 1e-13


@dataclass(frozen=True)
class ClusterRobust:
    """The default: time blocks as clusters, all motors together.

    Source: Bell and McCaffrey (2002), Survey Methodology 28, CR2, with degrees of freedom after Pustejovsky and Tipton
    (2018), Journal of Business and Economic Statistics 36, section 3.2, for rows that are independent.
    """

    @property
    def name(self) -> str:
        return "CR2 over time blocks of all motors, Student t with Satterthwaite degrees of freedom"

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Covariance of base parameters, or of combinations (q, p) of them.

        Knowledge with a deviation adds its own variance, as if its value had been drawn with that deviation.
        """
        return _spread(fit.together, fit.combined(combinations), fit.solution.pull)


def clustered(
    observation: Observation, weights: Array, solution: Solution, combinations: Array | None = None
) -> Spread:
    """The same of rows and a solution of them.

    Args:
        observation: the rows.
        weights: of each motor's rows, (motors,).
        solution: the fit with these weights.
        combinations: of base parameters, (q, p), in whose place the result is; each base parameter by itself where
            left out.
    """
    spread = solution.root if combinations is None else combinations @ solution.root
    return _spread(together(observation, weights, solution), spread, solution.pull)


def _spread(made: Moments, spread: Array, pull: Array | None) -> Spread:
    """Of combinations (q, k) of the moments' coordinates."""
    adjusted = Adjustment.of(made.G)
    shifts = adjusted.times(made.s) @ spread.T
    covariance, degrees = believing(shifts.T @ shifts, dof(made, adjusted, spread), spread, pull)
    return Spread(covariance, degrees, len(made.s), made.alone(spread))


@dataclass(frozen=True, eq=False)
class Adjustment:
    """(1 - G)^-1/2 of every block: gives a block back what the fit has taken off its residual.

    Attributes:
        G: (blocks, k, k).
        heavy: blocks that carry much of a direction, as indices.
        roots: of those, (heavy, k, k).
    """

    G: Array
    heavy: np.ndarray
    roots: Array

    @staticmethod
    def of(G: Array) -> Adjustment:
        """Of the blocks' matrices."""
        heavy = np.flatnonzero(np.einsum("bij,bij->b", G, G) > LIGHT**2)
        values, vectors = np.linalg.eigh(G[heavy])
        scale = (1.0 - np.minimum(values, ALONE)) ** -0.5
        return Adjustment(G, heavy, (vectors * scale[:, None, :]) @ vectors.transpose(0, 2, 1))

    def times(self, s: Array) -> Array:
        """Times a vector of each block, (blocks, k): the binomial series of the light ones."""
        total, term, n = s.copy(), s, 1
        light = np.ones(len(s), dtype=bool)
        light[self.heavy] = False
        while np.abs(term[light]).max(initial=0.0) > NEGLIGIBLE * np.abs(total[light]).max(initial=0.0):
            term = np.einsum("bij,bj->bi", self.G, term) * ((2 * n - 1) / (2 * n))
            total, n = total + term, n + 1
        total[self.heavy] = np.einsum("bij,bj->bi", self.roots, s[self.heavy])
        return total

    def carried(self, spread: Array) -> Array:
        """G (1 - G)^-1/2 times combinations (q, k), (blocks, k, q); of light blocks to the second order of G."""
        once = self.G @ spread.T
        made = once + 0.5 * self.G @ once
        made[self.heavy] = self.G[self.heavy] @ (self.roots @ spread.T)
        return made


def dof(made: Moments, adjusted: Adjustment, spread: Array) -> Array:
    """Degrees of freedom (tr P)^2 / tr P^2 of combinations (q, k), (q,).

    P_gh is the covariance of what blocks g and h ask for where rows are independent: c'G c on the diagonal and
    -b_g'b_h beside it, b = G (1 - G)^-1/2 c.
    """
    own = made.shares(spread)
    b = adjusted.carried(spread)
    alone = np.einsum("bkq,bkq->bq", b, b)
    beside = np.array([((x.T @ x) ** 2).sum() for x in b.transpose(2, 0, 1)])
    squares = (own**2).sum(axis=0) + beside - (alone**2).sum(axis=0)
    # Zero where a parameter is held at zero, which nothing can doubt.
    effective = np.divide(own.sum(axis=0) ** 2, squares, out=np.full(len(squares), np.inf), where=squares > 0)
    return np.asarray(np.maximum(effective, LEAST_FREEDOM))
