"""Loops whose rates vary with the pose: their cuts are closed by Newton's method, on the side of the start pose."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from haptid._internal.arrays import Array, expect, read_only
from haptid.device.device import Cut
from haptid.device.loops.assembly import STEPS, Chain, compiled, solve
from haptid.device.loops.linear import Followed
from haptid.errors import LoopFarError, LoopUnreachableError, SingularLoopError

# A loop is closed where its gap stays below this share of the mechanism's size.
CLOSED = 1e-12
# Least singular value of the cuts' Jacobian by the passive joints, its columns of unit length, above which they are
# settled.
SINGULAR = 1e-3
# The core follows loops so far from the start pose, rad or mechanism sizes.
FARTHEST = 1e4
# Random poses stay this far from singular ones, so that rounding does not grow.
ROOMY = 0.1
# Draws of random poses, each from a smaller range about the start.
DRAWS = 8


@dataclass(frozen=True, eq=False)
class NewtonClosure:
    """How all joints follow the active ones where some rates vary: cuts are closed by Newton's method at every pose.

    Of the ways in which the cuts close, the one is kept that leads from the start pose there without a singular pose.
    With r(q) = 0 the gaps of the cuts, A and B their Jacobians by passive and by active joints, G = -A^+ B, and its
    rate of change is -A^+ (dJ/dt) [1; G]: both are exact (implicit differentiation). Rows that a loop does not need,
    such as those across the plane of a planar one, drop out of the pseudo-inverse.

    Attributes:
        chain: the tree and its cuts.
        constant: rates of the joints that do not need the cuts, (joints, active); rows of the others are zero.
        offset: of the same, (joints,), rad or m.
        unknown: indices of the joints that the cuts settle.
        at: active joints at the start pose, (active,).
        start: all joints there, (joints,).
        varying: which rates vary with the pose, (joints, active).
        error: greatest closure error over random poses, m.
        relations: one line for each passive joint.
    """

    chain: Chain
    constant: Array
    offset: Array
    unknown: tuple[int, ...]
    at: Array
    start: Array
    varying: np.ndarray
    error: float
    relations: tuple[str, ...]

    def __post_init__(self) -> None:
        joints, active = self.constant.shape
        shapes = {"offset": (joints,), "at": (active,), "start": (joints,), "varying": (joints, active)}
        for name, shape in shapes.items():
            expect(name, getattr(self, name).shape, shape)
        for name in ("constant", "offset", "at", "start"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        self.varying.flags.writeable = False

    @property
    def cuts(self) -> tuple[Cut, ...]:
        """The joints that were cut."""
        return self.chain.cuts

    def positions(self, qa: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples), rad or m.

        Raises:
            LoopUnreachableError: the loops do not close at a pose.
            LoopFarError: a pose is too far away to be one of a motion.
            SingularLoopError: they close, but there, or on the way there, passive joints are not settled.
        """
        qa = rows(qa)
        q, stop = branch(self).positions(qa)
        self._expect_reached(qa, stop)
        return np.asarray(q.T)

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities.

        Args:
            qa: (active, samples), rad or m.
            qda: the same, per second; at rest where None.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `positions`.
        """
        qa, qda = rows(qa), np.zeros((qa.shape[1], len(self.at))) if qda is None else rows(qda)
        q, G, Gd, stop = branch(self).follow(qa, qda)
        self._expect_reached(qa, stop)
        return Followed(q.T, G, Gd)

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close at each pose, and the way there from the start pose is clear, (samples,)."""
        reached: np.ndarray = branch(self).reach(rows(qa))[1]
        return reached

    def openness(self, q: Array) -> Array:
        """How far poses are from singular ones, (samples,): 0 where passive joints are not settled, 1 at best.

        Args:
            q: positions of all joints, (samples, joints).
        """
        return openness(self.chain.residual(q)[1][:, :, list(self.unknown)])

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random poses of the active joints that close, well away from singular ones, (active, count)."""
        low, high = self.chain.active_ranges(self.at)
        kept = np.zeros((0, len(self.at)))
        for k in range(DRAWS):
            near = 0.5**k
            qa = rng.uniform(self.at + near * (low - self.at), self.at + near * (high - self.at), (2 * count, len(low)))
            q, closed = branch(self).reach(qa)
            kept = np.concatenate([kept, qa[closed][self.openness(q[closed]) > ROOMY]])
            if len(kept) >= count:
                break
        return np.ascontiguousarray(kept[np.arange(count) % len(kept)].T)

    def _expect_reached(self, qa: Array, stop: tuple[int, Array] | None) -> None:
        """Raise what keeps the loops from closing at a sample (samples, active), the last closed pose being given."""
        if stop is None:
            return
        sample, q = stop
        pose = self.chain.active_text(qa[sample])
        if (np.abs(qa[sample] - self.at) > FARTHEST * self.chain.units[list(self.chain.active)]).any():
            raise LoopFarError(sample, pose, FARTHEST)
        there = qa[sample] @ self.constant.T + self.offset
        there[list(self.unknown)] = q[list(self.unknown)]
        gap = least_gap(self.chain, there, self.unknown)
        if gap > 1e-6 * self.chain.size:
            raise LoopUnreachableError(sample, pose, gap, CLOSED * self.chain.size)
        raise SingularLoopError(f"up to sample {sample}", pose, float(self.openness(q[None])[0]), SINGULAR)


def least_gap(chain: Chain, q: Array, unknown: Sequence[int]) -> float:
    """Least gap met on the way to closed cuts, m: where they cannot close the steps do not settle."""
    poses, gaps = q[None], []
    for _ in range(STEPS):
        gaps.append(float(np.abs(chain.residual(poses)[0]).max()))
        poses = solve(chain, poses, unknown, steps=1)
    return min(gaps)


@lru_cache(maxsize=32)
def branch(closure: NewtonClosure) -> Any:
    """The core's part of a closure."""
    core, chain = importlib.import_module("haptid._core"), closure.chain
    motion = closure.constant, closure.offset, closure.start, closure.varying
    return core.Branch(compiled(chain), chain.active, closure.unknown, *motion, CLOSED, SINGULAR)


def rows(x: Array) -> Array:
    """Active joints' (active, samples) as the core takes them, (samples, active)."""
    return np.ascontiguousarray(np.asarray(x, dtype=float).T)


def openness(A: Array) -> Array:
    """Least singular value of Jacobians whose columns are scaled to unit length, (samples,)."""
    lengths = np.linalg.norm(A, axis=1, keepdims=True)
    return np.asarray(np.linalg.svd(A / np.maximum(lengths, 1e-300), compute_uv=False)[:, -1])
