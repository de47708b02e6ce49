"""Closing cut joints numerically: many poses and many starts at once, by damped Gauss-Newton steps."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Cut, Frame, Joint

# Poses of the active joints, and starts of the passive ones at each, from which solutions are sought.
REFERENCES = 8
STARTS = 64
STEPS = 60
# A step shorter than this, rad (or m), is the last one.
SETTLED = 1e-12
# A direction of the passive joints that the cuts hold less than this, relatively, is free.
HELD = 1e-7
# Two solutions whose constants and rates differ by less than this are one.
SAME = 1e-4


@dataclass(frozen=True, eq=False)
class Branch:
    """A linear motion, q_tree = G qa + offset, and a pose of the active joints at which it closes.

    Attributes:
        G, offset: (joints, active) and (joints,), rad or m.
        at: (active,), rad or m.
    """

    G: Array
    offset: Array
    at: Array


@dataclass(frozen=True, eq=False)
class Search:
    """What was found.

    Attributes:
        closed: tangents of the motions that close at some pose.
        linear: distinct motions that close at all poses.
        free: directions of the passive joints that the cuts leave free.
        best: least gap that was reached, m.
        starts: number of starts.
    """

    closed: tuple[Branch, ...]
    linear: tuple[Branch, ...]
    free: int
    best: float
    starts: int


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree with the joints cut out of its loops.

    Attributes:
        joints: of the tree.
        cuts: joints cut.
        active: indices of the independent joints.
        size: longest of its lengths, m; orientations are weighed with it.
        above: whether joint k carries link j, (joints, joints).
    """

    joints: tuple[Joint, ...]
    cuts: tuple[Cut, ...]
    active: tuple[int, ...]
    size: float
    above: np.ndarray

    @staticmethod
    def of(joints: Sequence[Joint], cuts: tuple[Cut, ...], active: tuple[int, ...]) -> Chain:
        """Measure the tree."""
        frames = [frame for cut in cuts for frame in (cut.frame, cut.twin)]
        lengths = [np.linalg.norm(p) for p in (*(j.translation for j in joints), *(f.translation for f in frames))]
        above = np.eye(len(joints), dtype=bool)
        for j, joint in enumerate(joints):
            if joint.parent >= 0:
                above[j] |= above[joint.parent]
        return Chain(tuple(joints), cuts, active, float(max(lengths)) or 1.0, above)

    def independent(self, unknown: Sequence[int]) -> list[tuple[tuple[Cut, ...], list[int]]]:
        """Groups of cuts that share no unknown joint, each with the unknown joints between its frames."""
        groups: list[tuple[tuple[Cut, ...], set[int]]] = []
        for cut in self.cuts:
            one, other = (self._carriers(frame) for frame in (cut.frame, cut.twin))
            cuts: tuple[Cut, ...] = (cut,)
            joints = set(np.flatnonzero(one ^ other).tolist()) & set(unknown)
            for group in [group for group in groups if group[1] & joints]:
                groups.remove(group)
                cuts, joints = group[0] + cuts, group[1] | joints
            groups.append((cuts, joints))
        return [(cuts, sorted(joints)) for cuts, joints in groups if joints]

    def _carriers(self, frame: Frame) -> np.ndarray:
        """Whether each joint moves a frame, (joints,)."""
        return np.asarray(self.above[frame.link]) if frame.link >= 0 else np.zeros(len(self.joints), dtype=bool)

    @property
    def units(self) -> Array:
        """What a joint's move is measured by, (joints,): rad where it turns, the mechanism's size where it slides."""
        return np.array([self.size if joint.prismatic else 1.0 for joint in self.joints])

    def active_text(self, qa: Array) -> str:
        """A pose of the active joints in words."""
        return ", ".join(f"{self.joints[j].name} = {x:.4g}" for j, x in zip(self.active, qa, strict=True))

    def active_ranges(self, about: Array) -> tuple[Array, Array]:
        """Least and greatest positions of the active joints: their limits, or a whole turn about a pose, (active,)."""
        spans = np.array([self._range(k)[1] for k in self.active])
        limits = [self.joints[k].position_limits for k in self.active]
        low = [x - span if pair is None else pair[0] for x, span, pair in zip(about, spans, limits, strict=True)]
        high = [x + span if pair is None else pair[1] for x, span, pair in zip(about, spans, limits, strict=True)]
        return np.array(low), np.array(high)

    def random_poses(self, count: int, seed: int) -> Array:
        """Positions of the active joints within their limits, or a whole turn, (count, active)."""
        limits = [self.joints[k].position_limits or self._range(k) for k in self.active]
        low, high = np.array(limits).reshape(-1, 2).T
        return np.random.default_rng(seed).uniform(low, high, (count, len(self.active)))

    def random_starts(self, joints: Sequence[int], count: int, seed: int) -> Array:
        """Positions of passive joints, (count, joints)."""
        low, high = np.array([self._range(j) for j in joints]).T
        return np.random.default_rng(seed).uniform(low, high, (count, len(joints)))

    def _range(self, joint: int) -> tuple[float, float]:
        reach = self.size if self.joints[joint].prismatic else np.pi
        return -reach, reach

    def gap(self, G: Array, offset: Array, count: int) -> float:
        """Greatest gap of the cuts over random poses, m; an angle counts as an arc at `size`."""
        q = self.random_poses(count, seed=1) @ G.T + offset
        return float(np.abs(self.residual(q)[0]).max())

    def residual(self, q: Array) -> tuple[Array, Array]:
        """Gaps of all cuts, (n, m), m, and their Jacobian, (n, m, joints), at joint positions (n, joints)."""
        gaps, jacobian = compiled(self).gaps(np.ascontiguousarray(q, dtype=float))
        return gaps, jacobian


@lru_cache(maxsize=32)
def compiled(chain: Chain) -> Any:
    """The core's part of a chain."""
    joints = chain.joints
    cuts = [(cut.prismatic, *(_frame(frame) for frame in (cut.frame, cut.twin))) for cut in chain.cuts]
    rotation, translation = np.array([j.rotation for j in joints]), np.array([j.translation for j in joints])
    parents, prismatic = [joint.parent for joint in joints], [joint.prismatic for joint in joints]
    core = importlib.import_module("haptid._core")
    return core.Loops(parents, rotation, translation, prismatic, cuts, chain.size)


def _frame(frame: Frame) -> tuple[int, list[float], list[float]]:
    return frame.link, frame.rotation.ravel().tolist(), frame.translation.tolist()


def solve(chain: Chain, q: Array, unknown: Sequence[int], steps: int = STEPS, settled: float = SETTLED) -> Array:
    """Joint positions with the unknown joints moved to close the cuts as well as they can, (n, joints)."""
    closed: Array = compiled(chain).close(np.ascontiguousarray(q, dtype=float), list(unknown), steps, settled)
    return closed


def find_branches(
    chain: Chain, G: Array, offset: Array, unknown: list[int], guess: Mapping[int, float], at: Array, closed: float
) -> Search:
    """Every linear motion of the unknown joints that closes the cuts.

    A linear motion is its own tangent: each solution found at some pose is extended along its tangent, and
    kept if that closes at all poses.

    Args:
        chain: the tree and its cuts.
        G, offset: motion of the joints already settled; rows of the unknown ones are ignored.
        unknown: indices of joints to settle.
        guess: positions near which to start.
        at: a pose of the active joints that is looked at besides random ones, (active,).
        closed: largest gap, in mechanism sizes.
    """
    qa = np.repeat(np.vstack([chain.random_poses(REFERENCES, seed=0), at]), STARTS, axis=0)
    q = qa @ G.T + offset
    q[:, unknown] = chain.random_starts(unknown, len(q), seed=0)
    q[::STARTS, unknown] = [guess.get(j, 0.0) for j in unknown]
    q = solve(chain, q, unknown)
    gaps = np.abs(chain.residual(q)[0]).max(axis=1)
    found = gaps < closed * chain.size
    tangents, free = _tangents(chain, q[found], qa[found], G, offset, unknown)
    linear = [_polished(chain, branch, unknown) for branch in ([] if free else _lasting(chain, tangents))]
    linear = [branch for branch in linear if chain.gap(branch.G, branch.offset, 64) < closed * chain.size]
    best = float(gaps.min())
    return Search(tuple(tangents), tuple(_distinct(chain, linear, unknown)), free, best, len(q))


def rates(chain: Chain, q: Array, G: Array, unknown: list[int]) -> tuple[Array, Array]:
    """Rates of the unknown joints by active one, (n, unknown, active), and their hold, (n, unknown)."""
    J = chain.residual(q)[1]
    A = J[:, :, unknown]
    settled = G.copy()
    settled[unknown] = 0.0
    held = np.linalg.svd(A, compute_uv=False)
    return np.asarray(-np.linalg.pinv(A, rcond=HELD) @ (J @ settled)), np.asarray(held)


def _tangents(
    chain: Chain, q: Array, qa: Array, G: Array, offset: Array, unknown: list[int]
) -> tuple[list[Branch], int]:
    """The distinct tangents at solutions, and how many directions of the unknown joints are always free."""
    if not len(q):
        return [], 0
    made, held = rates(chain, q, G, unknown)
    free = (held < HELD * chain.size).sum(axis=1) + max(0, len(unknown) - held.shape[1])
    branches = []
    for k in np.flatnonzero(free == free.min()):
        whole, constant = G.copy(), offset.copy()
        whole[unknown] = made[k]
        constant[unknown] = q[k, unknown] - made[k] @ qa[k]
        branches.append(Branch(whole, constant, qa[k]))
    return _distinct(chain, branches, unknown), int(free.min())


def _lasting(chain: Chain, branches: list[Branch]) -> list[Branch]:
    """Those that nearly close at some random poses."""
    if not branches:
        return []
    qa = chain.random_poses(4, seed=4)
    q = np.array([qa @ branch.G.T + branch.offset for branch in branches])
    gaps = np.abs(chain.residual(q.reshape(-1, q.shape[-1]))[0]).reshape(len(branches), -1).max(axis=1)
    return [branch for branch, gap in zip(branches, gaps, strict=True) if gap < 1e-3 * chain.size]


def _polished(chain: Chain, branch: Branch, unknown: list[int]) -> Branch:
    """The linear motion refitted to solutions at many poses, where it does close there."""
    qa = chain.random_poses(64, seed=3)
    start = qa @ branch.G.T + branch.offset
    if np.abs(chain.residual(start)[0]).max() > 1e-3 * chain.size:
        return branch
    q = solve(chain, start, unknown, steps=8)
    fit = np.linalg.lstsq(np.column_stack([qa, np.ones(len(qa))]), q[:, unknown], rcond=None)[0]
    G, offset = branch.G.copy(), branch.offset.copy()
    G[unknown], offset[unknown] = fit[:-1].T, fit[-1]
    return Branch(G, offset, branch.at)


def _distinct(chain: Chain, branches: list[Branch], unknown: list[int]) -> list[Branch]:
    """One of each, whole turns of a turning joint's constant left out of account."""
    if not branches:
        return []
    turning = np.array([not chain.joints[j].prismatic for j in unknown])
    offsets = np.array([branch.offset[unknown] for branch in branches])
    G = np.array([branch.G for branch in branches])
    left, kept = np.arange(len(branches)), []
    while len(left):
        first = left[0]
        apart = offsets[left] - offsets[first]
        apart[:, turning] = np.angle(np.exp(1j * apart[:, turning]))
        differs = np.maximum(np.abs(apart).max(axis=1), np.abs(G[left] - G[first]).max(axis=(1, 2))) >= SAME
        kept.append(branches[first])
        left = left[differs]
    return kept
