"""SDF: models, links, joints and poses relative to frames.

Source: http://sdformat.org, specification 1.11, "Pose frame semantics".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.geometry import least_turn
from haptid.robot_files.paths import Roots
from haptid.robot_files.sdf_models import CANONICAL, OWN_FRAME, WORLD, Models, canonical_link
from haptid.robot_files.tree import (
    ClosingJoint,
    Follows,
    Inertial,
    JointKind,
    Note,
    RobotLink,
    RobotTree,
    TreeJoint,
    checked_inertial,
    inverse,
    pose,
    snapped_axis,
    unit_axis,
)
from haptid.robot_files.xml import Element

_GRAVITY = (0.0, 0.0, -9.8)
_KINDS: Mapping[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "ball": "spherical",
}
_CLOSING: Mapping[str, Literal["revolute", "prismatic", "spherical"]] = {
    "revolute": "revolute",
    "prismatic": "prismatic",
    "spherical": "spherical",
}
_TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_sdf(root: Element, roots: Roots, snap: float = 0.0) -> RobotTree:
    """The tree of an SDF: its first model with joints, and the models in that.

    Args:
        root: `<sdf>`.
        roots: folders that included models may be in.
        snap: angles nearer than this to a quarter turn are made one, rad.

    Raises:
        RobotFileError: what is wrong, with the line.
    """
    world = root.first("world")
    places = [x for place in (root, *root.all("world")) for x in place.children if x.tag in ("model", "include")]
    if not places:
        root.refuse("has no <model>", "Give the SDF of a robot.")
    models = Models(roots)
    found = [models.flat(models.resolved(place)) for place in places]
    chosen = next((model for model in found if model.first("joint") is not None), found[0])
    return _Model(chosen, world, snap, len(found)).tree()


class _Model:
    """Reads one model."""

    def __init__(self, model: Element, world: Element | None, snap: float, models: int) -> None:
        self.model, self.snap = model, snap
        self.notes: list[Note] = []
        gravity = None if world is None else world.first("gravity")
        self.gravity: tuple[float, ...] = _GRAVITY
        if gravity is None:
            text = f"gravity: taken as SDF's default, {' '.join(map(str, _GRAVITY))} m/s^2"
            self.notes.append(Note("approximate", text))
        else:
            self.gravity = gravity.numbers_of("gravity", gravity.text, 3)
        if models > 1:
            self.notes.append(Note("left out", f"{models - 1} more models"))
        self.links = {element.name(): element for element in model.all("link")}
        if not self.links:
            model.refuse("has no <link>", "Give the SDF of a robot.")
        if len(self.links) < len(model.all("link")):
            model.refuse("has two links of one name", "Rename one of them.")
        self.joints = {element.name(): element for element in model.all("joint")}
        self.frames = {element.name(): element for element in model.all("frame")}
        self.poses: dict[str, Array] = {OWN_FRAME: np.eye(4)}

    def tree(self) -> RobotTree:
        """The tree."""
        links = {WORLD: RobotLink(WORLD)}
        links |= {
            name: RobotLink(name, self._inertial(element), line=element.line) for name, element in self.links.items()
        }
        joints: list[TreeJoint] = []
        closing: list[ClosingJoint] = []
        follows: list[Follows] = []
        owned: set[str] = set()
        for name, element in self.joints.items():
            parent, child = (self._link_of(element, role) for role in ("parent", "child"))
            made = self._joint(element, name, parent, child)
            if child in owned:
                closing.append(self._closing(element, made))
                continue
            owned.add(child)
            offset = inverse(self.pose_of(name)) @ self.pose_of(child)
            if np.array_equal(offset, np.eye(4)):
                joints.append(made)
            else:  # the link's own frame is not at the joint: a frame there carries it
                links[f"{name} frame"] = RobotLink(f"{name} frame", massless=True)
                joints.append(replace(made, child=f"{name} frame"))
                joints.append(TreeJoint(f"{name} mount", "fixed", f"{name} frame", child, offset, made.axis))
            follows += self._mimic(element, name)
        if self._text(self.model.first("static")) in ("true", "1"):
            self.model.refuse("is static: nothing of it moves", "Give the SDF of a robot.")
        return RobotTree(
            name=self.model.attributes.get("name", "robot") or "robot",
            file=self.model.file,
            form="sdf",
            gravity=np.array(self.gravity),
            links={name: link for name, link in links.items() if name != WORLD or self._has_world(joints)},
            joints=tuple(joints),
            follows=tuple(follows),
            closing=tuple(closing),
            notes=tuple(self.notes),
        )

    @staticmethod
    def _has_world(joints: list[TreeJoint]) -> bool:
        return any(joint.parent == WORLD for joint in joints)

    @staticmethod
    def _text(element: Element | None) -> str:
        return "" if element is None else element.text.strip()

    def _link_of(self, joint: Element, role: str) -> str:
        """The link that a joint's parent or child is, or to which a frame, joint or model of that name is fixed."""
        name = at = self._text(joint.only(role))
        passed: set[str] = set()
        while at not in self.links and at != WORLD:
            if at in passed:
                joint.refuse(f"has the {role} {name!r}, which is attached to itself", "Correct attached_to.")
            passed.add(at)
            if at == OWN_FRAME:
                at = canonical_link(self.model)
            elif at in self.frames:
                frame = self.frames[at].attributes
                at = frame.get(CANONICAL, "").strip() or frame.get("attached_to", "").strip() or OWN_FRAME
            elif at in self.joints:
                at = self._text(self.joints[at].only("child"))
            else:
                joint.refuse(f"has the {role} {name!r}, which is no link or frame", "Name a link of this model.")
        return at

    def _own_pose(self, element: Element) -> Array:
        found = element.first("pose")
        if found is None or not found.text.strip():
            return np.eye(4)
        words = found.text.split()
        if found.attributes.get("rotation_format", "euler_rpy") != "euler_rpy":
            found.refuse("has a rotation as a quaternion", "Write roll, pitch and yaw.")
        values = found.numbers_of("pose", " ".join(words), 6)
        if found.attributes.get("degrees") == "true":
            values = (*values[:3], *np.radians(values[3:]).tolist())
        return pose(values[:3], values[3:], self.snap)

    def pose_of(self, name: str) -> Array:
        """Pose of a link, joint or frame in the model's frame, (4, 4)."""
        stack = [name]
        while stack:
            top = stack[-1]
            if top in self.poses:
                stack.pop()
                continue
            element = self.links.get(top) or self.joints.get(top) or self.frames.get(top)
            if element is None:
                self.model.refuse(f"has no link, joint or frame {top!r}", "Correct the name in relative_to.")
            at = element.first("pose")
            above = "" if at is None else at.attributes.get("relative_to", "").strip()
            if not above and top in self.joints and top not in self.links:
                above = self._text(element.first("child"))
            if not above and top in self.frames:
                above = element.attributes.get("attached_to", "").strip()
            above = above or OWN_FRAME
            if above == WORLD:
                above = OWN_FRAME
            if above in self.poses:
                self.poses[top] = self.poses[above] @ self._own_pose(element)
            elif above in stack:
                element.refuse("has a pose relative to itself", "Correct relative_to.")
            else:
                stack.append(above)
        return self.poses[name]

    def _inertial(self, link: Element) -> Inertial | None:
        element = link.first("inertial")
        if element is None:
            return None
        mass = element.first("mass")
        tensor = element.first("inertia")
        entries = dict.fromkeys(_TENSOR, 0.0) | {"ixx": 1.0, "iyy": 1.0, "izz": 1.0}  # the specification's defaults
        if tensor is None:
            text = f"link {link.name()} has no inertia: 1 kg m^2 is SDF's default, and was not taken"
            self.notes.append(Note("approximate", text, element.line))
            entries = dict.fromkeys(_TENSOR, 0.0)
        else:
            for key in _TENSOR:
                found = tensor.first(key)
                if found is not None:
                    entries[key] = found.numbers_of(key, found.text, 1)[0]
        xx, xy, xz, yy, yz, zz = (entries[key] for key in _TENSOR)
        value = 1.0 if mass is None else mass.numbers_of("mass", mass.text, 1)[0]
        J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return checked_inertial(value, np.zeros(3), J, element).moved(self._own_pose(element))

    def _joint(self, element: Element, name: str, parent: str, child: str) -> TreeJoint:
        given = element.name("type")
        kind = _KINDS.get(given)
        if kind is None:
            text = f"{given} joint {name} is held as the source places it"
            self.notes.append(Note("approximate", text, element.line))
            kind = "fixed"
        at = self.pose_of(name)
        base = np.eye(4) if parent == WORLD else self.pose_of(parent)
        axis, dynamics, limit = np.array([0.0, 0.0, 1.0]), None, None
        table = element.first("axis")
        if kind in ("revolute", "prismatic") and table is not None:
            axis = self._axis(table, at)
            dynamics, limit = table.first("dynamics"), table.first("limit")
        low, high = _value(limit, "lower", -1e16), _value(limit, "upper", 1e16)
        speed, effort = _value(limit, "velocity", -1.0), _value(limit, "effort", -1.0)
        return TreeJoint(
            name=name,
            kind=kind,
            parent=parent,
            child=child,
            placement=inverse(base) @ at,
            axis=axis,
            limits=(low, high) if kind != "fixed" and -1e15 < low < high < 1e15 else None,
            velocity=speed if 0 < speed < 1e15 else None,
            effort=effort if 0 < effort < 1e15 else None,
            damping=_value(dynamics, "damping", 0.0),
            friction=_value(dynamics, "friction", 0.0),
            stiffness=_value(dynamics, "spring_stiffness", 0.0),
            rest=_value(dynamics, "spring_reference", 0.0),
            line=element.line,
        )

    def _axis(self, table: Element, at: Array) -> Array:
        xyz = table.only("xyz")
        axis = unit_axis(xyz.numbers_of("xyz", xyz.text, 3), xyz)
        frame = xyz.attributes.get("expressed_in", "").strip()
        old = self._text(table.first("use_parent_model_frame")) in ("1", "true")
        if frame or old:
            R = np.eye(3) if old or frame == OWN_FRAME else self.pose_of(frame)[:3, :3]
            axis = at[:3, :3].T @ R @ axis
        return snapped_axis(axis, self.snap)

    def _closing(self, element: Element, joint: TreeJoint) -> ClosingJoint:
        kind = _CLOSING.get(joint.kind)
        if kind is None:
            element.refuse("closes a loop, and is neither revolute, prismatic nor ball", "Open the loop there.")
        at = self.pose_of(joint.name)
        onto = np.eye(4) if joint.kind == "spherical" else least_turn(joint.axis)
        ends = [np.eye(4) if link == WORLD else self.pose_of(link) for link in (joint.parent, joint.child)]
        frames = [inverse(end) @ at @ onto for end in ends]
        return ClosingJoint(
            joint.name,
            kind,
            joint.parent,
            frames[0],
            joint.child,
            frames[1],
            line=element.line,
        )

    def _mimic(self, element: Element, name: str) -> list[Follows]:
        found = next((x for x in element.walk() if x.tag == "mimic"), None)
        if found is None:
            return []
        factor, offset, reference = (
            0.0 if found.first(key) is None else _one(found, key) for key in ("multiplier", "offset", "reference")
        )
        if found.first("multiplier") is None:
            factor = 1.0
        return [Follows(name, {found.name("joint"): factor}, offset - factor * reference, found.line)]


def _value(element: Element | None, key: str, default: float) -> float:
    return default if element is None or element.first(key) is None else _one(element, key)


def _one(element: Element, key: str) -> float:
    found = element.only(key)
    return found.numbers_of(key, found.text, 1, unlimited=True)[0]
