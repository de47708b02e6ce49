"""The neutral tree: contents of a robot description in one form for all formats, before it is a device.

Readers of all formats make one; `moving_tree` merges what does not move, and `device_file` writes it as a device file.
Names are those of the source.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Literal

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.geometry import placed, shift
from haptid.robot_files.xml import Element, refused

# Most links of a description: the longest chain that is more than a test of the reader.
MOST_LINKS = 5_000
# A direction shorter than this is none.
NO_AXIS = 1e-9
NoteGrade = Literal["exact", "approximate", "left out"]
JointKind = Literal["revolute", "prismatic", "fixed", "spherical", "floating", "planar"]


@dataclass(frozen=True)
class Note:
    """A note on how an element of the source is represented in the device file.

    Attributes:
        grade: "exact", "approximate", or "left out".
        text: what, a phrase or sentence.
        line: of the source; None where there is none.
    """

    grade: NoteGrade
    text: str
    line: int | None = None

    def __str__(self) -> str:
        at = "" if self.line is None else f" (line {self.line})"
        return f"{self.grade}{at}: {self.text}"


@dataclass(frozen=True, eq=False)
class Inertial:
    """A rigid body in its link's frame.

    Attributes:
        mass: kg.
        com: centre of mass, (3,), m.
        inertia: tensor about the centre of mass, (3, 3), kg m^2.
        guessed: the source computes it from shapes and a density.
    """

    mass: float
    com: Array
    inertia: Array
    guessed: bool = False

    def moved(self, frame: Array) -> Inertial:
        """The body in the frame in which its link has this pose, (4, 4)."""
        R = frame[:3, :3]
        return Inertial(self.mass, R @ self.com + frame[:3, 3], R @ self.inertia @ R.T, self.guessed)


def merged(bodies: Sequence[Inertial]) -> Inertial:
    """One body of several, in their common frame (parallel axes)."""
    mass = sum(body.mass for body in bodies)
    guessed = any(body.guessed for body in bodies)
    if len(bodies) == 1 or mass == 0:
        tensors = sum((body.inertia for body in bodies), np.zeros((3, 3)))
        return bodies[0] if len(bodies) == 1 else Inertial(0.0, np.zeros(3), tensors, guessed)
    com = sum((body.mass * body.com for body in bodies), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        arm = body.com - com
        inertia += body.inertia + body.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertial(mass, com, inertia, guessed)


@dataclass(frozen=True, eq=False)
class LinkShape:
    """A collision shape of a link.

    Attributes:
        kind, sizes: "sphere": radius; "capsule", "cylinder": radius and length along z; "box": its three edges, m.
        frame: its own frame in that of its link, (4, 4).
    """

    kind: Literal["sphere", "capsule", "cylinder", "box"]
    sizes: tuple[float, ...]
    frame: Array


@dataclass(frozen=True, eq=False)
class RobotLink:
    """A link.

    Attributes:
        name: in the source.
        inertial: None if the source says nothing of its mass.
        massless: it is no body of the source: a frame between two joints of one body.
        line: of the source.
        own_frame: pose in the link's frame of the frame in which the source gives its inertia, (4, 4).
        shapes: for collision checks.
        other_shapes: number of collision shapes of the source that are left out: meshes, and shapes without a size.
    """

    name: str
    inertial: Inertial | None = None
    massless: bool = False
    line: int | None = None
    own_frame: Array = field(default_factory=lambda: np.eye(4))
    shapes: tuple[LinkShape, ...] = ()
    other_shapes: int = 0


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """A joint of the source between two links.

    Pose of the child = pose of the parent * placement * motion along or about `axis`.

    Attributes:
        name, kind: "floating" and "planar" joints do not move in a device, and "spherical" ones are three hinges there.
        parent, child: names of links.
        placement: of the child's frame in the parent's at position zero, (4, 4).
        axis: unit vector in the child's frame, (3,).
        limits: lower and upper position, rad or m.
        velocity, effort: greatest, rad/s and N m, or m/s and N.
        damping, friction, armature, stiffness: N m s/rad, N m, kg m^2, N m/rad or the same for sliding.
        rest: position where the spring has no torque.
        reference: position at which the source draws the robot and closes its loops.
        motor_armature, motor_damping: the parts of armature and damping that the source gives with a motor.
        actuated: whether the source has a motor for it; None if it does not say.
        ball: name of the ball joint that it is one of three hinges of; empty for others.
        spins: it is the hinge about the line from one ball joint of its link to the other one.
        keys: of modified Denavit-Hartenberg as text or numbers, where the source gives them.
        line: of the source.
    """

    name: str
    kind: JointKind
    parent: str
    child: str
    placement: Array
    axis: Array
    limits: tuple[float, float] | None = None
    velocity: float | None = None
    effort: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    motor_armature: float = 0.0
    motor_damping: float = 0.0
    rest: float = 0.0
    reference: float = 0.0
    actuated: bool | None = None
    ball: str = ""
    spins: bool = False
    keys: Mapping[str, float | str] | None = None
    line: int | None = None

    @property
    def moves(self) -> bool:
        """Whether it has one coordinate."""
        return self.kind in ("revolute", "prismatic")


@dataclass(frozen=True)
class Follows:
    """A joint that follows others: position = offset + sum of factor * position; mimic, belts, equalities.

    `powers`: further factors, of the second and higher powers of the position of the only joint that it follows.
    """

    joint: str
    factors: Mapping[str, float]
    offset: float = 0.0
    line: int | None = None
    powers: tuple[float, ...] = ()

    def at(self, positions: Mapping[str, float]) -> float:
        """The position, from those of the joints that it follows."""
        made = self.offset + sum(factor * positions[name] for name, factor in self.factors.items())
        (first, *_) = self.factors or ("",)
        return made + sum(factor * positions[first] ** k for k, factor in enumerate(self.powers, 2))


@dataclass(frozen=True, eq=False)
class ClosingJoint:
    """A joint that closes a loop: frame a on link a meets frame b on link b, each (4, 4); z is the axis."""

    name: str
    kind: Literal["revolute", "prismatic", "spherical"]
    link_a: str
    frame_a: Array
    link_b: str
    frame_b: Array
    line: int | None = None


@dataclass(frozen=True)
class Tendon:
    """A tendon whose length is a sum of joints' positions with factors, and its force.

    Attributes:
        name: in the source.
        factors: by joint.
        stiffness, rest: force per length, and the length without force.
        damping, friction, armature: as of joints, by the rate of the length.
        line: of the source.
    """

    name: str
    factors: Mapping[str, float]
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    line: int | None = None


@dataclass(frozen=True)
class Drive:
    """A motor: shaft angle = gear_ratio * sum of factor * position."""

    name: str
    factors: Mapping[str, float]
    gear_ratio: float = 1.0
    line: int | None = None


@dataclass(frozen=True, eq=False)
class RobotTree:
    """A robot description: links, joints and what the source says of them.

    Attributes:
        name: of the robot.
        file: of the description, for errors.
        form: "urdf", "mjcf", "sdf", "symoro", "dh" or "usd".
        gravity: in the frame of the root links, (3,), m/s^2.
        links: by name.
        joints: parents before children; checked by `ordered`.
        follows, closing, drives, tendons: relations, loops, motors, and tendons with forces of their own.
        notes: what of the source is approximate or left out.
        lengths: named lengths, of formats that have them.
        open_terms: terms that the source has without values: kind of term to names of joints.
    """

    name: str
    file: str
    form: str
    gravity: Array
    links: Mapping[str, RobotLink]
    joints: tuple[TreeJoint, ...]
    follows: tuple[Follows, ...] = ()
    closing: tuple[ClosingJoint, ...] = ()
    drives: tuple[Drive, ...] = ()
    tendons: tuple[Tendon, ...] = ()
    notes: tuple[Note, ...] = ()
    lengths: Mapping[str, float | str] = field(default_factory=dict)
    open_terms: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def pose(xyz: Sequence[float], rpy: Sequence[float], snap: float = 0.0) -> Array:
    """A placement by position and roll, pitch, yaw about fixed axes, (4, 4); angles near quarter turns snapped."""
    return placed(xyz, [snapped_angle(angle, snap) for angle in rpy])


def snapped_angle(angle: float, snap: float) -> float:
    """The multiple of a quarter turn that is nearer than `snap`, rad, else the angle itself."""
    quarter = round(angle / (math.pi / 2)) * math.pi / 2
    return quarter if abs(angle - quarter) < snap else angle


def snapped_axis(axis: Array, snap: float) -> Array:
    """The coordinate axis that is nearer than `snap`, rad, else the axis itself."""
    best = np.zeros(3)
    k = int(np.argmax(np.abs(axis)))
    best[k] = np.sign(axis[k])
    return best if 0 < float(np.linalg.norm(axis - best)) < snap else axis


def inverse(frame: Array) -> Array:
    """The inverse of a pose, (4, 4)."""
    made = np.eye(4)
    made[:3, :3] = frame[:3, :3].T
    made[:3, 3] = -made[:3, :3] @ frame[:3, 3]
    return made


def motion(joint: TreeJoint, q: float) -> Array:
    """The pose that a joint's position adds, (4, 4)."""
    if joint.kind == "prismatic":
        return shift(*(q * joint.axis))
    made = np.eye(4)
    if joint.kind == "revolute" and q:
        K = np.cross(np.eye(3), joint.axis)
        made[:3, :3] += math.sin(q) * K + (1 - math.cos(q)) * K @ K
    return made


def checked_inertial(mass: float, com: Array, inertia: Array, element: Element) -> Inertial:
    """A body; refused at its element where its mass is negative."""
    if mass < 0:
        element.refuse(f"has the mass {mass:g} kg", "A mass is zero or above.")
    return Inertial(mass, np.asarray(com, dtype=float), np.asarray(inertia, dtype=float))


def unit_axis(axis: Sequence[float], element: Element) -> Array:
    """The direction of an axis; refused at its element where it has none."""
    made = np.array(axis, dtype=float)
    size = float(np.linalg.norm(made))
    if not size > NO_AXIS:
        element.refuse(f"has the axis {list(made)}", "Write a direction, such as 0 0 1.")
    return made / size if abs(size - 1) > 1e-15 else made


def ordered(tree: RobotTree) -> tuple[TreeJoint, ...]:
    """The joints with parents before children, otherwise in the source's order.

    Raises:
        RobotFileError: a name is used twice, a link does not exist or has two parents, links are in a ring, there are
            too many, or a relation names a joint that does not exist, or itself.
    """
    if len(tree.links) > MOST_LINKS:
        found = f"it has {len(tree.links)} links; at most {MOST_LINKS} are read"
        raise refused(tree.file, found, "Is this a robot? Cut it into parts.")
    above: dict[str, TreeJoint] = {}
    names: dict[str, TreeJoint] = {}
    for joint in tree.joints:
        label = f'joint "{joint.name}"'
        if joint.name in names:
            raise refused(tree.file, f"two joints are named {joint.name!r}", "Rename one of them.", joint.line)
        names[joint.name] = joint
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in tree.links:
                found = f"{label} has the {role} {link!r}, which is no link"
                raise refused(tree.file, found, "Name a link of this file.", joint.line)
        if joint.child in above:
            found = f'link "{joint.child}" has two parents: joints "{above[joint.child].name}" and "{joint.name}"'
            raise refused(tree.file, found, "A link of a tree has one; close loops in another way.", joint.line)
        above[joint.child] = joint
    children: dict[str, list[TreeJoint]] = {}
    for joint in tree.joints:
        children.setdefault(joint.parent, []).append(joint)
    made: list[TreeJoint] = []
    roots = [name for name in tree.links if name not in above]
    stack = [joint for name in reversed(roots) for joint in reversed(children.get(name, []))]
    while stack:
        joint = stack.pop()
        made.append(joint)
        stack.extend(reversed(children.get(joint.child, [])))
    if len(made) < len(tree.joints):
        ring = next(joint for joint in tree.joints if joint not in made)
        found = f'joint "{ring.name}" is in a ring of links that hangs on no root'
        raise refused(tree.file, found, "Make one of them the root, which is no joint's child.", ring.line)
    _check_relations(tree, names)
    return tuple(made)


def _check_relations(tree: RobotTree, names: Mapping[str, TreeJoint]) -> None:
    followers = [relation.joint for relation in tree.follows]
    for relation in tree.follows:
        for name in (relation.joint, *relation.factors):
            if name not in names:
                found = f'joint "{relation.joint}" follows {name!r}, which is no joint'
                raise refused(tree.file, found, "Name a joint of this file.", relation.line)
        if relation.joint in relation.factors:
            found = f'joint "{relation.joint}" follows itself'
            raise refused(tree.file, found, "Name another joint.", relation.line)
        if followers.count(relation.joint) > 1:
            found = f'joint "{relation.joint}" follows in two ways'
            raise refused(tree.file, found, "Keep one of them.", relation.line)
    on = {relation.joint: [x for x in relation.factors if x in followers] for relation in tree.follows}
    while on:
        free = [name for name, others in on.items() if not any(other in on for other in others)]
        if not free:
            relation = next(relation for relation in tree.follows if relation.joint in on)
            found = f'joint "{relation.joint}" follows joints that follow it'
            raise refused(tree.file, found, "Let one of them move by itself.", relation.line)
        for name in free:
            del on[name]
