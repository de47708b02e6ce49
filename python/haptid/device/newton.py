"""Loops whose rates vary with the pose: their cuts are closed by Newton's method, on the side of the start pose."""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import blake2b
from typing import NoReturn

import numpy as np

from haptid._values import Array, expect, freeze, read_only
from haptid.device.closing import Chain, solve
from haptid.device.closure import Followed
from haptid.device.model import Cut
from haptid.errors import LoopUnreachableError, SingularLoopError

# A loop is closed where its gap stays below this share of the mechanism's size.
CLOSED = 1e-12
# Least singular value of the cuts' Jacobian by the passive joints, its columns of unit length, above which they are
# settled.
SINGULAR = 1e-3
# Random poses stay this far from singular ones, so that rounding does not grow.
ROOMY = 0.1
# Longest step of an active joint from one closed pose to the next, rad (or mechanism sizes), and the shortest tried.
STRIDE, LEAST_STRIDE = 0.1, 1e-4
# A step's passive joints may be this far from where the tangent led to, rad (or mechanism sizes).
NEAR = 0.1
# Newton's steps for each step of the way; after one this short, rad (or m), what is left is its square.
NEWTON, LAST_STEP = 8, 1e-8
# Samples closed at a time: their Jacobians fit in the caches.
CHUNK = 2048
# Motions whose closed poses are kept: a model asks for the same motion again and again.
KEPT = 4
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
    _closed: dict[bytes, Array] = field(default_factory=dict, repr=False)

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
            SingularLoopError: they close, but there, or on the way there, passive joints are not settled.
        """
        return np.asarray(self._along(np.asarray(qa, dtype=float).T).T)

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities.

        Args:
            qa: (active, samples), rad or m.
            qda: the same, per second; at rest where None.

        Raises:
            LoopUnreachableError, SingularLoopError: as for `positions`.
        """
        q = self._along(np.asarray(qa, dtype=float).T)
        speeds = np.zeros_like(qa) if qda is None else np.asarray(qda, dtype=float)
        pieces = [self._rates(q[k : k + CHUNK], speeds.T[k : k + CHUNK]) for k in range(0, len(q), CHUNK)]
        shape = (0, *self.constant.shape)
        G, Gd = (
            (np.concatenate([np.zeros(shape), *each]) for each in zip(*pieces, strict=True))
            if pieces
            else (
                np.zeros(shape),
                np.zeros(shape),
            )
        )
        return Followed(q.T, G, Gd)

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close at each pose, and the way there from the start pose is clear, (samples,)."""
        return self._march(self._origin(len(qa.T)), qa.T)[1]

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
            q, closed = self._march(self._origin(len(qa)), qa)
            kept = np.concatenate([kept, qa[closed][self.openness(q[closed]) > ROOMY]])
            if len(kept) >= count:
                break
        return np.ascontiguousarray(kept[np.arange(count) % len(kept)].T)

    def _origin(self, count: int) -> Array:
        """The start pose, so many times, (count, joints)."""
        return np.repeat(self.start[None], count, axis=0)

    def _rates(self, q: Array, qda: Array) -> tuple[Array, Array]:
        """G and its rate of change at closed poses (n, joints), moving with (n, active)."""
        J = self.chain.residual(q)[1]
        Q, R = np.linalg.qr(J[:, :, list(self.unknown)])

        def settle(gaps: Array) -> Array:
            return -np.linalg.solve(R, Q.mT @ gaps)

        G, Gd = np.repeat(self.constant[None], len(q), axis=0), np.zeros((len(q), *self.constant.shape))
        G[:, self.unknown] = settle(J @ self.constant)
        qd = np.einsum("sja,sa->sj", G, qda)
        Gd[:, self.unknown] = settle(self.chain.change(q, qd) @ G)
        for rates in (G, Gd):
            rates[:, self.unknown] = np.where(self.varying[list(self.unknown)], rates[:, self.unknown], 0.0)
        return G, Gd

    def _march(self, q: Array, targets: Array) -> tuple[Array, np.ndarray]:
        """Closed poses (n, joints) moved along straight lines until the active joints are at targets (n, active).

        A step is taken where it closes, near where the tangent leads to, and on the same side of singular poses: the
        orientation det(A' A_next) stays positive. Else it is halved.

        Returns:
            the poses, and whether each target was reached; those that were not stay at the last closed pose.
        """
        q, unknown = q.copy(), list(self.unknown)
        way = targets - q[:, self.chain.active]
        far = np.abs(way / self.chain.units[list(self.chain.active)]).max(axis=1, initial=0.0)
        done, step = np.zeros(len(q)), np.minimum(1.0, STRIDE / np.maximum(far, STRIDE))
        A, slope = self._tangent(q, way)
        busy = np.flatnonzero(far > 0)
        done[far == 0] = 1.0
        while len(busy):
            h = np.minimum(step[busy], 1.0 - done[busy])
            there = np.where(done[busy] + h >= 1.0, 1.0, done[busy] + h)
            qa = np.where(there[:, None] == 1.0, targets[busy], targets[busy] - (1 - there[:, None]) * way[busy])
            ahead = qa @ self.constant.T + self.offset
            ahead[:, unknown] = q[busy][:, unknown] + h[:, None] * slope[busy]
            closed = solve(self.chain, ahead, unknown, NEWTON, LAST_STEP)
            r, J = self.chain.residual(closed)
            turned = np.linalg.slogdet(A[busy].mT @ J[:, :, unknown])[0]
            missed = np.abs((closed - ahead) / self.chain.units).max(axis=1)
            gap = np.abs(r).max(axis=1)
            good = (gap < CLOSED * self.chain.size) & (missed < NEAR) & (turned > 0)
            good[good] = openness(J[good][:, :, unknown]) > SINGULAR
            taken = busy[good]
            q[taken], done[taken] = closed[good], there[good]
            onward = good & (there < 1.0)
            A[busy[onward]], slope[busy[onward]] = self._tangent_of(J[onward], way[busy[onward]])
            step[taken] = np.minimum(2 * step[taken], STRIDE / np.maximum(far[taken], STRIDE))
            step[busy[~good]] /= 2
            busy = busy[(done[busy] < 1.0) & (step[busy] * far[busy] > LEAST_STRIDE * STRIDE)]
        return q, done == 1.0

    def _tangent(self, q: Array, way: Array) -> tuple[Array, Array]:
        """The cuts' Jacobian by passive joints, and the rates of these along a way of the active ones, (n, unknown)."""
        return self._tangent_of(self.chain.residual(q)[1], way)

    def _tangent_of(self, J: Array, way: Array) -> tuple[Array, Array]:
        A = J[:, :, list(self.unknown)]
        Q, R = np.linalg.qr(A)
        moved = J @ (way @ self.constant.T)[:, :, None]
        return A, -np.linalg.solve(R, Q.mT @ moved)[..., 0]

    def _along(self, qa: Array) -> Array:
        """All joints at poses that follow each other, (samples, joints); those of the last few motions are kept."""
        key = blake2b(qa.tobytes()).digest()
        found = self._closed.pop(key, None)
        self._closed[key] = found = self._close(qa) if found is None else found
        for old in list(self._closed)[:-KEPT]:
            self._closed.pop(old, None)
        return found

    def _close(self, qa: Array) -> Array:
        """All joints at poses that follow each other, (samples, joints).

        Poses a stride apart are reached from the start, or from each other where the straight way is not clear; all
        others from the last of these.
        """
        if not len(qa):
            return freeze(np.zeros((0, len(self.start))))
        lengths = np.abs(np.diff(qa, axis=0) / self.chain.units[list(self.chain.active)]).max(axis=1)
        stride = np.concatenate([[0], np.floor(np.cumsum(lengths) / (STRIDE / 2))])
        _, first, group = np.unique(stride, return_index=True, return_inverse=True)
        knots = self._knots(qa[first])
        pieces = []
        for k in range(0, len(qa), CHUNK):
            here = slice(k, k + CHUNK)
            q, closed = self._march(knots[group[here]], qa[here])
            if not closed.all():
                worst = int(np.argmin(closed))
                self._refuse(q[worst], qa[k + worst], k + worst)
            pieces.append(q)
        return freeze(np.concatenate(pieces))

    def _knots(self, qa: Array) -> Array:
        """All joints at the poses that others are reached from, (knots, joints).

        Where one is not reached, the last closed pose on the way to it stands in its place.
        """
        q, closed = self._march(self._origin(len(qa)), qa)
        anchor = int(np.argmax(closed))
        for order in (range(anchor + 1, len(qa)), range(anchor - 1, -1, -1)):
            last = anchor
            for k in order if closed.any() else ():
                if not closed[k]:
                    q[k : k + 1], closed[k : k + 1] = self._march(q[last : last + 1], qa[k : k + 1])
                    if not closed[k]:
                        break
                last = k
        return q

    def _refuse(self, q: Array, qa: Array, sample: int) -> NoReturn:
        """Raise what keeps the loops from closing at a pose of the active joints, the last closed pose being q."""
        pose = self.chain.active_text(qa)
        there = qa @ self.constant.T + self.offset
        there[list(self.unknown)] = q[list(self.unknown)]
        gap = float(np.abs(self.chain.residual(solve(self.chain, there[None], self.unknown))[0]).max())
        if gap > 1e-6 * self.chain.size:
            raise LoopUnreachableError(sample, pose, gap, CLOSED * self.chain.size)
        raise SingularLoopError(f"up to sample {sample}", pose, float(self.openness(q[None])[0]), SINGULAR)


def openness(A: Array) -> Array:
    """Least singular value of Jacobians whose columns are scaled to unit length, (samples,)."""
    lengths = np.linalg.norm(A, axis=1, keepdims=True)
    return np.asarray(np.linalg.svd(A / np.maximum(lengths, 1e-300), compute_uv=False)[:, -1])
