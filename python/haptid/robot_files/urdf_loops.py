"""Loops of a URDF, which cannot have them: joints in `<gazebo>`, and frames that an exporter writes at both ends.

Sources: http://classic.gazebosim.org/tutorials?tut=kinematic_loop (a joint of SDF in the extension of a URDF), and
onshape-to-robot (https://github.com/Rhoban/onshape-to-robot), whose frames `closing_NAME_1` and `closing_NAME_2` meet.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from haptid._internal.arrays import Array
from haptid.device.geometry import least_turn
from haptid.robot_files.tree import ClosingJoint, Drive, Follows, Note, RobotLink, TreeJoint, inverse, pose, unit_axis
from haptid.robot_files.xml import Element

_KINDS: Mapping[str, Literal["revolute", "prismatic", "spherical"]] = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "ball": "spherical",
}
_END = re.compile(r"closing_(?P<loop>.+)_[12]")
# Words by which authors call the ends of a loop that they close in a file of their own.
_CALLED = re.compile(r"clos(?:ed|ing|ure)[_-]?loop|loop[_-]?clos", re.I)
# Ends farther apart than this, m, do not meet where the joints are at zero.
_MEET = 1e-6
# Random positions from which a closed pose is searched where that from zero finds none.
_STARTS = 20
_NAMED = 8
_OPEN = (
    "the device file is open there, and its torques are not those of the closed robot: give its MJCF or SDF, which "
    "have loops, or write [[loops]] with a cut into the device file"
)


def closing_joints(
    root: Element,
    links: Mapping[str, RobotLink],
    joints: Sequence[TreeJoint],
    follows: Sequence[Follows],
    drives: Sequence[Drive],
    notes: list[Note],
) -> tuple[tuple[ClosingJoint, ...], dict[str, float]]:
    """Joints that close loops, and positions of the tree's at which they do; empty where these are zero.

    What is left out, and who drives a loop, is noted.
    """
    above = {joint.child: joint for joint in joints}
    found = [
        *(_in_gazebo(child, links, above, notes) for gazebo in root.all("gazebo") for child in gazebo.all("joint")),
        *(_between(*ends) for ends in _ends(links)),
    ]
    made = []
    for cut in (cut for cut in found if cut is not None):
        way = _way(cut.link_a, above) ^ _way(cut.link_b, above)
        if way & {relation.joint for relation in follows}:
            notes.append(Note("left out", f"{cut.name}, which closes a loop that <mimic> closes", cut.line))
        else:
            made.append(cut)
    made, at = _met(made, above, notes)
    if made and not drives:
        notes.append(
            Note("approximate", "no transmission says what drives the loops: joints nearest the base are taken")
        )
    used = {end for cut in made for end in (cut.link_a, cut.link_b)}
    open_joints = (one.name for one in joints if one.child not in used)
    called = [name for name in dict.fromkeys((*links, *open_joints)) if _CALLED.search(name) and name not in used]
    if called:
        names = ", ".join(called[:_NAMED]) + (", ..." if len(called) > _NAMED else "")
        notes.append(Note("left out", f"loops at {names}, by their names: {_OPEN}"))
    return tuple(made), at


def _in_gazebo(
    element: Element, links: Mapping[str, RobotLink], above: Mapping[str, TreeJoint], notes: list[Note]
) -> ClosingJoint | None:
    """A joint in an extension; its pose is in the frame of its child, its axis in that of its own or of the model."""
    name, kind = element.attributes.get("name", ""), _KINDS.get(element.attributes.get("type", ""))
    parent, child = ("" if (x := element.first(role)) is None else x.text.strip() for role in ("parent", "child"))
    if kind is None or parent not in links or child not in links or parent == child:
        kind_of = "its type is none of " + ", ".join(_KINDS) if kind is None else "its links are none of this file"
        text = f"joint {name} in <gazebo>, which closes a loop: {kind_of}; {_OPEN}"
        notes.append(Note("left out", text, element.line))
        return None
    world = _at_zero(child, above)
    place, table = element.first("pose"), element.first("axis")
    at = np.eye(4)
    if place is not None and place.text.strip():
        values = place.numbers_of("pose", place.text, 6)
        at = pose(values[:3], values[3:])
    axis = np.array([0.0, 0.0, 1.0])
    if table is not None and (xyz := table.first("xyz")) is not None:
        axis = unit_axis(xyz.numbers_of("xyz", xyz.text, 3), xyz)
        old = table.first("use_parent_model_frame")
        of_model = xyz.attributes.get("expressed_in", "").strip() == "__model__"
        if of_model or (old is not None and old.text.strip() in ("1", "true")):
            axis = (world @ at)[:3, :3].T @ axis
    onto = np.eye(4) if kind == "spherical" else least_turn(axis)
    there = world @ at @ onto
    frames = [inverse(_at_zero(link, above)) @ there for link in (parent, child)]
    return ClosingJoint(name, kind, parent, frames[0], child, frames[1], line=element.line)


def _ends(links: Mapping[str, RobotLink]) -> list[tuple[str, str]]:
    """Pairs of frames of onshape-to-robot."""
    loops = dict.fromkeys(match["loop"] for name in links if (match := _END.fullmatch(name)))
    pairs = [(f"closing_{loop}_1", f"closing_{loop}_2") for loop in loops]
    return [pair for pair in pairs if {*pair} <= links.keys()]


def _between(one: str, other: str) -> ClosingJoint:
    return ClosingJoint(one.removesuffix("_1"), "spherical", one, np.eye(4), other, np.eye(4))


def _met(
    cuts: Sequence[ClosingJoint], above: Mapping[str, TreeJoint], notes: list[Note]
) -> tuple[list[ClosingJoint], dict[str, float]]:
    """Those of the cuts that close, and the positions of the joints, rad or m, at which they do where not at zero.

    Ends that are apart at zero are brought together within the limits, from zero and then from random positions.
    """
    apart = {cut.name: float(np.linalg.norm(_gaps([cut], above, {})[:3])) for cut in cuts}
    far = [cut for cut in cuts if apart[cut.name] > _MEET]
    for cut in (cut for cut in cuts if cut.kind == "spherical" and cut.line is None and cut not in far):
        text = f"{cut.link_a} and {cut.link_b} are taken for one point, where a loop is closed"
        notes.append(Note("approximate", text))
    if not far:
        return list(cuts), {}
    names = sorted(set().union(*(_way(cut.link_a, above) ^ _way(cut.link_b, above) for cut in cuts)))
    moving = [joint for joint in above.values() if joint.name in names and joint.moves]
    limits = [joint.limits or ((-np.inf, np.inf) if joint.kind == "prismatic" else (-np.pi, np.pi)) for joint in moving]
    low, high = np.array(limits, dtype=float).reshape(-1, 2).T
    rng, wide = np.random.default_rng(0), np.clip(np.array([low, high]), -np.pi, np.pi)
    starts = [np.clip(0.0, low, high), *(rng.uniform(*wide) for _ in range(_STARTS))]

    def gaps(q: Array) -> Array:
        return _gaps(cuts, above, dict(zip((joint.name for joint in moving), q, strict=True)))

    for start in starts if moving and (low < high).all() else ():
        found = least_squares(gaps, start, bounds=(low, high), xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(gaps(found.x)).max() < _MEET:
            at = dict(zip((joint.name for joint in moving), map(float, found.x), strict=True))
            for cut in far:
                where = ", ".join(f"{name} = {value:.4g}" for name, value in at.items())
                text = (
                    f"{cut.link_a} and {cut.link_b} are {apart[cut.name]:.3g} m apart with all joints at zero; "
                    f"the loop is closed from where a search within the limits let them meet, {where}: of several "
                    "assemblies, check that this is the robot's"
                )
                notes.append(Note("approximate", text))
            return list(cuts), at
    for cut in far:
        text = (
            f"the loop between {cut.link_a} and {cut.link_b}, which are {apart[cut.name]:.3g} m apart with all joints "
            f"at zero, and meet at no position within the joints' limits that a search found; {_OPEN}"
        )
        notes.append(Note("left out", text))
    return [cut for cut in cuts if cut not in far], {}


def _gaps(cuts: Sequence[ClosingJoint], above: Mapping[str, TreeJoint], at: Mapping[str, float]) -> Array:
    """Distances of the ends of loops, m, and of revolute ones of their axes, (gaps,)."""
    made: list[Array] = []
    for cut in cuts:
        a, b = _at(cut.link_a, above, at) @ cut.frame_a, _at(cut.link_b, above, at) @ cut.frame_b
        made.append(a[:3, 3] - b[:3, 3])
        if cut.kind != "spherical":
            made.append(np.cross(a[:3, 2], b[:3, 2]))
    return np.concatenate(made)


def _at_zero(link: str, above: Mapping[str, TreeJoint]) -> Array:
    """Pose of a link in its root's frame where all joints are at zero, (4, 4)."""
    return _at(link, above, {})


def _at(link: str, above: Mapping[str, TreeJoint], at: Mapping[str, float]) -> Array:
    """Pose of a link in its root's frame at positions of joints, zero where left out, (4, 4)."""
    made, passed = np.eye(4), {link}
    while link in above and (joint := above[link]).parent not in passed:
        made, link = joint.placement @ _moved(joint, at.get(joint.name, 0.0)) @ made, joint.parent
        passed.add(link)
    return made


def _moved(joint: TreeJoint, position: float) -> Array:
    """The motion of a joint, (4, 4)."""
    made = np.eye(4)
    if joint.kind == "prismatic":
        made[:3, 3] = position * joint.axis
    else:
        made[:3, :3] = Rotation.from_rotvec(position * joint.axis).as_matrix()
    return made


def _way(link: str, above: Mapping[str, TreeJoint]) -> set[str]:
    """Names of the joints that carry a link."""
    made: set[str] = set()
    while link in above and above[link].name not in made:
        made.add(above[link].name)
        link = above[link].parent
    return made
