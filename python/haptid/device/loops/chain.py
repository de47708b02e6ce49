"""A tree with its cut joints: gaps of the loops, their Jacobian, and Gauss-Newton closing of many configurations."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.parts import Cut, Frame, Joint

# Most Gauss-Newton steps, and the length of a step that is the last one, rad (or m).
NEWTON_STEPS = 60
TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree with the joints cut out of its loops.

    Attributes:
        joints: of the tree.
        cuts: joints cut.
        active: indices of the independent joints.
        size: longest of its lengths, m; angles of a gap are multiplied by it.
        above: whether joint k carries link j, (joints, joints).
    """

    joints: tuple[Joint, ...]
    cuts: tuple[Cut, ...]
    active: tuple[int, ...]
    size: float
    above: np.ndarray

    @staticmethod
    def of(joints: Sequence[Joint], cuts: tuple[Cut, ...], active: tuple[int, ...]) -> Chain:
        """Of joints and the cuts among them."""
        frames = [frame for cut in cuts for frame in (cut.frame_a, cut.frame_b)]
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
            first, second = (self._carriers(frame) for frame in (cut.frame_a, cut.frame_b))
            cuts: tuple[Cut, ...] = (cut,)
            joints = set(np.flatnonzero(first ^ second).tolist()) & set(unknown)
            for group in [group for group in groups if group[1] & joints]:
                groups.remove(group)
                cuts, joints = group[0] + cuts, group[1] | joints
            groups.append((cuts, joints))
        return [(cuts, sorted(joints)) for cuts, joints in groups if joints]

    def _carriers(self, frame: Frame) -> np.ndarray:
        """Whether each joint moves a frame, (joints,)."""
        return np.asarray(self.above[frame.link]) if frame.link >= 0 else np.zeros(len(self.joints), dtype=bool)

    def widest(self, q: Array) -> str:
        """The links whose cut is furthest from closed at a configuration, (joints,), as text."""
        each = [replace(self, cuts=(cut,)) for cut in self.cuts]
        cut = self.cuts[int(np.argmax([np.abs(one.residual(q[None])[0]).max() for one in each]))]
        names = [f"link {self.joints[f.link].name}" if f.link >= 0 else "the base" for f in (cut.frame_a, cut.frame_b)]
        return f"{names[0]} does not reach {names[1]}"

    def attempts(self, qa: Array, starts: int, q: Array) -> str:
        """How loops were tried to close at a pose, (active,), and what is furthest at the best configuration there."""
        tried = f", from {starts} starts" if starts > 1 else ""
        return f"at the start pose ({self.active_text(qa)}){tried}, {self.widest(q)},"

    @property
    def units(self) -> Array:
        """Scale of each joint's position, (joints,): 1 rad, or the mechanism's size for a prismatic joint."""
        return np.array([self.size if joint.prismatic else 1.0 for joint in self.joints])

    def active_text(self, qa: Array) -> str:
        """Positions of the active joints as text."""
        return ", ".join(f"{self.joints[j].name} = {x:.4g}" for j, x in zip(self.active, qa, strict=True))

    def active_ranges(self, about: Array) -> tuple[Array, Array]:
        """Lower and upper positions of the active joints: their limits, or a turn about a pose, (active,)."""
        spans = np.array([self._range(k)[1] for k in self.active])
        limits = [self.joints[k].position_limits for k in self.active]
        low = [x - span if pair is None else pair[0] for x, span, pair in zip(about, spans, limits, strict=True)]
        high = [x + span if pair is None else pair[1] for x, span, pair in zip(about, spans, limits, strict=True)]
        return np.array(low), np.array(high)

    def random_poses(self, count: int, seed: int) -> Array:
        """Random positions of the active joints within their limits, or a turn, (count, active)."""
        limits = [self.joints[k].position_limits or self._range(k) for k in self.active]
        low, high = np.array(limits).reshape(-1, 2).T
        return np.random.default_rng(seed).uniform(low, high, (count, len(self.active)))

    def random_starts(self, joints: Sequence[int], count: int, seed: int) -> Array:
        """Random positions of passive joints, (count, joints)."""
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
    """The chain as an object of the core."""
    joints = chain.joints
    cuts = [(cut.kind, *(_frame(frame) for frame in (cut.frame_a, cut.frame_b))) for cut in chain.cuts]
    rotation, translation = np.array([j.rotation for j in joints]), np.array([j.translation for j in joints])
    parents, prismatic = [joint.parent for joint in joints], [joint.prismatic for joint in joints]
    core = importlib.import_module("haptid._core")
    return core.Loops(parents, rotation, translation, prismatic, cuts, chain.size)


def _frame(frame: Frame) -> tuple[int, list[float], list[float]]:
    return frame.link, frame.rotation.ravel().tolist(), frame.translation.tolist()


def close_cuts(chain: Chain, q: Array, unknown: Sequence[int], steps: int = NEWTON_STEPS) -> Array:
    """Joint positions after damped Gauss-Newton steps of the unknown joints towards closed cuts, (n, joints)."""
    closed: Array = compiled(chain).close(np.ascontiguousarray(q, dtype=float), list(unknown), steps, TOLERANCE)
    return closed
