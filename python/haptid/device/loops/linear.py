"""Loop closure with constant rates, q_tree = G qa + offset, as of parallelograms, and the search for such motions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.loops.chain import Chain, close_cuts
from haptid.device.parts import Cut

# Poses of the active joints, and starts of the passive ones at each, from which solutions are sought.
REFERENCES = 8
_STARTS = 64
# A singular value of the cuts' Jacobian by the passive joints below this, relative to the largest, is zero.
_RANK_TOLERANCE = 1e-7
# Two solutions whose constants and rates differ by less than this are one.
_SAME = 1e-4


@dataclass(frozen=True, eq=False)
class Followed:
    """Positions of all joints, and the Jacobian of these by the active ones.

    Attributes:
        q: positions of all joints, (joints, samples), rad or m.
        G: dq/dqa, (joints, active) where it is constant, else (samples, joints, active).
        Gd: its rate of change with time, the same shape.
    """

    q: Array
    G: Array
    Gd: Array

    def velocity(self, qda: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples)."""
        return _times(self.G, qda)

    def acceleration(self, qda: Array, qdda: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones' velocity and acceleration."""
        return _times(self.G, qdda) + _times(self.Gd, qda)

    def by(self, B: Array) -> Followed:
        """The same with rates by coordinates c = B qa, B being (active, active)."""
        if (np.eye(len(B)) == B).all():
            return self
        to_joints = np.linalg.inv(B)
        return Followed(self.q, self.G @ to_joints, self.Gd @ to_joints)


def _times(G: Array, x: Array) -> Array:
    return np.asarray(G @ x if G.ndim == 2 else np.einsum("sja,as->js", G, x))


@dataclass(frozen=True, eq=False)
class Closure:
    """Loop closure with constant rates: q_tree = G qa + offset.

    Attributes:
        G: (joints, active).
        offset: (joints,), rad or m.
        error: greatest closure error over random poses, m; 0 without cuts.
        relations: as text, such as "q3 = pi/2 - q2 + q7", one for each passive joint.
        cuts: the joints that were cut.
    """

    G: Array
    offset: Array
    error: float
    relations: tuple[str, ...]
    cuts: tuple[Cut, ...]

    def __post_init__(self) -> None:
        freeze_fields(self, "G", offset=(self.G.shape[0],))

    @property
    def constant(self) -> Array:
        """Constant rates, (joints, active)."""
        return self.G

    @property
    def varying(self) -> np.ndarray:
        """Which rates vary with the pose, (joints, active): none."""
        return np.zeros(self.G.shape, dtype=bool)

    def positions(self, qa: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples), rad or m."""
        return np.asarray(self.G @ qa + self.offset[:, None])

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities."""
        del qda
        return Followed(self.positions(qa), self.G, np.zeros_like(self.G))

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close, (samples,): at every pose."""
        return np.ones(qa.shape[1], dtype=bool)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random poses of the active joints over a full turn, ignoring limits, (active, count)."""
        return rng.uniform(-np.pi, np.pi, (self.G.shape[1], count))


@dataclass(frozen=True, eq=False)
class LinearMotion:
    """A linear motion, q_tree = G qa + offset, and a pose of the active joints at which it closes.

    Attributes:
        G, offset: (joints, active) and (joints,), rad or m.
        at: (active,), rad or m.
    """

    G: Array
    offset: Array
    at: Array


@dataclass(frozen=True, eq=False)
class LinearSearch:
    """Result of the search for linear motions.

    Attributes:
        closed: tangents of the motions that close at some pose.
        linear: distinct motions that close at all poses.
        free: number of directions of the passive joints that the cuts do not determine.
        best: least gap reached at the start pose, m.
        attempts: how, as text: the start pose, and the links that are furthest apart.
    """

    closed: tuple[LinearMotion, ...]
    linear: tuple[LinearMotion, ...]
    free: int
    best: float
    attempts: str


@dataclass(frozen=True, eq=False)
class ClosureProblem:
    """Cuts to close: what is known of the motion q_tree = G qa + offset, and where to start.

    Attributes:
        chain: the tree and its cuts.
        G, offset: motion of the joints already determined, (joints, active) and (joints,); rows of the unknown ones
            are ignored.
        unknown: indices of the joints that the cuts are to determine.
        guess: positions of passive joints near which to start, rad or m.
        start_pose: positions of the active joints to start from, (active,), rad or m.
    """

    chain: Chain
    G: Array
    offset: Array
    unknown: list[int]
    guess: Mapping[int, float]
    start_pose: Array

    def of(self, cuts: tuple[Cut, ...], unknown: list[int]) -> ClosureProblem:
        """The part of the problem that has some of the cuts and some of the unknown joints."""
        return replace(self, chain=Chain.of(self.chain.joints, cuts, self.chain.active), unknown=unknown)

    def with_motion(self, motion: LinearMotion) -> ClosureProblem:
        """The problem solved: all of its joints move by a linear motion."""
        return replace(self, G=motion.G, offset=motion.offset, unknown=[])


def find_linear_motions(problem: ClosureProblem, closed: float) -> LinearSearch:
    """Every linear motion of the unknown joints that closes the cuts at all poses.

    A linear motion is its own tangent: each solution found at some pose is extended along its tangent, and
    kept if that closes at all poses.

    Args:
        problem: cuts, motion of the joints already determined, and starts; random ones are added to these.
        closed: largest gap, in mechanism sizes.
    """
    chain, unknown = problem.chain, problem.unknown
    qa = np.repeat(np.vstack([chain.random_poses(REFERENCES, seed=0), problem.start_pose]), _STARTS, axis=0)
    q = qa @ problem.G.T + problem.offset
    q[:, unknown] = chain.random_starts(unknown, len(q), seed=0)
    q[::_STARTS, unknown] = [problem.guess.get(j, 0.0) for j in unknown]
    q = close_cuts(chain, q, unknown)
    gaps = np.abs(chain.residual(q)[0]).max(axis=1)
    closes = gaps < closed * chain.size
    tangents, free = _tangents(problem, q[closes], qa[closes])
    linear = [_polished(chain, motion, unknown) for motion in ([] if free else _lasting(chain, tangents))]
    linear = [motion for motion in linear if chain.gap(motion.G, motion.offset, 64) < closed * chain.size]
    if linear:
        slopes, constants = (np.array([getattr(m, part)[unknown] for m in linear]) for part in ("G", "offset"))
        linear = [linear[k] for k in _distinct(chain, unknown, slopes, constants)]
    best = len(q) - _STARTS + int(np.argmin(gaps[-_STARTS:]))
    attempts = chain.attempts(problem.start_pose, _STARTS, q[best])
    return LinearSearch(tuple(tangents), tuple(linear), free, float(gaps[best]), attempts)


def rates(chain: Chain, q: Array, G: Array, unknown: list[int]) -> tuple[Array, Array]:
    """Rates of the unknown joints, (n, unknown, active), and singular values of their Jacobian, (n, unknown)."""
    J = chain.residual(q)[1]
    others = G.copy()
    others[unknown] = 0.0
    U, singular, Vt = np.linalg.svd(J[:, :, unknown], full_matrices=False)
    kept = singular > _RANK_TOLERANCE * singular.max(axis=1, initial=0.0, keepdims=True)
    inverse = np.divide(1.0, singular, out=np.zeros_like(singular), where=kept)
    pseudo = Vt.swapaxes(1, 2) @ (inverse[:, :, None] * U.swapaxes(1, 2))
    return np.asarray(-pseudo @ (J @ others)), singular


def _tangents(problem: ClosureProblem, q: Array, qa: Array) -> tuple[list[LinearMotion], int]:
    """Distinct tangents at solutions, and how many directions of the unknown joints no solution determines."""
    chain, unknown = problem.chain, problem.unknown
    if not len(q):
        return [], 0
    slopes, singular = rates(chain, q, problem.G, unknown)
    free = (singular < _RANK_TOLERANCE * chain.size).sum(axis=1) + max(0, len(unknown) - singular.shape[1])
    at = np.flatnonzero(free == free.min())
    constants = q[at][:, unknown] - np.einsum("kua,ka->ku", slopes[at], qa[at])
    motions = []
    for k in at[_distinct(chain, unknown, slopes[at], constants)]:
        extended, constant = problem.G.copy(), problem.offset.copy()
        extended[unknown] = slopes[k]
        constant[unknown] = q[k, unknown] - slopes[k] @ qa[k]
        motions.append(LinearMotion(extended, constant, qa[k]))
    return motions, int(free.min())


def _lasting(chain: Chain, motions: list[LinearMotion]) -> list[LinearMotion]:
    """The motions that nearly close at some random poses."""
    if not motions:
        return []
    qa = chain.random_poses(4, seed=4)
    q = np.array([qa @ motion.G.T + motion.offset for motion in motions])
    gaps = np.abs(chain.residual(q.reshape(-1, q.shape[-1]))[0]).reshape(len(motions), -1).max(axis=1)
    return [motion for motion, gap in zip(motions, gaps, strict=True) if gap < 1e-3 * chain.size]


def _polished(chain: Chain, motion: LinearMotion, unknown: list[int]) -> LinearMotion:
    """The linear motion refitted to solutions at many poses, if it nearly closes there."""
    qa = chain.random_poses(64, seed=3)
    start = qa @ motion.G.T + motion.offset
    if np.abs(chain.residual(start)[0]).max() > 1e-3 * chain.size:
        return motion
    q = close_cuts(chain, start, unknown, steps=8)
    fit = np.linalg.lstsq(np.column_stack([qa, np.ones(len(qa))]), q[:, unknown], rcond=None)[0]
    G, offset = motion.G.copy(), motion.offset.copy()
    G[unknown], offset[unknown] = fit[:-1].T, fit[-1]
    return LinearMotion(G, offset, motion.at)


def _distinct(chain: Chain, unknown: list[int], slopes: Array, constants: Array) -> list[int]:
    """The first of each kind of motion, as indices; constants of revolute joints are compared modulo a turn.

    Args:
        chain: the tree and its cuts.
        unknown: indices of the joints that move.
        slopes: their rates, (motions, unknown, active).
        constants: (motions, unknown), rad or m.
    """
    turning = np.array([not chain.joints[j].prismatic for j in unknown])
    G = slopes.reshape(len(slopes), -1)
    left, first = np.ones(len(G), dtype=bool), []
    while left.any():
        k = int(np.argmax(left))
        first.append(k)
        alike = np.flatnonzero(left & (np.abs(G - G[k]).max(axis=1) < _SAME))
        difference = constants[alike] - constants[k]
        difference[:, turning] -= 2 * np.pi * np.rint(difference[:, turning] / (2 * np.pi))
        left[alike[np.abs(difference).max(axis=1) < _SAME]] = False
    return first
