"""Jacobian of the pins of linear loops by their passive joints, as trigonometric polynomials of the active joints.

A pin's place is a sum of vectors of links, each turned by the joints before it, and joints of linear loops are linear
in the active ones: all entries are combinations of few cosines and sines, of one or two angles for planar loops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.device import Device
from haptid.device.loops.linear import Closure
from haptid.device.parts import Cut, Joint

# A rotation about z by q is the sum of these times exp(-i q), 1 and exp(i q).
_TURN = {
    -1: np.array([[0.5, -0.5j, 0], [0.5j, 0.5, 0], [0, 0, 0]]),
    0: np.diag([0, 0, 1.0 + 0j]),
    1: np.array([[0.5, 0.5j, 0], [-0.5j, 0.5, 0], [0, 0, 0]]),
}
# Coefficients below this, relative to the largest, are rounding.
_ROUNDING = 1e-12

# Coefficients by multiples of the joints in the exponent, and by the prismatic joint that is a factor, -1 for none.
_Sum = dict[tuple[tuple[int, ...], int], Array]


@dataclass(frozen=True, eq=False)
class Pins:
    """Nonzero blocks of the Jacobian, each of one joint and one cut: sums of cosines and sines.

    Attributes:
        column: column of the Jacobian of each block.
        pairs: the one and the other block of all pairs that share a cut.
        coefficients: of all cosines, then of all sines, (3 blocks, 2 terms), m; 1 for a prismatic joint.
        phase: of each term at zero, (terms,), and by the active joints, (terms, active), rad.
        scale: factor of each term at zero, 1 but for prismatic joints, and by the active joints.
    """

    column: tuple[int, ...]
    pairs: tuple[list[int], list[int]]
    coefficients: Array
    phase: tuple[Array, Array]
    scale: tuple[Array, Array]

    @staticmethod
    def of(device: Device) -> Pins | None:
        """Those of a device; None where it has no linear loops with pins."""
        closure, column, pairs, entries = device.closure, list[int](), list[tuple[int, int]](), list[_Sum]()
        if not isinstance(closure, Closure):
            return None
        passive = [j for j in range(len(device.joints)) if j not in device.active]
        for cut in closure.cuts:
            moved = {} if cut.kind == "prismatic" else _by_joint(device.joints, cut)
            first, moved_passive = len(column), {k: moved[j] for k, j in enumerate(passive) if j in moved}
            column += moved_passive
            entries += moved_passive.values()
            pairs += combinations(range(first, len(column)), 2)
        return _collected(closure, tuple(column), pairs, entries) if column else None

    def at(self, qa: Array, enough: float = np.inf) -> PinsAtPoses:
        """The Jacobian at positions of the active joints, (active, samples), rad or m."""
        return PinsAtPoses(self, qa, enough)


class PinsAtPoses:
    """The Jacobian of some pins at some poses.

    Attributes:
        conditioning: its least singular value with columns of unit length, (samples,), to 1e-8; at most `enough`.
        small: where it is less than `enough`, (samples,).
    """

    def __init__(self, pins: Pins, qa: Array, enough: float) -> None:
        self._pins, (at_zero, slope), (factor, exponent) = pins, pins.phase, pins.scale
        phase = slope @ qa + at_zero[:, None]
        self._scale = exponent @ qa + factor[:, None]
        self._waves = np.array([np.cos(phase), np.sin(phase)])
        terms = pins.coefficients @ (self._scale * self._waves).reshape(-1, qa.shape[1])
        self._blocks = terms.reshape(len(pins.column), 3, -1)
        columns = max(pins.column) + 1
        squared = np.zeros((columns, qa.shape[1]))
        for k, square in zip(pins.column, np.einsum("kis,kis->ks", self._blocks, self._blocks), strict=True):
            squared[k] += square
        self._shorter = 1.0 / np.sqrt(np.maximum(squared, 1e-24))
        products = self._products()
        self.small = ~_positive(products, enough**2)
        chosen = np.ascontiguousarray(products[:, :, self.small].transpose(2, 0, 1))
        self._eigenvalues, self._vectors = np.linalg.eigh(chosen)
        self.conditioning = np.full(len(self.small), enough)
        self.conditioning[self.small] = np.sqrt(np.maximum(self._eigenvalues[:, 0], 0.0))

    def _products(self) -> Array:
        """Inner products of the columns of unit length, (columns, columns, samples)."""
        column, count = self._pins.column, len(self._shorter)
        made = np.zeros((count, count, self._shorter.shape[1]))
        first, second = self._pins.pairs
        products = np.einsum("kis,kis->ks", self._blocks[first], self._blocks[second])
        for i, k, product in zip(first, second, products, strict=True):
            made[column[i], column[k]] += product
        made += made.transpose(1, 0, 2)
        made *= self._shorter
        made *= self._shorter[:, None]
        made[range(count), range(count)] = 1.0
        return made

    def slopes(self) -> Array:
        """Derivatives of the conditioning by the active joints where it is small, (active, small samples)."""
        pins, indices = self._pins, self.small
        column, (first, second) = list(pins.column), pins.pairs
        least, blocks = self._eigenvalues[:, 0], self._blocks[:, :, indices]
        # The least eigenvalue is w' J' J w with the weights w of its vector, whose own change does not count; less
        # that from the change of the columns' lengths.
        weights = (self._vectors[:, :, 0].T * self._shorter[:, indices])[column][:, None]
        weighted = weights * blocks
        by_block = (1.0 - least) * weighted
        for i, k in zip(first, second, strict=True):
            by_block[i] += weighted[k]
            by_block[k] += weighted[i]
        by_block *= weights / np.sqrt(np.maximum(least, 1e-24))
        by_wave = (pins.coefficients.T @ by_block.reshape(-1, by_block.shape[2])).reshape(2, len(self._scale), -1)
        cosine, sine = self._waves[:, :, indices]
        by_phase = self._scale[:, indices] * (by_wave[1] * cosine - by_wave[0] * sine)
        by_scale = by_wave[0] * cosine + by_wave[1] * sine
        return np.asarray(pins.phase[1].T @ by_phase + pins.scale[1].T @ by_scale)


def _positive(products: Array, shift: float) -> np.ndarray:
    """Whether matrices, (k, k, samples), less some of the identity are positive definite: by the pivots (Sylvester).

    A tenth of the time of the eigenvalues. Of two unit columns, as of one planar loop, it is one pivot.
    """
    if shift >= 1.0:  # no diagonal is larger
        return np.zeros(products.shape[2], dtype=bool)
    left = products - shift * np.eye(len(products))[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k in range(len(left) - 1):
            row = left[k, k + 1 :]
            left[k + 1 :, k + 1 :] -= row[:, None] * (row / left[k, k])
    return np.asarray((np.einsum("kks->ks", left) > 0).all(axis=0))


def _by_joint(joints: Sequence[Joint], cut: Cut) -> dict[int, _Sum]:
    """Velocity of one side of a pin against the other by the rate of each joint that moves one of them.

    In the frame of the nearest link that carries both.
    """
    sides = (cut.frame_a, cut.frame_b)
    first, second = (_path(joints, frame.link) for frame in sides)
    moved: dict[int, _Sum] = {}
    for sign, frame, moving in zip((1.0, -1.0), sides, (_without(first, second), _without(second, first)), strict=True):
        axes, origins, end = _side(joints, moving, frame.translation)
        for j in moving:
            arm = _add(end, _times(-1.0, origins[j]))
            turning = axes[j] if joints[j].prismatic else _product(axes[j], arm, np.cross)
            moved[j] = _times(sign, turning)
    return moved


def _side(
    joints: Sequence[Joint], moving: Sequence[int], point: Array
) -> tuple[dict[int, _Sum], dict[int, _Sum], _Sum]:
    """Axis and origin of each joint of a chain, and the place of a point in its last link, from before the first."""
    none = ((0,) * len(joints), -1)
    turned: _Sum = {none: np.eye(3, dtype=complex)}
    place: _Sum = {none: np.zeros(3, dtype=complex)}
    axes, origins = dict[int, _Sum](), dict[int, _Sum]()
    for j in moving:
        joint = joints[j]
        place = _add(place, _product(turned, {none: joint.translation}, np.matmul))
        turned = _product(turned, {none: joint.rotation}, np.matmul)
        axes[j] = {key: R[:, 2] for key, R in turned.items()}
        if joint.prismatic:
            place = _add(place, {(angles, j): x for (angles, _), x in axes[j].items()})
        else:
            turn = {(tuple(m * (k == j) for k in range(len(joints))), -1): R for m, R in _TURN.items()}
            turned = _product(turned, turn, np.matmul)
        origins[j] = place
    return axes, origins, _add(place, _product(turned, {none: point}, np.matmul))


def _path(joints: Sequence[Joint], link: int) -> list[int]:
    """The joints from the base to a link."""
    path = list[int]()
    while link >= 0:
        path.insert(0, link)
        link = joints[link].parent
    return path


def _without(path: Sequence[int], other: Sequence[int]) -> list[int]:
    return [j for j in path if j not in other]


def _times(factor: float, sum_: _Sum) -> _Sum:
    return {key: factor * x for key, x in sum_.items()}


def _add(first: _Sum, second: _Sum) -> _Sum:
    return {**first, **{key: first[key] + x if key in first else x for key, x in second.items()}}


def _product(first: _Sum, second: _Sum, times: Callable[[Array, Array], Array]) -> _Sum:
    """The product of two sums, at most one of which has prismatic joints as factors; nothing that is rounding."""
    product: _Sum = {}
    for (a, factor), x in first.items():
        for (b, prismatic), y in second.items():
            key = (tuple(i + k for i, k in zip(a, b, strict=True)), max(factor, prismatic))
            product = _add(product, {key: times(x, y)})
    return {key: x for key, x in product.items() if np.abs(x).max() > _ROUNDING}


def _collected(
    closure: Closure, column: tuple[int, ...], pairs: Sequence[tuple[int, int]], entries: Sequence[_Sum]
) -> Pins:
    """Sums in the active joints' positions; the real part of each is that of half of its terms, twice."""
    terms: dict[tuple[tuple[float, ...], int], Array] = {}
    for block, entry in enumerate(entries):
        for (angles, prismatic), x in entry.items():
            slope, at_zero = np.array(angles) @ closure.G, float(np.array(angles) @ closure.offset)
            value = x * np.exp(1j * at_zero)
            if (first := slope[np.abs(slope) > 1e-9][:1]).size and first[0] < 0:
                slope, value = -slope, np.conj(value)
            key = (tuple(np.round(slope + 0.0, 9).tolist()), prismatic)
            terms.setdefault(key, np.zeros((len(entries), 3), dtype=complex))[block] += value
    values = np.array([x.ravel() for x in terms.values()]).T
    G, offset = np.vstack([closure.G, np.zeros(closure.G.shape[1])]), np.append(closure.offset, 1.0)
    last = [prismatic for _, prismatic in terms]
    slopes = np.array([slope for slope, _ in terms])
    return Pins(
        column,
        ([i for i, _ in pairs], [k for _, k in pairs]),
        np.concatenate([values.real, -values.imag], axis=1),
        (np.zeros(len(terms)), slopes),
        (offset[last], G[last]),
    )
