"""Honest intervals: leave out one motor's second at a time, and see how far the estimate moves.

Residuals in this field are serially correlated, so deviations that take them as white are far too small. The
delete-one-block jackknife (CR3 of Bell and McCaffrey 2002, Survey Methodology 28) needs only the triangles of the
blocks, whatever the number of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._values import Array
from haptid.estimators.solve import Solution
from haptid.observation import Observation

# A block that alone carries more than this share of a direction cannot be left out: without it nothing is left.
ALONE = 1.0 - 1e-6
# A parameter leans on such a block when this much of its variance is in that direction.
MOSTLY = 0.1
# With fewer effective blocks than this an interval means nothing; Student's t is held here.
LEAST_FREEDOM = 2.0


@dataclass(frozen=True, eq=False)
class Jackknife:
    """What leaving out blocks says.

    Attributes:
        covariance: of the base parameters, or of combinations of them, (p, p).
        freedom: degrees of freedom of the t interval of each, (p,).
        blocks: how many blocks of rows there were.
        alone: those that lean on a single block, as indices, (k,).
    """

    covariance: Array
    freedom: Array
    blocks: int
    alone: np.ndarray


def jackknife(
    observation: Observation, weights: Array, solution: Solution, combinations: Array | None = None
) -> Jackknife:
    """Covariance by leaving out each block of each motor in turn.

    Degrees of freedom are Satterthwaite's, from how evenly the blocks carry a parameter: (sum l)^2 / sum l^2 - 1.

    Args:
        observation: the rows.
        weights: of each motor's rows, (motors,).
        solution: the fit with these weights.
        combinations: of base parameters, (q, p), in whose place the result is; each base parameter by itself where
            left out.
    """
    inverse = solution.root
    spread = inverse if combinations is None else combinations @ inverse
    q = len(spread)
    variance = (spread**2).sum(axis=1)
    outer, leverage, alone = np.zeros((q, q)), [], np.zeros(q, dtype=bool)
    for motor, weight in zip(observation.motors, weights, strict=True):
        T = motor.triangles[motor.rows > 0] * weight
        U = T[:, :, :-1] @ inverse[motor.columns]
        e = T[:, :, -1] - T[:, :, :-1] @ solution.beta[motor.columns]
        # Without block b: (I - U'U)^-1 U'e = U'(I - UU')^-1 e, in the smaller of the two sizes.
        values, vectors = np.linalg.eigh(U @ U.transpose(0, 2, 1))
        carried = np.einsum("bij,bik->bjk", vectors, U)
        lonely = np.where((values > ALONE)[:, :, None], carried, 0.0) @ spread.T
        alone |= ((lonely**2).sum(axis=1) > MOSTLY * variance).any(axis=0)
        shrink = 1.0 / (1.0 - np.minimum(values, ALONE))
        moved = np.einsum("bij,bi->bj", vectors, e) * shrink
        shift = np.einsum("bjk,bj->bk", carried, moved) @ spread.T
        outer += shift.T @ shift
        leverage.append(((U @ spread.T) ** 2).sum(axis=1))
    shares = np.concatenate(leverage)
    blocks = len(shares)
    squares = (shares**2).sum(axis=0)  # zero where a parameter is held at zero, which nothing can doubt
    freedom = np.divide(shares.sum(axis=0) ** 2, squares, out=np.full(q, np.inf), where=squares > 0) - 1.0
    return Jackknife(
        covariance=outer * (blocks - 1) / max(blocks, 1),
        freedom=np.maximum(freedom, LEAST_FREEDOM),
        blocks=blocks,
        alone=np.flatnonzero(alone),
    )
