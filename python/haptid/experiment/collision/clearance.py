"""The least distance along a motion, with a bound between samples, so that nothing tunnels.

The distance of two shapes changes by no more than their points move relative to each other. Between two samples, that
is at most the sum over the joints between their links of the joint's movement times the reach of the shape from its
axis (Schwarzer, Saha and Latombe 2005, IEEE Trans. Robotics 21(3)). Intervals in which this bound leaves room for a
smaller distance than the least one found are halved, down to a tolerance.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, expect
from haptid._internal.late import dataclass
from haptid.experiment.collision.distances import CollisionModel, ancestors

# Error of the least distance, m.
LEAST_TOLERANCE = 5e-4
# Samples between two at which all pairs are looked at first.
_COARSE = 20
# Most distances that are measured.
MOST_MEASURED = 200_000
# Intervals that are halved at once.
_AT_ONCE = 512


@dataclass(frozen=True)
class Clearance:
    """The least distance of a motion.

    Attributes:
        distance: least distance found, below zero where shapes overlap, m.
        bound: lower bound of the least distance over the whole motion, between samples too, m.
        time: when, s.
        pair: names of the two shapes.
        pairs: number of pairs that were checked.
    """

    distance: float
    bound: float
    time: float
    pair: str
    pairs: int

    def __str__(self) -> str:
        return (
            f"least distance {1e3 * self.distance:.4g} mm ({self.pair}) at {self.time:.3f} s; "
            f"at least {1e3 * self.bound:.4g} mm between samples too, {self.pairs} pairs"
        )


def clearance_along(collision: CollisionModel, q: Array, dt: float) -> Clearance:
    """The least distance of a motion that goes straight between its samples, in all joints.

    Args:
        collision: the shapes.
        q: positions of the active joints, (n, active), rad or m.
        dt: step, s.
    """
    expect("q", q.shape, (None, len(collision.model.device.active)))
    tree = collision.model.device.closure.positions(np.ascontiguousarray(q.T)).T
    search = _Search(collision, tree, _travelled(collision, tree))
    least, bound, at, pair = search.run()
    name = collision.label(pair) if collision.pairs else "no pair"
    return Clearance(least, bound, at * dt, name, len(collision.pairs))


def _travelled(collision: CollisionModel, tree: Array) -> Array:
    """Bound of the distance that points of a pair have moved relative to each other since the start, (n, pairs), m."""
    model, joints = collision.model, collision.model.device.joints
    steps = np.abs(np.diff(tree, axis=0))
    furthest = np.abs(tree).max(axis=0)
    made = np.zeros((len(tree), len(collision.pairs)))
    for k, pair in enumerate(collision.pairs):
        chains = [ancestors(model, collision.shapes[i].link) for i in pair]
        common = set(chains[0]) & set(chains[1])
        for i, chain in zip(pair, chains, strict=True):
            shape = collision.shapes[i]
            reach = float(np.linalg.norm(shape.frame.translation)) + shape.radius
            for j in chain:
                if j in common:
                    break
                slides = joints[j].prismatic
                made[1:, k] += steps[:, j] * (1.0 if slides else reach)
                reach += float(np.linalg.norm(joints[j].translation)) + (furthest[j] if slides else 0.0)
    return np.cumsum(made, axis=0)


@dataclass(frozen=True, eq=False)
class _Intervals:
    """Intervals of the motion, each for one pair: ends in samples, distances there, and the bound within."""

    pair: np.ndarray
    ends: Array
    distances: Array
    bound: Array

    def __getitem__(self, which: np.ndarray) -> _Intervals:
        return _Intervals(self.pair[which], self.ends[which], self.distances[which], self.bound[which])

    @staticmethod
    def join(*parts: _Intervals) -> _Intervals:
        names = ("pair", "ends", "distances", "bound")
        return _Intervals(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


class _Search:
    """Branch and bound over intervals of the motion and pairs of shapes."""

    def __init__(self, collision: CollisionModel, tree: Array, travelled: Array) -> None:
        self.collision, self.tree, self.travelled = collision, tree, travelled
        self.least, self.at, self.pair = np.inf, 0.0, 0
        self.measured = 0

    def run(self) -> tuple[float, float, float, int]:
        """Least distance, its lower bound, its sample (a fraction between samples) and its pair."""
        waiting = self._by_balls()
        waiting = self._measured(waiting.pair, waiting.ends)
        while True:
            waiting = waiting[waiting.bound < self.least - LEAST_TOLERANCE]
            if not len(waiting.pair) or self.measured > MOST_MEASURED:
                break
            order = np.argsort(waiting.bound)
            now, later = waiting[order[:_AT_ONCE]], waiting[order[_AT_ONCE:]]
            waiting = _Intervals.join(later, self._halved(now))
        bound = min(self.least, float(waiting.bound.min())) if len(waiting.pair) else self.least - LEAST_TOLERANCE
        return self.least, bound, self.at, self.pair

    def _by_balls(self) -> _Intervals:
        """Intervals of the coarse grid in which balls about the shapes leave room for less than the least so far."""
        n = len(self.tree)
        grid = np.unique(np.r_[np.arange(0, n, _COARSE), n - 1])
        far = self.collision.far(self.collision.shape_poses(self.tree[grid]))
        pairs = np.arange(far.shape[1])
        self._measure(pairs, grid[far.argmin(axis=0)].astype(float))
        ends = np.column_stack([grid[:-1], grid[1:]]) if n > 1 else np.zeros((1, 2), dtype=int)
        k = np.searchsorted(grid, ends)
        moved = self.travelled[ends[:, 1]] - self.travelled[ends[:, 0]]
        bound = (far[k[:, 0]] + far[k[:, 1]] - moved) / 2
        interval, pair = np.nonzero(bound < self.least - LEAST_TOLERANCE)
        return _Intervals(pair, ends[interval].astype(float), np.zeros((len(pair), 2)), bound[interval, pair])

    def _measured(self, pair: np.ndarray, ends: Array) -> _Intervals:
        """Intervals with distances at both ends."""
        found = np.column_stack([self._measure(pair, ends[:, 0]), self._measure(pair, ends[:, 1])])
        return self._bounded(pair, ends, found)

    def _halved(self, of: _Intervals) -> _Intervals:
        """Both halves of intervals; of those longer than a step, the middle is a sample."""
        middle = of.ends.mean(axis=1)
        middle = np.where(of.ends[:, 1] - of.ends[:, 0] > 1, np.floor(middle), middle)
        found = self._measure(of.pair, middle)
        return _Intervals.join(
            self._bounded(
                of.pair, np.column_stack([of.ends[:, 0], middle]), np.column_stack([of.distances[:, 0], found])
            ),
            self._bounded(
                of.pair, np.column_stack([middle, of.ends[:, 1]]), np.column_stack([found, of.distances[:, 1]])
            ),
        )

    def _bounded(self, pair: np.ndarray, ends: Array, distances: Array) -> _Intervals:
        at = [_interpolated(self.travelled, ends[:, k])[np.arange(len(pair)), pair] for k in (0, 1)]
        return _Intervals(pair, ends, distances, (distances.sum(axis=1) - (at[1] - at[0])) / 2)

    def _measure(self, pair: np.ndarray, at: Array) -> Array:
        """Distances of pairs at samples, (k,)."""
        self.measured += len(pair)
        found = self.collision.measure(_interpolated(self.tree, at), pair)
        if len(pair) and found.min() < self.least:
            k = int(np.argmin(found))
            self.least, self.at, self.pair = float(found[k]), float(at[k]), int(pair[k])
        return found


def _interpolated(values: Array, at: Array) -> Array:
    """Rows between two, (k, ...), at fractions of a row."""
    low = np.minimum(at.astype(int), max(len(values) - 2, 0))
    share = (at - low)[:, None]
    return np.asarray((1 - share) * values[low] + share * values[np.minimum(low + 1, len(values) - 1)])
