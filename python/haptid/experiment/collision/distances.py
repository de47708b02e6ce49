"""Signed distances between convex shapes on links, and their derivatives by position.

Every shape is in a capsule about it: a segment and a radius. Between capsules the distance is known in closed form; it
is that of balls and capsules, and a lower bound of all others, so that only pairs that may be near are measured, by
MuJoCo's `mj_geomDistance`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device import CollisionShape, poses
from haptid.dynamics.model import DynamicModel
from haptid.errors import MissingDependencyError, SettingError

# Distance at which a direction between two shapes is rounding, m.
_TOUCHING = 1e-12
# Distance up to which a single pair is measured, m.
_FURTHEST = 1e3
# Random poses of the tree at which shapes of a device that always overlap are found.
_POSES = 100


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of the pairs that are near at some samples.

    Attributes:
        sample, pair: indices, (k,).
        distance: below zero where the shapes overlap, (k,), m.
        first, second: nearest points of the two shapes, in the base frame, (k, 3), m.
    """

    sample: np.ndarray
    pair: np.ndarray
    distance: Array
    first: Array
    second: Array


@dataclass(frozen=True, eq=False)
class CollisionModel:
    """The shapes of a device and its surroundings, and the pairs that must not meet.

    Attributes:
        shapes: of the device file, then of the world.
        pairs: indices of shapes, the first below the second.
        overlapping: names of the device's own shapes that overlap in every pose, such as about the axes of a wrist:
            their distance says nothing about a motion, and they are no pairs.
    """

    model: DynamicModel
    shapes: tuple[CollisionShape, ...]
    pairs: tuple[tuple[int, int], ...]
    overlapping: tuple[str, ...] = ()

    @staticmethod
    def of(model: DynamicModel, world: Sequence[CollisionShape] = ()) -> CollisionModel:
        """All pairs, but those of one link, of a link with the one that carries it, and those that are ignored.

        Pairs of the device's own shapes that overlap in every pose are left out too, unless there are no others.

        Raises:
            SettingError: the device has no shapes on its moving links.
        """
        shapes = (*model.device.collision, *world)
        if not any(shape.link >= 0 for shape in shapes):
            raise SettingError(
                f"{model.device.name} has no collision shapes on its links.",
                where="collision",
                advice="Add [[collision]] tables with link, kind and sizes to the device file.",
            )
        pairs = [(i, k) for k in range(len(shapes)) for i in range(k) if _meets(model, shapes[i], shapes[k])]
        made = CollisionModel(model, shapes, tuple(pairs))
        always = made._always_overlapping()
        if not always.any() or always.all():
            return made
        kept = tuple(pair for pair, over in zip(pairs, always, strict=True) if not over)
        return CollisionModel(model, shapes, kept, tuple(made.label(k) for k in np.flatnonzero(always).tolist()))

    def _always_overlapping(self) -> np.ndarray:
        """Which pairs of the device's own shapes overlap in every pose of the tree that was drawn, (pairs,)."""
        joints, rng = self.model.device.joints, np.random.default_rng(0)
        low, high = np.array([joint.position_limits or (-np.pi, np.pi) for joint in joints]).T
        q_tree = low + (high - low) * rng.random((_POSES, len(joints)))
        own = np.array([not (self.shapes[i].world or self.shapes[k].world) for i, k in self.pairs], dtype=bool)
        for one in q_tree:
            left = np.flatnonzero(own)
            if len(left):
                own[left] = self.measure(np.tile(one, (len(left), 1)), left) < 0
        return own

    def label(self, pair: int) -> str:
        """A pair in words."""
        return " and ".join(self.shapes[k].name for k in self.pairs[pair])

    @cached_property
    def _geometry(self) -> _Geometry:
        return _Geometry.of(self.shapes)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of the two shapes of every pair."""
        first, second = np.array(self.pairs, dtype=int).reshape(-1, 2).T
        return first, second

    @cached_property
    def _capsules(self) -> tuple[Array, Array]:
        """Capsules about the shapes: ends of their segments, (2, shapes, 4, 1), and radii, (shapes,)."""
        made = [_capsule(shape) for shape in self.shapes]
        ends = np.ones((2, len(made), 4, 1))
        ends[0, :, :3, 0], ends[1, :, :3, 0] = (np.array([half for half, _ in made]) * sign for sign in (-1, 1))
        return freeze(ends), freeze(np.array([radius for _, radius in made]))

    @cached_property
    def _round(self) -> np.ndarray:
        """Whether both shapes of a pair are balls or capsules."""
        kinds = np.array([shape.kind in ("sphere", "capsule") for shape in self.shapes])
        first, second = self._ends
        return np.asarray(kinds[first] & kinds[second])

    @cached_property
    def size(self) -> float:
        """Median radius of the shapes on links, m: what a distance is compared with."""
        return float(np.median([shape.radius for shape in self.shapes if shape.link >= 0]))

    def shape_poses(self, q_tree: Array) -> Array:
        """Poses of all shapes in the base frame, (samples, shapes, 4, 4), from all joints' positions, (samples, j)."""
        links = poses(self.model.device, q_tree)
        made = np.zeros((len(q_tree), len(self.shapes), 4, 4))
        for k, shape in enumerate(self.shapes):
            local = np.eye(4)
            local[:3, :3], local[:3, 3] = shape.frame.rotation, shape.frame.translation
            made[:, k] = local if shape.link < 0 else (links[:, shape.link].reshape(-1, 4) @ local).reshape(-1, 4, 4)
        return made

    def far(self, at: Array) -> Array:
        """Lower bounds of the distances, from balls, (samples, pairs), m, from poses of the shapes."""
        first, second = self._ends
        radii = np.array([shape.radius for shape in self.shapes])
        places = at[:, :, :3, 3]
        apart = places[:, second] - places[:, first]
        return np.asarray(np.sqrt((apart**2).sum(axis=2)) - (radii[first] + radii[second]))

    def capsules(self, q_tree: Array) -> tuple[Array, Array]:
        """Capsules about the shapes: ends of their axes, (samples, shapes, 2, 3), and radii, (shapes,), m."""
        ends, radii = self._capsules
        at = self.shape_poses(q_tree)
        return np.stack([(at @ side)[..., :3, 0] for side in ends], axis=2), radii

    def near(self, q_tree: Array, reach: float) -> Distances:
        """All distances below `reach`, m, at positions of all joints, (samples, joints)."""
        at = self.shape_poses(q_tree)
        samples, pairs = np.nonzero(self.far(at) < reach)
        found = self._measured(at, samples, pairs, reach)
        kept = found.distance < reach
        return Distances(samples[kept], pairs[kept], found.distance[kept], found.first[kept], found.second[kept])

    def measure(self, q_tree: Array, pair: np.ndarray) -> Array:
        """Distance of one pair at each position of all joints, (k,), m, from (k, joints) and indices of pairs, (k,)."""
        return self._measured(self.shape_poses(q_tree), np.arange(len(pair)), pair, _FURTHEST).distance

    def _measured(self, at: Array, samples: np.ndarray, pairs: np.ndarray, reach: float) -> Distances:
        """Distances of pairs at samples, each (k,); those above `reach` are lower bounds."""
        ends, radii = self._capsules
        first, second = (side[pairs] for side in self._ends)
        points = [(at[samples, k] @ ends[side, k])[:, :3, 0] for k in (first, second) for side in (0, 1)]
        p, q = nearest_of_segments(*points)
        apart = q - p
        length = np.sqrt((apart**2).sum(axis=1))
        normal = apart / np.maximum(length, _TOUCHING)[:, None]
        distance = length - radii[first] - radii[second]
        p, q = p + radii[first, None] * normal, q - radii[second, None] * normal
        rest = np.flatnonzero(~self._round[pairs] & (distance < reach))
        for k, found, nearest in self._geometry(at, samples, first, second, rest, reach) if len(rest) else ():
            distance[k], p[k], q[k] = found, nearest[:3], nearest[3:]
        return Distances(samples, pairs, distance, p, q)

    def slopes(self, q_tree: Array, G: Array, found: Distances) -> Array:
        """Derivatives of distances by the positions of the active joints, (k, active).

        The nearest points stay where they are on their shapes to first order, so the distance changes by their
        relative velocity along the normal.

        Args:
            q_tree: positions of all joints, (samples, joints).
            G: rates of all joints by the active ones, (samples, joints, active) or (joints, active).
            found: distances at these samples.
        """
        apart = found.second - found.first
        length = np.where(np.abs(found.distance) > _TOUCHING, found.distance, np.inf)
        normal = apart / length[:, None]
        at = poses(self.model.device, q_tree)[found.sample]
        by_joint = np.zeros((len(found.sample), len(self.model.device.joints)))
        ends = np.array(self.pairs, dtype=int).reshape(-1, 2)[found.pair]
        for side, points, sign in ((0, found.first, -1.0), (1, found.second, 1.0)):
            links = np.array([shape.link for shape in self.shapes])[ends[:, side]]
            for j, joint in enumerate(self.model.device.joints):
                moved = self._carries[j, links]
                axis = at[moved, j, :3, 2]
                velocity = axis if joint.prismatic else np.cross(axis, points[moved] - at[moved, j, :3, 3])
                by_joint[moved, j] += sign * (velocity * normal[moved]).sum(axis=1)
        G = np.broadcast_to(G, (len(q_tree), *G.shape[-2:]))[found.sample]
        return np.asarray((by_joint[:, None] @ G)[:, 0])

    @cached_property
    def _carries(self) -> np.ndarray:
        """Whether a joint moves a link, (joints, links + 1); the last entry is the base."""
        joints = self.model.device.joints
        made = np.zeros((len(joints), len(joints) + 1), dtype=bool)
        for link in range(len(joints)):
            for j in ancestors(self.model, link):
                made[j, link] = True
        return made


def ancestors(model: DynamicModel, link: int) -> list[int]:
    """The joints that move a link, from its own to the base's."""
    made = []
    while link >= 0:
        made.append(link)
        link = model.device.joints[link].parent
    return made


def _meets(model: DynamicModel, a: CollisionShape, b: CollisionShape) -> bool:
    """Whether two shapes are a pair."""
    if a.link == b.link or a.link in b.ignore or b.link in a.ignore:
        return False
    joints = model.device.joints
    adjacent = any(x.link >= 0 and joints[x.link].parent == y.link for x, y in ((a, b), (b, a)))
    return not adjacent or a.world or b.world


def _capsule(shape: CollisionShape) -> tuple[Array, float]:
    """A capsule about a shape: half its segment, (3,), and its radius, m."""
    half = np.zeros(3)
    if shape.kind in ("capsule", "cylinder"):
        half[2] = shape.size[1]
        return half, shape.size[0]
    if shape.kind == "box":
        longest = int(np.argmax(shape.size))
        half[longest] = shape.size[longest]
        return half, float(np.linalg.norm(np.delete(shape.size, longest)))
    return half, shape.radius


def nearest_of_segments(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """Nearest points of segments from a to b and from c to d, each (n, 3) from (n, 3).

    Source: Ericson (2005), Real-Time Collision Detection, section 5.1.9.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = ((x * y).sum(axis=1) for x, y in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    tiny = np.finfo(float).tiny
    across = uu * vv - uv**2
    parallel = across <= 1e-14 * uu * vv
    s = np.where(parallel, 0.0, np.clip((uv * vw - uw * vv) / np.where(parallel, 1.0, across), 0, 1))
    t = (uv * s + vw) / np.maximum(vv, tiny)
    t = np.where(vv > 0, np.clip(t, 0, 1), 0.0)
    s = np.where(uu > 0, np.clip((uv * t - uw) / np.maximum(uu, tiny), 0, 1), 0.0)
    return a + s[:, None] * u, c + t[:, None] * v


class _Geometry:
    """MuJoCo's copy of the shapes: it measures, and moves nothing."""

    def __init__(self, mujoco: ModuleType, compiled: Any, local: Array) -> None:
        self._mujoco, self._model, self._local = mujoco, compiled, local
        self._data = mujoco.MjData(compiled)
        mujoco.mj_forward(compiled, self._data)

    @staticmethod
    def of(shapes: Sequence[CollisionShape]) -> _Geometry:
        try:
            import mujoco
        except ImportError as error:
            raise MissingDependencyError(
                "collision checks of boxes, cylinders and hulls require MuJoCo, which is not installed.",
                where="mujoco",
                advice='Install it with `pip install "haptid[bench]"`, or describe the shapes by spheres and capsules.',
            ) from error
        types = mujoco.mjtGeom
        kinds: Mapping[str, Any] = {
            "sphere": types.mjGEOM_SPHERE,
            "capsule": types.mjGEOM_CAPSULE,
            "cylinder": types.mjGEOM_CYLINDER,
            "box": types.mjGEOM_BOX,
            "hull": types.mjGEOM_MESH,
        }
        spec = mujoco.MjSpec()
        for k, shape in enumerate(shapes):
            given: dict[str, Any] = {"size": [*shape.size, 0, 0][:3]}
            if shape.kind == "hull":
                spec.add_mesh(name=f"{k}", uservert=shape.points.ravel(), maxhullvert=-1)
                given = {"meshname": f"{k}"}
            spec.worldbody.add_geom(type=kinds[shape.kind], name=f"{k}", **given)
        compiled = spec.compile()
        local = np.tile(np.eye(4), (len(shapes), 1, 1))  # MuJoCo moves a mesh to its centre of mass
        for k in range(len(shapes)):
            turned = np.zeros(9)
            mujoco.mju_quat2Mat(turned, compiled.geom_quat[k])
            local[k, :3, :3], local[k, :3, 3] = turned.reshape(3, 3), compiled.geom_pos[k]
        return _Geometry(mujoco, compiled, local)

    def __call__(
        self, at: Array, samples: np.ndarray, first: np.ndarray, second: np.ndarray, which: np.ndarray, reach: float
    ) -> Iterator[tuple[int, float, Array]]:
        """Distance, at most `reach`, and the nearest points of both shapes, (6,), for some of the pairs."""
        ends, measure = np.zeros(6), self._mujoco.mj_geomDistance
        places, turns = self._data.geom_xpos, self._data.geom_xmat
        moved = [at[samples[which], k[which]] @ self._local[k[which]] for k in (first, second)]
        where = [np.ascontiguousarray(x[:, :3, 3]) for x in moved]
        turned = [x[:, :3, :3].reshape(-1, 9) for x in moved]
        shapes = zip(which.tolist(), first[which].tolist(), second[which].tolist(), strict=True)
        for n, (k, a, b) in enumerate(shapes):
            places[a], places[b] = where[0][n], where[1][n]
            turns[a], turns[b] = turned[0][n], turned[1][n]
            yield k, measure(self._model, self._data, a, b, reach, ends), ends
