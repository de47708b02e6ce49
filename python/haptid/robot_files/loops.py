"""Loops of what moves of a tree: which joints they move, and the joint at which each is cut.

A spherical joint whose loop moves in a plane is a revolute cut across the plane.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.geometry import least_turn
from haptid.robot_files.moving_tree import MovingTree
from haptid.robot_files.tree import ClosingJoint

# Axes are parallel, and directions independent, beyond this sine or relative length.
_PARALLEL, _RANK = 1e-9, 1e-6
# Closed poses near the reference at which the rank of the loops is taken, and their distance, rad.
_POSES, _AWAY = 6, 0.2


@dataclass(frozen=True, eq=False)
class Hinge:
    """A joint as loops need it: index of its parent (-1: base), placement (4, 4), axis (3,), whether it slides.

    `ball`: 1 if it is one of three hinges of a ball joint, 2 if a rod spins about it. `sprung`: it has a spring.
    """

    name: str
    parent: int
    placement: Array
    axis: Array
    prismatic: bool
    actuated: bool
    reference: float
    ball: int
    sprung: bool = False


@dataclass(frozen=True, eq=False)
class CutLoop:
    """A loop as the device file has it: a cut between two frames, and the joints that it moves."""

    name: str
    kind: str
    body_a: int
    frame_a: Array
    body_b: int
    frame_b: Array
    passive: tuple[str, ...]
    line: int | None


@dataclass(frozen=True, eq=False)
class OpenLoops:
    """The tree with its loops cut.

    Attributes:
        hinges: moving joints of the tree.
        loops: the cuts.
        passive: names of the joints that cuts move.
        idle: hinges of ball joints whose rotation nothing determines.
    """

    hinges: tuple[Hinge, ...]
    loops: tuple[CutLoop, ...]
    passive: frozenset[str]
    idle: tuple[str, ...]


def opened_loops(of: MovingTree) -> OpenLoops:
    """Cuts of all loops, and which joints they move: joints without a motor first."""
    hinges = [
        Hinge(
            one.joint.name,
            one.parent,
            one.placement,
            one.joint.axis,
            one.joint.kind == "prismatic",
            one.joint.actuated is not False,
            one.joint.reference,
            bool(one.joint.ball) + one.joint.spins,
            one.joint.stiffness != 0,
        )
        for one in of.moving
    ]
    cuts = [_cut(of, cut, hinges) for cut in of.closing]
    if not cuts:
        return OpenLoops(tuple(hinges), (), frozenset(), ())
    passive, idle = _passive(hinges, cuts, of)
    loops = []
    for cut in cuts:
        ways = _way(hinges, cut.body_a) ^ _way(hinges, cut.body_b)
        moved = tuple(hinges[k].name for k in sorted(ways) if hinges[k].name in passive)
        loops.append(CutLoop(cut.name, cut.kind, cut.body_a, cut.frame_a, cut.body_b, cut.frame_b, moved, cut.line))
    return OpenLoops(tuple(hinges), tuple(loops), frozenset(passive), tuple(idle))


def _poses(hinges: Sequence[Hinge], q: Array) -> list[Array]:
    made: list[Array] = []
    for hinge, x in zip(hinges, q, strict=True):
        above = np.eye(4) if hinge.parent < 0 else made[hinge.parent]
        made.append(above @ hinge.placement @ _motion(hinge, float(x)))
    return made


def _motion(hinge: Hinge, x: float) -> Array:
    made = np.eye(4)
    if hinge.prismatic:
        made[:3, 3] = x * hinge.axis
    else:
        K = np.cross(np.eye(3), hinge.axis)
        made[:3, :3] += np.sin(x) * K + (1 - np.cos(x)) * K @ K
    return made


def _at(poses: Sequence[Array], body: int, frame: Array) -> Array:
    return frame if body < 0 else poses[body] @ frame


def _way(hinges: Sequence[Hinge], body: int) -> set[int]:
    """Indices of the joints that carry a link."""
    made: set[int] = set()
    while body >= 0:
        made.add(body)
        body = hinges[body].parent
    return made


def _cut(of: MovingTree, cut: ClosingJoint, hinges: Sequence[Hinge]) -> CutLoop:
    (a, on_a), (b, on_b) = of.frames[cut.link_a], of.frames[cut.link_b]
    frame_a, frame_b = on_a @ cut.frame_a, on_b @ cut.frame_b
    kind: str = cut.kind
    if kind == "spherical":
        poses = _poses(hinges, np.array([hinge.reference for hinge in hinges]))
        axis = _across(hinges, poses, _way(hinges, a) ^ _way(hinges, b))
        world_a, world_b = _at(poses, a, np.eye(4)), _at(poses, b, np.eye(4))
        if axis is not None:
            kind = "revolute"
            frame_a, frame_b = (
                _turned(frame, least_turn(world[:3, :3].T @ axis)[:3, :3])
                for frame, world in ((frame_a, world_a), (frame_b, world_b))
            )
    return CutLoop(cut.name, kind, a, frame_a, b, frame_b, (), cut.line)


def _turned(frame: Array, rotation: Array) -> Array:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, frame[:3, 3]
    return made


def _across(hinges: Sequence[Hinge], poses: Sequence[Array], way: set[int]) -> Array | None:
    """The direction about which all joints of a loop turn, and across which they slide; None if there is none."""
    turning = [poses[k][:3, :3] @ hinges[k].axis for k in sorted(way) if not hinges[k].prismatic]
    if not turning:
        return None
    axis = turning[0]
    sliding = [poses[k][:3, :3] @ hinges[k].axis for k in sorted(way) if hinges[k].prismatic]
    flat = all(float(np.linalg.norm(np.cross(axis, other))) < _PARALLEL for other in turning)
    return axis if flat and all(abs(float(axis @ other)) < _PARALLEL for other in sliding) else None


def _gaps(hinges: Sequence[Hinge], cuts: Sequence[CutLoop], q: Array) -> tuple[Array, Array]:
    """Gaps of all cuts, (m,), and their Jacobian, (m, hinges)."""
    poses = _poses(hinges, q)
    axes = [pose[:3, :3] @ hinge.axis for hinge, pose in zip(hinges, poses, strict=True)]
    gaps: list[Array] = []
    rows: list[Array] = []
    for cut in cuts:
        A, B = _at(poses, cut.body_a, cut.frame_a), _at(poses, cut.body_b, cut.frame_b)
        za, zb = A[:3, 2], B[:3, 2]
        P = np.eye(3) - np.outer(za, za) if cut.kind == "prismatic" else np.eye(3)
        turned = {"prismatic": [(A[:3, k], B[:3, k]) for k in range(3)], "revolute": [(za, zb)]}.get(cut.kind, [])
        gaps.append(np.concatenate([P @ (B[:3, 3] - A[:3, 3]), *(np.cross(x, y) for x, y in turned)]))
        J = np.zeros((3 + 3 * len(turned), len(hinges)))
        for body, origin, sign in ((cut.body_b, B[:3, 3], 1.0), (cut.body_a, A[:3, 3], -1.0)):
            for k in _way(hinges, body):
                J[:3, k] += sign * P @ (axes[k] if hinges[k].prismatic else np.cross(axes[k], origin - poses[k][:3, 3]))
                if not hinges[k].prismatic:
                    for i, (x, _) in enumerate(turned):
                        J[3 + 3 * i : 6 + 3 * i, k] += sign * (axes[k] - x * (x @ axes[k]))
        rows.append(J)
    return np.concatenate(gaps), np.concatenate(rows)


def _passive(hinges: Sequence[Hinge], cuts: Sequence[CutLoop], of: MovingTree) -> tuple[set[str], list[str]]:
    """Names of the joints that the cuts move, and of hinges of ball joints whose rotation nothing determines."""
    names = [hinge.name for hinge in hinges]
    start = np.array([hinge.reference for hinge in hinges])
    F = _independent(names, of)
    ways = sorted(set().union(*(_way(hinges, cut.body_a) ^ _way(hinges, cut.body_b) for cut in cuts)))
    used: list[int] = np.flatnonzero(F[ways].any(axis=0)).tolist()
    rng = np.random.default_rng(0)
    best, rank = np.zeros((0, len(used))), -1
    for k in range(_POSES):
        q = start + (F @ (rng.uniform(-_AWAY, _AWAY, len(start)) * (F.diagonal() != 0)) if k else 0.0)
        for _ in range(40 if k else 3):
            gap, J = _gaps(hinges, cuts, q)
            q = q - F @ (np.linalg.pinv(J @ F, rcond=1e-9) @ gap)
        gap, J = _gaps(hinges, cuts, q)
        if np.abs(gap).max() < 1e-8:
            found = int(np.linalg.matrix_rank(J @ F, tol=_RANK))
            if found > rank:
                best, rank = (J @ F)[:, used], found
    # A joint with a motor, or with a spring, moves by itself where it can: it comes after those that only loops move.
    # So does one nearer the base after those that it carries.
    # Spins, and otherwise the third hinge of a ball joint, come last of those without a motor.
    ball = [hinges[k].ball for k in used]
    order = sorted(
        range(len(used)),
        key=lambda i: (
            hinges[used[i]].actuated,
            hinges[used[i]].sprung,
            ball[i],
            0 if ball[i] else -len(_way(hinges, used[i])),
            int(used[i]) if ball[i] == 1 else -int(used[i]),
        ),
    )
    passive: set[str] = set()
    idle: list[str] = []
    Q = np.zeros((len(best), 0))
    for i in order:
        rest = best[:, i] - Q @ (Q.T @ best[:, i])
        rest = rest - Q @ (Q.T @ rest)
        size = float(np.linalg.norm(rest))
        if size > _RANK * max(1.0, float(np.linalg.norm(best[:, i]))):
            Q = np.column_stack([Q, rest / size])
            passive.add(names[used[i]])
        elif hinges[used[i]].ball:
            idle.append(names[used[i]])
    return passive, idle


def _independent(names: Sequence[str], of: MovingTree) -> Array:
    """Map from joints that follow no other to all joints, (n, n); columns of followers are zero."""
    index = {name: k for k, name in enumerate(names)}
    direct = np.zeros((len(names), len(names)))
    followers = set()
    for relation in of.follows:
        followers.add(index[relation.joint])
        for name, factor in relation.factors.items():
            direct[index[relation.joint], index[name]] = factor
    free = np.diag([0.0 if k in followers else 1.0 for k in range(len(names))])
    return np.asarray(np.linalg.solve(np.eye(len(names)) - direct, free))


def gaps_at(of: MovingTree, poses: Mapping[str, tuple[Array, Array]]) -> Array:
    """Distance of the two points of every closing joint, (loops, n), m, from poses of links."""
    made = []
    for cut in of.closing:
        ends = []
        for link, frame in ((cut.link_a, cut.frame_a), (cut.link_b, cut.frame_b)):
            R, p = poses[link]
            ends.append((p + np.einsum("nij,j->ni", R, frame[:3, 3]), np.einsum("nij,j->ni", R, frame[:3, 2])))
        (xa, za), (xb, zb) = ends
        apart = xb - xa
        if cut.kind == "prismatic":
            apart = np.cross(za, apart)
        gap = np.linalg.norm(apart, axis=1)
        if cut.kind != "spherical":
            gap = np.maximum(gap, np.linalg.norm(np.cross(za, zb), axis=1))
        made.append(gap)
    return np.array(made)
