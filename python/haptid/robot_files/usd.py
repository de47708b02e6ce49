"""USD: bodies and joints of UsdPhysics, read by USD's own library in a child process.

Source: the specification of rigid body physics in USD (UsdPhysics), and NVIDIA's schemas for armature, friction and
mimic joints, as far as joints carry their attributes. Joints are a graph; the tree is made of it from the world on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.geometry import least_turn
from haptid.robot_files.limited import run_limited
from haptid.robot_files.paths import Roots
from haptid.robot_files.tree import (
    MOST_LINKS,
    ClosingJoint,
    Follows,
    Inertial,
    JointKind,
    LinkShape,
    Note,
    RobotLink,
    RobotTree,
    TreeJoint,
    inverse,
)
from haptid.robot_files.xml import checked_ratio, refused

_WORLD = "world"
_GRAVITY = 9.81
# Quaternions are in single precision: rotations nearer than this to quarter turns are meant as such, rad.
_SINGLE = 5e-7
_KINDS: Mapping[str, JointKind] = {
    "PhysicsRevoluteJoint": "revolute",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsSphericalJoint": "spherical",
    "PhysicsFixedJoint": "fixed",
}
_DOFS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
_BALL = ["rotX", "rotY", "rotZ"]
_AXES: Mapping[str, Array] = dict(zip("XYZ", np.eye(3), strict=True))
_ARMATURE = ("physxJointAxis:{dof}:armature", "physxJoint:armature", "newton:armature", "mjc:armature")
_OTHER_FORCES = ("mjc:stiffness", "physxJoint:jointFriction", "physxJointAxis:{dof}:staticFrictionEffort")


def read_usd(path: Path, roots: Roots, snap: float = 0.0) -> RobotTree:
    """The tree of a USD file.

    Args:
        path: of the file.
        roots: folders that its layers may be in.
        snap: rotations nearer than this to quarter turns are made such, rad.

    Raises:
        MissingDependencyError: USD is not installed.
        RobotFileError: what is wrong, with the path of the prim.
    """
    request = {"path": str(path.resolve()), "folders": [str(folder) for folder in roots.allowed]}
    stage = run_limited("usd", request, roots.allowed, roots.file, "usd")
    return _Stage(stage, roots.file, path.stem, max(snap, _SINGLE)).tree()


@dataclass(frozen=True, eq=False)
class _Edge:
    """A joint between two bodies, or a body and the world, with its frame in each, (4, 4)."""

    path: str
    name: str
    kind: JointKind | Literal["several"]
    bodies: tuple[str, str]
    frames: tuple[Array, Array]
    axis: Array
    excluded: bool


class _Stage:
    """Makes the tree of what the child has read."""

    def __init__(self, stage: Mapping[str, Any], file: str, title: str, snap: float) -> None:
        self.of, self.file, self.title, self.snap = stage, file, title, snap
        self.metre, self.kilogram = float(stage["metres"]), float(stage["kilograms"])
        if not (0 < self.metre < math.inf and 0 < self.kilogram < math.inf):
            raise refused(file, "its units are no positive numbers", "Set metersPerUnit and kilogramsPerUnit.")
        checked_ratio(self.metre, "metersPerUnit", file)
        checked_ratio(self.kilogram, "kilogramsPerUnit", file)
        self.prims: Mapping[str, Any] = stage["prims"]
        self.notes: list[Note] = []
        self.bodies = {
            path: name
            for path, name in _short_names([x for x in self.prims if self.prims[x]["role"] == "body"]).items()
            if self.value(path, "physics:rigidBodyEnabled", True) and not self.value(path, "physics:kinematicEnabled")
        }
        self.names = _short_names([x for x in self.prims if self.prims[x]["role"] == "joint"])

    def value(self, path: str, name: str, default: Any = None) -> Any:
        """An attribute of a prim."""
        return self.prims[path]["values"].get(name, default)

    def number(self, path: str, name: str, default: float) -> float:
        """A number of a prim; infinite ones are for `default`, as USD writes "not given"."""
        found = self.value(path, name, default)
        if not isinstance(found, int | float) or math.isnan(found):
            raise refused(self.file, f"{path} has {name} = {str(found)[:60]}", "Write a number there.")
        return float(found) if math.isfinite(found) else default

    def vector(self, path: str, name: str, count: int) -> Array | None:
        """A vector of a prim; None where it is not given or not finite."""
        found = self.value(path, name)
        if not isinstance(found, list) or len(found) != count or not np.isfinite(found).all():
            return None
        return np.array(found, dtype=float)

    def tree(self) -> RobotTree:
        """The tree."""
        if len(self.names) > MOST_LINKS:
            raise refused(self.file, f"it has {len(self.names)} joints; at most {MOST_LINKS} are read", "Cut it.")
        edges = [edge for path in self.names for edge in self._edge(path)]
        links = {_WORLD: RobotLink(_WORLD)}
        joints, closing = self._spanned(edges, links)
        kept = {joint.name for joint in joints}
        return RobotTree(
            name=self.of["name"] or self.title,
            file=self.file,
            form="usd",
            gravity=self._gravity(),
            links=links,
            joints=tuple(joints),
            follows=tuple(found for edge in edges if edge.name in kept for found in self._follows(edge, edges)),
            closing=tuple(closing),
            notes=tuple(self.notes),
        )

    def _gravity(self) -> Array:
        scenes = [path for path in self.prims if self.prims[path]["role"] == "scene"]
        up = _AXES.get(self.of["up"], _AXES["Z"])
        if not scenes:
            text = f"gravity: the stage has no scene; {_GRAVITY} m/s^2 against {self.of['up']} was taken"
            self.notes.append(Note("approximate", text))
            return -_GRAVITY * up
        direction = self.vector(scenes[0], "physics:gravityDirection", 3)
        if direction is None or not direction.any():
            direction = -up
        size = self.number(scenes[0], "physics:gravityMagnitude", -1.0)
        size = _GRAVITY if size < 0 else size * self.metre
        return np.asarray(size * direction / np.linalg.norm(direction))

    def _pose(self, path: str) -> tuple[Array, Array]:
        """Pose of a prim's frame in the stage, (4, 4), m, and its scales, (3,)."""
        matrix = np.array(self.of["frames"][path], dtype=float)
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        R = matrix[:3, :3] / np.where(scale > 0, scale, 1.0)
        if not np.isfinite(matrix).all() or np.abs(R.T @ R - np.eye(3)).max() > 1e-5 or np.linalg.det(R) < 0:
            raise refused(
                self.file, f"{path} is sheared, mirrored or without size", "Give bodies rotations and scales."
            )
        U, _, Vt = np.linalg.svd(R)
        made = np.eye(4)
        made[:3, :3] = self._snapped(U @ Vt)
        made[:3, 3] = matrix[:3, 3] * self.metre
        return made, np.array([float(f"{x:.7g}") for x in scale])

    def _snapped(self, R: Array) -> Array:
        nearest = np.round(R)
        near = np.abs(nearest).sum() == 3 and np.abs(R - nearest).max() < self.snap
        return nearest if near else R

    def _local(self, position: Array, quaternion: Array | None) -> Array:
        made = np.eye(4)
        made[:3, 3] = position
        if quaternion is not None and quaternion.any():
            w, *v = quaternion / np.linalg.norm(quaternion)
            K = np.cross(np.eye(3), v)  # x -> x times v, row by row: the transpose of the cross product matrix
            made[:3, :3] = self._snapped(np.eye(3) - 2 * w * K + 2 * K @ K)
        return made

    def _body_of(self, path: str | None) -> str:
        """The body that a prim belongs to; the world where there is none."""
        while path:
            if path in self.bodies:
                return path
            path = path.rpartition("/")[0]
        return _WORLD

    def _edge(self, path: str) -> list[_Edge]:
        """A joint, or none where it is not enabled or of a kind that holds nothing."""
        prim, name = self.prims[path], self.names[path]
        if self.value(path, "physics:jointEnabled", True) is False:
            self.notes.append(Note("left out", f"joint {name}, which is not enabled"))
            return []
        kind, axis = self._kind(path)
        if kind is None:
            self.notes.append(Note("left out", f"{prim['type']} {name}, which is no joint of a tree"))
            return []
        bodies, frames = [], []
        for side in "01":
            target = next(iter(prim["relations"].get(f"physics:body{side}", ())), None)
            if target is not None and target not in self.of["frames"]:
                raise refused(self.file, f"joint {path} has the body {target}, which is no prim", "Correct its path.")
            at, scale = (np.eye(4), np.ones(3)) if target is None else self._pose(target)
            position = self.vector(path, f"physics:localPos{side}", 3)
            local = np.zeros(3) if position is None else position * scale * self.metre
            body = self._body_of(target)
            onto = np.eye(4) if body == target else at if body == _WORLD else inverse(self._pose(body)[0]) @ at
            bodies.append(body)
            frames.append(onto @ self._local(local, self.vector(path, f"physics:localRot{side}", 4)))
        if bodies[0] == bodies[1]:
            self.notes.append(Note("left out", f"joint {name}, whose two sides are one body"))
            return []
        excluded = bool(self.value(path, "physics:excludeFromArticulation"))
        return [_Edge(path, name, kind, (bodies[0], bodies[1]), (frames[0], frames[1]), axis, excluded)]

    def _kind(self, path: str) -> tuple[JointKind | Literal["several"] | None, Array]:
        """Kind and axis of a joint; of a generic one, by the directions that are not locked."""
        of = self.prims[path]["type"]
        if of != "PhysicsJoint":
            axis = self.value(path, "physics:axis", "X")
            if axis not in _AXES:
                raise refused(self.file, f"joint {path} has the axis {str(axis)[:60]!r}", "Write X, Y or Z.")
            return _KINDS.get(of), _AXES[axis]
        free = self._free(path)
        if len(free) == 1:
            return "prismatic" if free[0].startswith("trans") else "revolute", _AXES[free[0][-1]]
        if not free or free == _BALL:
            return "spherical" if free else "fixed", _AXES["X"]
        return ("several" if len(free) <= 3 else None), _AXES["X"]

    def _free(self, path: str) -> list[str]:
        """Directions of a generic joint that are not locked; a locked one has a lower limit above the upper one."""
        limits = {dof: [self.value(path, f"limit:{dof}:physics:{end}") for end in ("low", "high")] for dof in _DOFS}
        return [dof for dof, (low, high) in limits.items() if low is None or high is None or low <= high]

    def _spanned(self, edges: list[_Edge], links: dict[str, RobotLink]) -> tuple[list[TreeJoint], list[ClosingJoint]]:
        """Joints of the tree, from the world on, and those that close loops; bodies become links on the way."""
        reached, joints, left = {_WORLD: _WORLD}, list[TreeJoint](), list(edges)
        jointed = {body for edge in edges for body in edge.bodies}
        for root in [_WORLD, *self._roots_first(edges)]:
            if root not in jointed or (root in reached and root != _WORLD):
                continue
            if root != _WORLD:
                name = reached[root] = self.bodies[root]
                links[name] = self._link(root)
                joints.append(TreeJoint(f"{name} free", "floating", _WORLD, name, self._pose(root)[0], _AXES["Z"]))
            while edge := _outward(left, reached):
                left.remove(edge)
                joints += self._joint(edge, edge.bodies[0] in reached, reached, links)
        if loose := [name for path, name in self.bodies.items() if path not in jointed]:
            self.notes.append(Note("left out", f"bodies without joints: {', '.join(loose)[:500]}"))
        return joints, [self._closing(edge, reached) for edge in left]

    def _roots_first(self, edges: list[_Edge]) -> list[str]:
        """Bodies, roots of articulations first, then those that no joint carries."""
        carried = {edge.bodies[1] for edge in edges}
        roots = [path for path in self.bodies if "PhysicsArticulationRootAPI" in self.prims[path]["schemas"]]
        return [*roots, *(body for body in self.bodies if body not in carried), *self.bodies]

    def _joint(
        self, edge: _Edge, forward: bool, reached: dict[str, str], links: dict[str, RobotLink]
    ) -> list[TreeJoint]:
        """A joint from the body that is reached to the other one; the latter's own frame may lie beside the joint."""
        near, far = (0, 1) if forward else (1, 0)
        body = edge.bodies[far]
        name = reached[body] = self.bodies[body]
        links[name] = self._link(body)
        parent, placement, offset = reached[edge.bodies[near]], edge.frames[near], inverse(edge.frames[far])
        if edge.kind == "fixed":
            return [TreeJoint(edge.name, "fixed", parent, name, placement @ offset, edge.axis)]
        parts = [(edge.name, edge.kind, edge.axis)]
        if edge.kind == "several":
            parts = [
                (f"{edge.name} {dof}", "prismatic" if dof.startswith("trans") else "revolute", _AXES[dof[-1]])
                for dof in self._free(edge.path)
            ]
            text = f"joint {edge.name} is several joints, in the order {', '.join(dof for dof, _, _ in parts)}"
            self.notes.append(Note("approximate" if len(parts) > 2 else "exact", text))
        made: list[TreeJoint] = []
        last = name if np.array_equal(offset, np.eye(4)) else f"{name} frame"
        for part, kind, axis in parts if forward else reversed(parts):
            child = last if len(made) == len(parts) - 1 else f"{part} frame"
            if child != name:
                links[child] = RobotLink(child, massless=True)
            moving = replace(edge, name=part, kind=kind, axis=axis)
            moved = self._moving(moving, parent, child, placement, axis if forward else -axis)
            made.append(moved if len(parts) == 1 else replace(moved, reference=0.0))
            parent, placement = child, np.eye(4)
        mount = [TreeJoint(f"{name} mount", "fixed", last, name, offset, edge.axis)] if last != name else []
        return [*made, *mount]

    def _moving(self, edge: _Edge, parent: str, child: str, placement: Array, axis: Array) -> TreeJoint:
        sliding = edge.kind == "prismatic"
        dof = "linear" if sliding else "angular"
        if self.prims[edge.path]["type"] == "PhysicsJoint":
            dof = ("trans" if sliding else "rot") + "XYZ"[int(np.argmax(np.abs(axis)))]
        unit = self.metre if sliding else math.pi / 180
        force = self.kilogram * (self.metre if sliding else self.metre**2)
        inertia = self.kilogram * (1.0 if sliding else self.metre**2)
        generic = f"limit:{dof}:physics:"
        low, high = (
            self.value(edge.path, f"physics:{word}Limit", self.value(edge.path, generic + short, sign * math.inf))
            for word, short, sign in (("lower", "low", -1), ("upper", "high", 1))
        )
        others = [x.format(dof=dof) for x in _OTHER_FORCES]
        if told := [x for x in others if self.number(edge.path, x, 0.0)]:
            self.notes.append(Note("left out", f"{', '.join(told)} of joint {edge.name}"))
        if edge.kind == "spherical":
            return TreeJoint(edge.name, "spherical", parent, child, placement, axis)
        armature = next((x for x in (self.number(edge.path, k.format(dof=dof), 0.0) for k in _ARMATURE) if x), 0.0)
        viscous = self.number(edge.path, f"physxJointAxis:{dof}:viscousFrictionCoefficient", 0.0)
        dry = self.number(edge.path, f"physxJointAxis:{dof}:dynamicFrictionEffort", 0.0)
        mjc = {key: self.number(edge.path, f"mjc:{key}", 0.0) for key in ("damping", "frictionloss")}
        speed = self.number(edge.path, "physxJoint:maxJointVelocity", 0.0)
        driven = any(name.startswith("PhysicsDriveAPI") for name in self.prims[edge.path]["schemas"])
        return TreeJoint(
            edge.name,
            "prismatic" if sliding else "revolute",
            parent,
            child,
            placement,
            axis,
            limits=(low * unit, high * unit) if math.isfinite(low) and math.isfinite(high) and low < high else None,
            velocity=speed * unit if 0 < speed < 1e5 else None,
            effort=self.number(edge.path, f"drive:{dof}:physics:maxForce", 0.0) * force or None,
            damping=viscous * (self.kilogram if sliding else force / unit) + mjc["damping"] * inertia,
            friction=dry * force + mjc["frictionloss"] * force,
            armature=armature * inertia,
            reference=self._reference(edge),
            actuated=driven if self._any_drive() else None,
        )

    def _any_drive(self) -> bool:
        return any(name.startswith("PhysicsDriveAPI") for prim in self.prims.values() for name in prim["schemas"])

    def _reference(self, edge: _Edge) -> float:
        """Position of a joint where the stage places its bodies."""
        ends = [
            (np.eye(4) if body == _WORLD else self._pose(body)[0]) @ frame
            for body, frame in zip(edge.bodies, edge.frames, strict=True)
        ]
        turned = inverse(ends[0]) @ ends[1]
        if edge.kind == "prismatic":
            found = float(turned[:3, 3] @ edge.axis)
        else:
            R = turned[:3, :3]
            twist = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
            found = math.atan2(float(twist @ edge.axis) / 2, (float(np.trace(R)) - 1) / 2)
        return found if abs(found) > 10 * _SINGLE else 0.0

    def _closing(self, edge: _Edge, reached: Mapping[str, str]) -> ClosingJoint:
        if edge.kind not in ("revolute", "prismatic", "spherical"):
            found = f"joint {edge.path} is neither revolute, prismatic nor spherical, and closes a loop"
            raise refused(self.file, found, "Disable it, or another joint of its loop.")
        twins = [x for x in self.names if x != edge.path and self._bodies_at(x) == self._bodies_at(edge.path)]
        if twins:
            found = f"joints {edge.path} and {twins[0]} connect the same two bodies"
            raise refused(self.file, found, "If it was converted from MJCF, import that; else add a body between them.")
        onto = np.eye(4) if edge.kind == "spherical" else least_turn(edge.axis)
        ends = [(reached[body], frame @ onto) for body, frame in zip(edge.bodies, edge.frames, strict=True)]
        return ClosingJoint(edge.name, edge.kind, *ends[0], *ends[1])

    def _bodies_at(self, path: str) -> frozenset[str]:
        relations = self.prims[path]["relations"]
        return frozenset(self._body_of(next(iter(relations.get(f"physics:body{k}", ())), None)) for k in "01")

    def _follows(self, edge: _Edge, edges: list[_Edge]) -> list[Follows]:
        """Mimic joints: position + gearing * reference + offset = 0 of PhysX, or coef0 + coef1 * leader of Newton."""
        relations = self.prims[edge.path]["relations"]
        made: list[Follows] = []
        for name, targets in relations.items():
            start, _, last = name.rpartition(":")
            physx = start.startswith("physxMimicJoint") and last == "referenceJoint"
            if not targets or not (physx or name == "newton:mimicJoint"):
                continue
            leader = next((x for x in edges if x.path == targets[0]), None)
            if leader is None or leader.kind != edge.kind:
                text = f"mimic of joint {edge.name}, which follows no joint of its kind; it moves by itself here"
                self.notes.append(Note("left out", text))
                continue
            keys = (f"{start}:gearing", f"{start}:offset") if physx else ("newton:mimicCoef1", "newton:mimicCoef0")
            sign = -1.0 if physx else 1.0
            unit = self.metre if edge.kind == "prismatic" else math.pi / 180
            factor, offset = self.number(edge.path, keys[0], 1.0), self.number(edge.path, keys[1], 0.0)
            if physx and offset and edge.kind == "revolute":
                self.notes.append(Note("approximate", f"offset of the mimic joint {edge.name}: taken in degrees"))
            made.append(Follows(edge.name, {leader.name: sign * factor}, sign * offset * unit))
        return made[:1]

    def _link(self, body: str) -> RobotLink:
        shapes = [
            self._shape(path, body)
            for path in self.prims
            if self.prims[path]["role"] == "shape" and self._body_of(path) == body
        ]
        given = tuple(shape for shape in shapes if shape is not None)
        inertial = self._inertial(body, given, len(shapes) - len(given))
        return RobotLink(self.bodies[body], inertial, shapes=given, other_shapes=len(shapes) - len(given))

    def _inertial(self, body: str, shapes: tuple[LinkShape, ...], others: int) -> Inertial | None:
        """Mass, centre and inertia where all three are given: USD computes the others from shapes, and so a guess."""
        mass = self.number(body, "physics:mass", 0.0)
        if mass < 0:
            raise refused(self.file, f"{body} has the mass {mass:g}", "A mass is zero or above.")
        diagonal = self.vector(body, "physics:diagonalInertia", 3)
        com = self.vector(body, "physics:centerOfMass", 3)
        if com is None and not others and not any(shape.frame[:3, 3].any() for shape in shapes):
            com = np.zeros(3)
        if mass == 0 or diagonal is None or not diagonal.any() or com is None:
            return None
        if (diagonal < 0).any():
            raise refused(self.file, f"{body} has a negative moment of inertia", "Moments are zero or above.")
        R = self._local(np.zeros(3), self.vector(body, "physics:principalAxes", 4))[:3, :3]
        J = R @ np.diag(diagonal) @ R.T * self.kilogram * self.metre**2
        return Inertial(mass * self.kilogram, com * self._pose(body)[1] * self.metre, J)

    def _shape(self, path: str, body: str) -> LinkShape | None:
        at, scale = self._pose(path)
        scale = scale * self.metre
        frame = inverse(self._pose(body)[0]) @ at
        kind, axis = self.prims[path]["type"], self.value(path, "axis", "Z")
        if kind == "Cube":
            size = self.number(path, "size", 2.0) * scale
            return LinkShape("box", (float(size[0]), float(size[1]), float(size[2])), frame)
        if kind not in ("Sphere", "Capsule", "Cylinder") or axis not in _AXES or np.ptp(scale) > 1e-6 * scale.max():
            return None
        radius = self.number(path, "radius", 1.0 if kind != "Capsule" else 0.5) * float(scale[0])
        if kind == "Sphere":
            return LinkShape("sphere", (radius,), frame)
        length = self.number(path, "height", 2.0 if kind == "Cylinder" else 1.0) * float(scale[0])
        word: Literal["capsule", "cylinder"] = "capsule" if kind == "Capsule" else "cylinder"
        return LinkShape(word, (radius, length), frame @ least_turn(_AXES[axis]))


def _outward(edges: list[_Edge], reached: Mapping[str, str]) -> _Edge | None:
    """A joint from what is reached to a new body; those excluded from the articulation last: they close loops."""
    found = [edge for edge in edges if (edge.bodies[0] in reached) != (edge.bodies[1] in reached)]
    return min(found, key=lambda edge: edge.excluded, default=None)


def _short_names(paths: list[str]) -> dict[str, str]:
    """The last part of a prim's path, or the whole path where two would be the same."""
    last = [path.rpartition("/")[2] for path in paths]
    return {path: name if last.count(name) == 1 else path[1:] for path, name in zip(paths, last, strict=True)}
