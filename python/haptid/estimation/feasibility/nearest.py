"""Two questions to a cone: the most interior standard parameters of given base parameters, and the nearest possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid.estimation.feasibility.cone import Cone, Part
from haptid.estimation.feasibility.conic_program import Condition, minimise

# Margins are told in each link's own mass and length; above this one a body is as roomy as a ball.
ROOMY = 1.0
# Margins this small are the border's: nothing is to be chosen there.
BORDER = 1e-6
# Weight of the pull along directions that no torque shows, in a margin of one and in the torque's own weight of one.
WIDE_PULL = 1e-8
FIT_PULL = 1e-10
PASSES = 2
# Newton's steps to the centre, and the decrement at which it is reached.
MOST_STEPS = 200
CENTRED = 1e-9


@dataclass(frozen=True, eq=False)
class Interior:
    """How far inside the cone some base parameters can be.

    Attributes:
        x: scaled standard parameters, (n,).
        margins: the largest least eigenvalue of every part, (parts,); infinite where a part has no condition.
        multipliers: how much each block of the cone stands in the way, by part; each part's sum is at most one.
    """

    x: Array
    margins: Array
    multipliers: tuple[Array, ...]


def interior(cone: Cone, x: Array, settled: Sequence[Part] = ()) -> Interior:
    """The most interior scaled standard parameters with the base parameters of x, the parts one by one.

    The margin of a part is the largest t with every pseudo-inertia >= t and every term >= t, all scaled. Where there
    is room, the x of least divergence from the centre is taken: there is only one, and it is inside.

    Args:
        cone: the conditions.
        x: any scaled standard parameters with those base parameters, (n,).
        settled: parts of which x is to stay as it is.
    """
    x, margins, multipliers = np.array(x), [], []
    for part in cone.parts:
        step, margin, shares = still(part, x) if part in settled else widest(cone, part, x)
        if margin > BORDER and part.null.size and part not in settled:
            step = step + central(cone, part, x + step)
        x += step
        margins.append(margin)
        multipliers.append(shares)
    return Interior(x, np.array(margins), tuple(multipliers))


def still(part: Part, x: Array) -> tuple[Array, float, Array]:
    """No step, the margin of a part as it is, and the blocks that have no more than it."""
    margin = part.margin(x)
    return np.zeros_like(x), margin, np.array([float(block.margin(x) == margin) for block in part.blocks])


def widest(cone: Cone, part: Part, x: Array) -> tuple[Array, float, Array]:
    """The step of a part that makes its margin largest, the margin there, and the share of each block in it."""
    k = part.null.shape[1]
    if not (part.blocks and k):
        return still(part, x)
    conditions = [
        Condition(np.column_stack([block.G @ part.null, -block.inside]), block.G @ x, block.is_link)
        for block in part.blocks
    ]
    conditions.append(Condition(-np.eye(1, k + 1, k), np.array([ROOMY])))
    P = np.diag(np.append(np.full(k, WIDE_PULL), 0.0))
    q = np.append(WIDE_PULL * part.null.T @ (x - cone.centre), -1.0)
    v, z = minimise(P, q, conditions)
    step = part.null @ v[:-1]
    shares = np.array([block.inside @ zb for block, zb in zip(part.blocks, z, strict=False)])
    margin = part.margin(x + step)
    # On the border itself the solver may come out a rounding error below where it began.
    return (step, min(margin, ROOMY), shares) if margin > part.margin(x) else still(part, x)


def central(cone: Cone, part: Part, x: Array) -> Array:
    """From an x inside, the step of a part to the least divergence from the centre, sum of <C^-1, P> - log det P.

    P is every pseudo-inertia and term, C the centre's (the ball's, where the centre's is no body). Newton's method,
    damped as befits a self-concordant function, never leaves the cone.

    Sources: Lee, Wensing and Park (2020), IEEE Transactions on Robotics 36(2), for the divergence; Nesterov and
    Nemirovskii (1994), Interior-Point Polynomial Algorithms, for the damping.
    """
    pulls = [np.linalg.inv(block.matrix(block.home(cone.centre, cone.ball))) for block in part.blocks]
    y = np.zeros(part.null.shape[1])
    for _ in range(MOST_STEPS):
        slope, curve = np.zeros(len(y)), np.zeros((len(y), len(y)))
        for block, pull in zip(part.blocks, pulls, strict=True):
            inverse = np.linalg.inv(block.matrix(x + part.null @ y))
            directions = block.matrices(part.null)
            bent = inverse @ directions
            slope += np.einsum("ij,kji->k", pull - inverse, directions)
            curve += np.einsum("aij,bji->ab", bent, bent)
        step = -np.linalg.lstsq(curve, slope, rcond=None)[0]
        decrement = float(np.linalg.norm(step @ slope)) ** 0.5
        y += step / (1.0 + decrement)
        if decrement < CENTRED:
            break
    return np.asarray(part.null @ y)


def nearest(cone: Cone, R: Array, beta: Array) -> tuple[Array, Array]:
    """The x in the cone whose base parameters b are nearest to beta, |R (b - beta)| least, and the multipliers.

    Directions of x that no base parameter shows are pulled to the centre with `FIT_PULL`, so that there is only one x.
    A second pass pulls to where the first came out, so that b does not feel it, and counts in what the first left, so
    that a small distance has as many digits as a large one. Where only ever heavier bodies would come nearer without
    end, the pull is the end.

    Args:
        cone: the conditions.
        R: triangle of the metric, (p, p).
        beta: base parameters, (p,), SI.

    Returns:
        x, (n,), and for each of the cone's blocks how strongly it holds, (blocks,).
    """
    x, p = cone.start(beta), len(beta)
    size = float(np.linalg.norm(R @ beta)) or 1.0
    towards = cone.null.T @ (cone.centre - x)
    for _ in range(PASSES):
        # v = (r, y): x + to_x r + null y has base parameters beta + R^-1 r size. R'R would halve the digits.
        move = np.column_stack([cone.inverse @ linalg.solve_triangular(R, np.eye(p)) * size, cone.null])
        conditions = [Condition(b.G @ move, b.G @ x, b.is_link) for b in cone.blocks]
        weights = np.append(np.ones(p), np.full(len(towards), FIT_PULL))
        v, z = minimise(np.diag(weights), np.append(np.zeros(p), -FIT_PULL * towards), conditions)
        size, towards = size * (float(np.linalg.norm(v[:p])) or 1.0), v[p:]
    return cone.mended(x + move @ v), np.array([b.inside @ zb for b, zb in zip(cone.blocks, z, strict=True)])
