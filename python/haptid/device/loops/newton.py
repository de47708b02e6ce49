"""Loop closure with pose-dependent rates: cuts closed by Newton's method, in the assembly mode of the start pose."""

from __future__ import annotations

import importlib
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.loops.chain import NEWTON_STEPS, Chain, close_cuts, compiled
from haptid.device.loops.linear import ClosureProblem, Followed
from haptid.device.parts import Cut
from haptid.device.toml.errors_at import Place
from haptid.errors import LoopClosureError, SingularityError

# A loop is closed where its gap stays below this share of the mechanism's size.
_CLOSED = 1e-12
# Least singular value of the cuts' Jacobian by the passive joints, its columns scaled to unit length, at which the
# passive joints count as determined.
_SINGULAR = 1e-3
# The core's continuation goes no further from the start pose, rad or mechanism sizes.
FARTHEST = 1e4
# Least conditioning of random poses, so that rounding errors do not grow.
_ROOMY = 0.1
# Draws of random poses, each from half the range about the start of the one before.
_DRAWS = 8
# Starts of the passive joints at the start pose, in addition to the guess.
_STARTS = 256
# Two assembly modes are one if no joint differs by more, rad (or mechanism sizes).
_SAME = 1e-3
# Poses at which rates are tested for being zero, and the largest rate that counts as zero.
_POSES, EFFECT = 24, 1e-9

# Largest Jacobian over the samples that is kept after a motion was followed, bytes.
_KEPT = 1 << 25


@dataclass(frozen=True, eq=False)
class NewtonClosure:
    """Loop closure with pose-dependent rates: cuts are closed by Newton's method at every pose.

    The assembly mode is that of the start pose, followed by continuation; it cannot change without a singular pose.
    With r(q) = 0 the gaps of the cuts, A and B their Jacobians by passive and by active joints, G = -A^+ B, and its
    rate of change is -A^+ (dJ/dt) [1; G]: both are exact (implicit differentiation). Redundant rows,
    such as those across the plane of a planar loop, drop out of the pseudo-inverse.

    Attributes:
        chain: the tree and its cuts.
        constant: constant rates, of joints that do not depend on the cuts, (joints, active); other rows are zero.
        offset: of the same joints, (joints,), rad or m.
        unknown: indices of the joints that the cuts determine.
        at: active joints at the start pose, (active,).
        start: all joints there, (joints,).
        varying: which rates vary with the pose, (joints, active).
        error: greatest closure error over random poses, m.
        relations: as text, one for each passive joint.
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
        freeze_fields(self, "constant", offset=(joints,), at=(active,), start=(joints,))
        expect("varying", self.varying.shape, (joints, active))
        self.varying.flags.writeable = False

    @property
    def cuts(self) -> tuple[Cut, ...]:
        """The joints that were cut."""
        return self.chain.cuts

    @property
    def units(self) -> Array:
        """Scale of each joint's position, (joints,): 1 rad, or the mechanism's size for a prismatic joint."""
        return self.chain.units

    def positions(self, qa: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples), rad or m.

        Raises:
            LoopClosureError: the loops do not close at a pose, or it is too far from the start pose.
            SingularityError: they close, but there, or on the path there, passive joints are not determined.
        """
        qa = _rows(qa)
        q, stop = compiled_closure(self).positions(qa)
        self._expect_reached(qa, stop)
        return np.asarray(q.T)

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities.

        Args:
            qa: (active, samples), rad or m.
            qda: the same, per second; at rest where None.

        Raises:
            LoopClosureError, SingularityError: as for `positions`.
        """
        at_rest = qda is None
        qa, qda = _rows(qa), np.zeros((qa.shape[1], len(self.at))) if qda is None else _rows(qda)
        for pose, followed in tuple(self._followed):  # another thread may add to it meanwhile
            if np.array_equal(pose[0], qa) and (at_rest or np.array_equal(pose[1], qda)):
                return followed if not at_rest else Followed(followed.q, followed.G, np.zeros_like(followed.Gd))
        q, G, Gd, stop = compiled_closure(self).follow(qa, qda)
        self._expect_reached(qa, stop)
        followed = Followed(freeze(q.T), freeze(G), freeze(Gd))
        if G.nbytes <= _KEPT:
            self._followed.append(((qa.copy(), qda.copy()), followed))
        return followed

    @cached_property
    def _followed(self) -> deque[tuple[tuple[Array, Array], Followed]]:
        """The last motions followed: every friction term, and the core's inputs, ask for those of the same motion."""
        return deque(maxlen=4)

    def moved_to(self, chain: Chain) -> NewtonClosure:
        """The closure of the same mechanism with other lengths, in the assembly mode nearest to that of the start pose.

        Raises:
            LoopClosureError, SingularityError: at the start pose the loops do not close, or are singular.
        """
        q = close_cuts(chain, self.start[None], self.unknown)[0]
        gaps, jacobian = chain.residual(q[None])
        gap, pose = float(np.abs(gaps).max()), chain.active_text(self.at)
        if gap > _CLOSED * chain.size:
            raise open_loops(Place("loops"), gap, _CLOSED * chain.size, chain.attempts(self.at, 1, q))
        open_by = float(conditioning(jacobian[:, :, list(self.unknown)])[0])
        if open_by < _SINGULAR:
            raise _singular("at the start pose", pose, open_by, "loops")
        return replace(self, chain=chain, start=q)

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close at each pose, reached from the start pose without a singularity, (samples,)."""
        reached: np.ndarray = compiled_closure(self).reach(_rows(qa))[1]
        return reached

    def conditioning(self, q: Array) -> Array:
        """Distance from singular poses, (samples,): 0 where passive joints are not determined, 1 at best.

        Args:
            q: positions of all joints, (samples, joints).
        """
        return conditioning(self.chain.residual(q)[1][:, :, list(self.unknown)])

    def least_conditioning(self, limit: float) -> float:
        """The limit, or half the conditioning of the start pose where that is less: the scale is a rough one."""
        return min(limit, 0.5 * float(self.conditioning(self.start[None])[0]))

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random poses of the active joints at which the loops close, away from singular ones, (active, count).

        Raises:
            LoopClosureError: at no pose about the start pose.
        """
        low, high = self.chain.active_ranges(self.at)
        roomy = self.least_conditioning(_ROOMY)
        usable = np.zeros((0, len(self.at)))
        for k in range(_DRAWS):
            near = 0.5**k
            qa = rng.uniform(self.at + near * (low - self.at), self.at + near * (high - self.at), (2 * count, len(low)))
            q, closed = compiled_closure(self).reach(qa)
            usable = np.concatenate([usable, qa[closed][self.conditioning(q[closed]) > roomy]])
            if len(usable) >= count:
                break
        if not len(usable):
            raise LoopClosureError(
                f"the loops close at the start pose, {self.chain.active_text(self.at)}, and at none of "
                f"{2 * count * _DRAWS} poses about it, the nearest within {0.5 ** (_DRAWS - 1):.2g} of the joints' "
                f"ranges.",
                where="loops",
                found=0,
                limit=1,
                advice="The mechanism is stuck there: check the directions of its joints' axes, and the lengths.",
            )
        return np.ascontiguousarray(usable[np.arange(count) % len(usable)].T)

    def _expect_reached(self, qa: Array, stop: tuple[int, Array] | None) -> None:
        """Raise why the loops do not close at the sample where continuation stopped, given the last closed pose."""
        if stop is None:
            return
        sample, q = stop
        pose = self.chain.active_text(qa[sample])
        if (np.abs(qa[sample] - self.at) > FARTHEST * self.chain.units[list(self.chain.active)]).any():
            raise LoopClosureError(
                f"at sample {sample} the active joints are further from the start pose than loops are followed: {pose} "
                f"(limit {FARTHEST:.0e} rad, or as many times the mechanism's size).",
                where=sample,
                limit=FARTHEST,
                advice="The positions are probably in another unit: give its name, counts or degrees, and the gain.",
            )
        positions = qa[sample] @ self.constant.T + self.offset
        positions[list(self.unknown)] = q[list(self.unknown)]
        gap, nearest = least_gap(self.chain, positions, self.unknown)
        if gap > 1e-6 * self.chain.size:
            limit = _CLOSED * self.chain.size
            raise LoopClosureError(
                f"at sample {sample} the loops do not close: with {pose} {self.chain.widest(nearest)}, their "
                f"cut frames are still {gap:.3g} m apart (limit {limit:.1e} m).",
                where=sample,
                found=gap,
                limit=limit,
                advice="Keep the motion within the mechanism's reach; if the device did move there, check the lengths, "
                "and the zeros and signs of the positions.",
            )
        raise _singular(f"up to sample {sample}", pose, float(self.conditioning(q[None])[0]), sample)


def least_gap(chain: Chain, q: Array, unknown: Sequence[int]) -> tuple[float, Array]:
    """Least gap over the Gauss-Newton steps, m, and where: the steps do not converge where the cuts cannot close."""
    poses, gaps, seen = q[None], [], []
    for _ in range(NEWTON_STEPS):
        gaps.append(float(np.abs(chain.residual(poses)[0]).max()))
        seen.append(poses[0])
        poses = close_cuts(chain, poses, unknown, steps=1)
    best = int(np.argmin(gaps))
    return gaps[best], seen[best]


@lru_cache(maxsize=32)
def compiled_closure(closure: NewtonClosure) -> Any:
    """The closure as an object of the core."""
    core, chain = importlib.import_module("haptid._core"), closure.chain
    motion = closure.constant, closure.offset, closure.start, closure.varying
    return core.Branch(compiled(chain), chain.active, closure.unknown, *motion, _CLOSED, _SINGULAR)


def _rows(x: Array) -> Array:
    """Active joints' (active, samples) in the core's layout, (samples, active)."""
    return np.ascontiguousarray(np.asarray(x, dtype=float).T)


def conditioning(A: Array) -> Array:
    """Least singular value of Jacobians whose columns are scaled to unit length, (samples,)."""
    lengths = np.linalg.norm(A, axis=1, keepdims=True)
    return np.asarray(np.linalg.svd(A / np.maximum(lengths, 1e-300), compute_uv=False)[:, -1])


def newton_closure(problem: ClosureProblem, known: Mapping[int, str], place: Place) -> NewtonClosure:
    """The closure of loops whose rates vary, in the assembly mode nearest to the guess at the start pose.

    Args:
        problem: the cuts, and the passive joints that they determine.
        known: relations of the passive joints already determined, as text.
        place: of the loops in the file.

    Raises:
        LoopClosureError: the loops do not close at the start pose, or in several assembly modes that the guess does
            not distinguish.
        SingularityError: the start pose is singular.
    """
    chain, unknown, start_pose = problem.chain, problem.unknown, problem.start_pose
    constant, constants = problem.G.copy(), problem.offset.copy()
    constant[unknown], constants[unknown] = 0.0, 0.0
    modes = _assembly_modes(problem, constant @ start_pose + constants, place)
    q = _nearest_mode(problem, modes, place)
    open_by = float(conditioning(chain.residual(q[None])[1][:, :, unknown])[0])
    if open_by < _SINGULAR:
        raise _singular(f"{place}: at the start pose", chain.active_text(start_pose), open_by, place.key)
    varying = np.zeros(constant.shape, dtype=bool)
    varying[unknown] = True
    measured = measured_closure(
        NewtonClosure(chain, constant, constants, tuple(unknown), start_pose, q, varying, 0.0, ())
    )
    names = [f"q{chain.joints[k].name}" for k in chain.active]
    relations = dict(known)
    for j in unknown:
        moving = [name for name, varies in zip(names, measured.varying[j], strict=True) if varies]
        relations[j] = f"q{chain.joints[j].name} by closing, from {', '.join(moving) or 'no active joint'}"
    return replace(measured, relations=tuple(relations[j] for j in sorted(relations)))


def measured_closure(closure: NewtonClosure) -> NewtonClosure:
    """With the closure error, and rates that are zero everywhere not marked as varying."""
    rng = np.random.default_rng(0)
    followed = closure.follow(closure.draw(rng, _POSES))
    gap = float(np.abs(closure.chain.residual(followed.q.T)[0]).max())
    varying = closure.varying & (np.abs(followed.G).max(axis=0) > EFFECT * closure.chain.units.min())
    return replace(closure, varying=varying, error=gap)


def _assembly_modes(problem: ClosureProblem, q: Array, place: Place) -> list[Array]:
    """All closed poses found, revolute joints within half a turn of the guess, or of zero."""
    chain, unknown, guess = problem.chain, problem.unknown, problem.guess
    starts = np.repeat(q[None], _STARTS + 1, axis=0)
    starts[:, unknown] = chain.random_starts(unknown, _STARTS + 1, seed=0)
    starts[0, unknown] = [guess.get(j, 0.0) for j in unknown]
    starts = close_cuts(chain, starts, unknown)
    gaps = np.abs(chain.residual(starts)[0]).max(axis=1)
    if not (gaps < _CLOSED * chain.size).any():
        attempts = chain.attempts(problem.start_pose, _STARTS + 1, starts[int(np.argmin(gaps))])
        raise open_loops(place, float(gaps.min()), _CLOSED * chain.size, attempts)
    modes: list[Array] = []
    for pose in starts[gaps < _CLOSED * chain.size]:
        for j in unknown:
            if not chain.joints[j].prismatic:
                centre = guess.get(j, 0.0)
                pose[j] = centre + np.remainder(pose[j] - centre + np.pi, 2 * np.pi) - np.pi
        if not any(_distance(chain, pose, other, unknown) < _SAME for other in modes):
            modes.append(pose)
    return modes


def _distance(chain: Chain, first: Array, second: Array, joints: list[int]) -> float:
    """Greatest difference of some joints modulo a turn, rad (or mechanism sizes)."""
    difference = (first - second) / chain.units
    turning = [not joint.prismatic for joint in chain.joints]
    difference[turning] = np.angle(np.exp(1j * difference[turning]))
    return float(np.abs(difference[joints]).max(initial=0.0))


def _nearest_mode(problem: ClosureProblem, modes: list[Array], place: Place) -> Array:
    """The assembly mode nearest to the guess."""
    chain, unknown, guess = problem.chain, problem.unknown, problem.guess
    wanted = np.zeros(len(chain.joints))
    guessed = [j for j in guess if j in unknown]
    wanted[guessed] = [guess[j] for j in guessed]
    away = np.array([_distance(chain, pose, wanted, guessed) for pose in modes])
    nearest = [mode for mode, distance in zip(modes, away, strict=True) if distance < away.min() + _SAME]
    if len(nearest) > 1:
        texts = [", ".join(f"{chain.joints[j].name} = {mode[j]:.4g}" for j in unknown) for mode in nearest]
        raise LoopClosureError(
            f"{place}: at {chain.active_text(problem.start_pose)} the loops close in {len(texts)} assembly modes, and "
            f"no guess chooses one: {' or '.join(texts[:8])}.",
            where=place.key,
            found=len(texts),
            limit=1,
            advice="Add the right one to a loop, as guess = { ... }; rough values will do. If it is meant to be a "
            "parallelogram, make its opposite sides equal.",
        )
    return nearest[0]


def open_loops(place: Place, gap: float, limit: float, attempts: str) -> LoopClosureError:
    """The error for loops of a device file that do not close."""
    return LoopClosureError(
        f"{place}: the loop does not close: {attempts} the cut frames are still {gap:.3g} m apart (limit "
        f"{limit:.1e} m).",
        where=place.key,
        found=gap,
        limit=limit,
        advice="Check the lengths and frames of the cut, the start pose (at), and that the active joints can move "
        "independently.",
    )


def _singular(place: str, pose: str, found: float, key: int | str) -> SingularityError:
    return SingularityError(
        f"{place} the loops come to a singular pose: with {pose} the least singular value of the passive Jacobian is "
        f"{found:.2g} (limit {_SINGULAR:.1g}), so the active joints do not determine the passive ones.",
        where=key,
        found=found,
        limit=_SINGULAR,
        advice="Keep the motion on one side of such poses, by joint limits in the device file.",
    )
