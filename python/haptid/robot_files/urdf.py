"""URDF: links, joints, mimic, transmissions. Meshes are never opened.

Source: http://wiki.ros.org/urdf/XML, and for transmissions the sources of ROS' transmission_interface.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from haptid.robot_files.tree import (
    Drive,
    Follows,
    Inertial,
    JointKind,
    LinkShape,
    Note,
    RobotLink,
    RobotTree,
    TreeJoint,
    checked_inertial,
    pose,
    snapped_axis,
    unit_axis,
)
from haptid.robot_files.urdf_loops import closing_joints
from haptid.robot_files.xml import Element, checked_ratio, parse

# Where URDF says nothing of gravity, simulators have this one.
_GRAVITY = (0.0, 0.0, -9.81)
# The fixed world, to which Drake welds a link by a joint without declaring it.
_WORLD = "world"
_KINDS: Mapping[str, JointKind] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "fixed": "fixed",
    "floating": "floating",
    "planar": "planar",
}
_TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(content: bytes, file: str, snap: float = 0.0) -> RobotTree:
    """The tree of a URDF.

    Args:
        content: of the file.
        file: its name in errors.
        snap: angles nearer than this to a quarter turn are made one, rad.

    Raises:
        RobotFileError: what is wrong, with the line.
    """
    root = parse(content, file)
    if root.tag != "robot":
        root.refuse("is not the root of a URDF, which is <robot>", "Give a URDF, MJCF or SDF.")
    notes = [Note("approximate", f"gravity: URDF has none; {' '.join(map(str, _GRAVITY))} m/s^2 was taken")]
    links: dict[str, RobotLink] = {}
    for element in root.all("link"):
        name = element.name()
        if name in links:
            element.refuse("has the name of an earlier link", "Rename one of them.")
        shapes = _shapes(element, snap)
        body, others = _inertial(element, snap, notes), len(element.all("collision")) - len(shapes)
        links[name] = RobotLink(name, body, line=element.line, shapes=shapes, other_shapes=others)
    if not links:
        root.refuse("has no <link>", "Give the URDF of a robot.")
    joints = [_joint(element, snap, notes) for element in root.all("joint")]
    if _WORLD not in links and any(joint.parent == _WORLD for joint in joints):
        links = {_WORLD: RobotLink(_WORLD), **links}
    mimics = [(element, element.first("mimic")) for element in root.all("joint")]
    follows = [_mimic(element, mimic) for element, mimic in mimics if mimic is not None]
    joints, drives = _transmissions(root, joints, notes)
    closing, closed_at = closing_joints(root, links, joints, follows, drives, notes)
    joints = [replace(joint, reference=closed_at.get(joint.name, 0.0)) for joint in joints]
    if closing and drives:  # joints without a transmission are those that the loops move
        driven = {name for drive in drives for name in drive.factors}
        joints = [replace(joint, actuated=joint.name in driven) for joint in joints]
    _gazebo(root, notes)
    return RobotTree(
        name=root.attributes.get("name", "robot").strip() or "robot",
        file=file,
        form="urdf",
        gravity=np.array(_GRAVITY),
        links=links,
        joints=tuple(joints),
        follows=tuple(follows),
        closing=closing,
        drives=tuple(drives),
        notes=tuple(notes),
    )


def _once(element: Element, tag: str, notes: list[Note]) -> Element | None:
    found = element.all(tag)
    if len(found) > 1:
        owner = element.attributes.get("name", element.tag)
        notes.append(Note("approximate", f"{owner} has {len(found)} <{tag}>; the first was taken", found[1].line))
    return found[0] if found else None


def _pose(element: Element | None, snap: float) -> np.ndarray:
    if element is None:
        return np.eye(4)
    zero = (0.0, 0.0, 0.0)
    return pose(element.triple("xyz", zero), element.triple("rpy", zero), snap)


def _inertial(link: Element, snap: float, notes: list[Note]) -> Inertial | None:
    element = _once(link, "inertial", notes)
    if element is None:
        return None
    mass = element.only("mass").number("value")
    tensor = element.first("inertia")
    entries = np.zeros(6)
    if tensor is None:
        notes.append(Note("approximate", f"link {link.name()} has a mass and no inertia", element.line))
    else:
        entries = np.array([tensor.number(name, 0.0 if name in _TENSOR[1:5:3] else None) for name in _TENSOR])
    xx, xy, xz, yy, yz, zz = entries
    at = _pose(element.first("origin"), snap)
    body = checked_inertial(mass, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), element)
    return body.moved(at)


def _shapes(link: Element, snap: float) -> tuple[LinkShape, ...]:
    """Collision shapes with sizes; meshes are never opened."""
    made: list[LinkShape] = []
    kinds: tuple[Literal["sphere", "capsule", "cylinder", "box"], ...] = ("sphere", "capsule", "cylinder", "box")
    for element in link.all("collision"):
        at, geometry = _pose(element.first("origin"), snap), element.first("geometry")
        for kind in kinds:
            shape = None if geometry is None else geometry.first(kind)
            if shape is None:
                continue
            sizes: tuple[float, ...] = (shape.number("radius", 0.0),)
            if kind == "box":
                sizes = shape.triple("size", (0.0, 0.0, 0.0))
            elif kind != "sphere":
                sizes = (*sizes, shape.number("length", 0.0))
            if min(sizes) > 0:
                made.append(LinkShape(kind, sizes, at))
    return tuple(made)


def _joint(element: Element, snap: float, notes: list[Note]) -> TreeJoint:
    name, given = element.name(), element.name("type")
    kind = _KINDS.get(given)
    if kind is None:
        element.refuse(f"has the type {given!r}", f"Write one of {', '.join(_KINDS)}.")
    axis = np.array([1.0, 0.0, 0.0])
    if kind in ("revolute", "prismatic") and (found := _once(element, "axis", notes)) is not None:
        axis = snapped_axis(unit_axis(found.triple("xyz", (1.0, 0.0, 0.0)), element), snap)
    limits, velocity, effort = _limits(element, given, kind)
    dynamics = _once(element, "dynamics", notes)
    return TreeJoint(
        name=name,
        kind=kind,
        parent=element.only("parent").name("link"),
        child=element.only("child").name("link"),
        placement=_pose(_once(element, "origin", notes), snap),
        axis=axis,
        limits=limits,
        velocity=velocity,
        effort=effort,
        damping=0.0 if dynamics is None else dynamics.number("damping", 0.0),
        friction=0.0 if dynamics is None else dynamics.number("friction", 0.0),
        line=element.line,
    )


def _limits(
    element: Element, given: str, kind: JointKind
) -> tuple[tuple[float, float] | None, float | None, float | None]:
    limit = element.first("limit")
    if limit is None or kind not in ("revolute", "prismatic"):
        return None, None, None
    lower, upper = (limit.number(key, 0.0, unlimited=True) for key in ("lower", "upper"))
    # Zeros stand for values that nobody filled in; so do limits of continuous joints.
    known = given != "continuous" and math.isfinite(lower) and math.isfinite(upper) and lower < upper
    velocity, effort = (limit.number(key, 0.0, unlimited=True) for key in ("velocity", "effort"))
    finite = [value if 0 < value < math.inf else None for value in (velocity, effort)]
    return ((lower, upper) if known else None), finite[0], finite[1]


def _mimic(element: Element, mimic: Element) -> Follows:
    factor, offset = mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
    return Follows(element.name(), {mimic.name("joint"): factor}, offset, mimic.line)


def _transmissions(root: Element, joints: list[TreeJoint], notes: list[Note]) -> tuple[list[TreeJoint], list[Drive]]:
    """Drives of simple and coupled transmissions, and joints with the inertia of their motors."""
    known = {joint.name: k for k, joint in enumerate(joints)}
    drives: list[Drive] = []
    for element in root.all("transmission"):
        form = element.attributes.get("type") or _text(element.first("type"))
        short = form.rpartition("/")[2]
        names = [joint.attributes.get("name", "") for joint in element.all("joint")]
        if any(name not in known for name in names) or not names:
            notes.append(Note("left out", f"transmission {_label(element)}: it has no known joint", element.line))
            continue
        motors = element.all("actuator")
        ratios = [x.first("mechanicalReduction") for x in (*element.all("joint"), *motors, element)]
        words = [x.text.strip() for x in ratios if x is not None and re.fullmatch(r"\s*[A-Za-z_]+\s*", x.text or "")]
        if words:
            text = f"transmission {_label(element)}: its reduction is {words[0][:40]!r}, which is no number"
            notes.append(Note("left out", text, element.line))
            continue
        sides = [element.all("joint"), motors]
        joint_ratios, motor_ratios = ([_reduction(x, element) for x in side] for side in sides)
        if short == "SimpleTransmission" and len(names) == 1:
            gear = (motor_ratios or [1.0])[0] * joint_ratios[0]
            made = [Drive(names[0], {names[0]: 1.0}, gear, element.line)]
        elif short in ("DifferentialTransmission", "FourBarLinkageTransmission") and len(names) == len(motors) == 2:
            (a, b), (na, nb), (ga, gb) = names, joint_ratios, motor_ratios
            if short == "DifferentialTransmission":
                rows, gears = ({a: na, b: nb}, {a: na, b: -nb}), (ga, gb)
            else:
                rows, gears = ({a: 1.0}, {a: 1.0, b: nb}), (ga * na, gb)
            titles = [x.attributes.get("name", f"motor {k + 1}") for k, x in enumerate(motors)]
            made = [Drive(title, row, gear, element.line) for title, row, gear in zip(titles, rows, gears, strict=True)]
        else:
            text = (
                f"transmission {_label(element)} of type {form or 'unknown'}: its joints are taken as driven directly"
            )
            notes.append(Note("left out", text, element.line))
            continue
        drives += made
        for x, drive in zip(motors, made, strict=False):
            if len(drive.factors) == 1 and (inertia := _rotor(x, drive.gear_ratio, element)):
                k = known[next(iter(drive.factors))]
                joints[k] = replace(joints[k], armature=inertia)
    return joints, drives


def _reduction(element: Element, owner: Element) -> float:
    own = element.first("mechanicalReduction") or owner.first("mechanicalReduction")
    if own is None:
        return 1.0
    value = own.numbers_of("mechanicalReduction", own.text or "1", 1)[0]
    return checked_ratio(value, "<mechanicalReduction>", own.file, own.line)


def _rotor(motor: Element, gear: float, owner: Element) -> float:
    """Inertia of a motor reflected to its joint: Drake's keys, or motorInertia."""
    drake = motor.first("drake:rotor_inertia") or owner.first("drake:rotor_inertia")
    if drake is not None:
        ratio = motor.first("drake:gear_ratio") or owner.first("drake:gear_ratio")
        gear = 1.0 if ratio is None else checked_ratio(ratio.number("value"), f"<{ratio.tag}>", ratio.file, ratio.line)
        return drake.number("value") * gear**2
    own = motor.first("motorInertia")
    return 0.0 if own is None else float(own.numbers_of("motorInertia", own.text, 1)[0] * gear**2)


def _gazebo(root: Element, notes: list[Note]) -> None:
    """Elements of simulators that change the dynamics."""
    for element in root.all("gazebo"):
        for child in element.walk():
            if child.tag in (
                "springStiffness",
                "springReference",
                "implicitSpringDamper",
                "gravity",
                "turnGravityOff",
            ):
                notes.append(
                    Note("left out", f"{child.tag} of {element.attributes.get('reference', 'gazebo')}", child.line)
                )


def _label(element: Element) -> str:
    return element.attributes.get("name", "without a name")


def _text(element: Element | None) -> str:
    return "" if element is None else element.text.strip()
