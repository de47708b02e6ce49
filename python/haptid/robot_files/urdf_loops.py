"""Loops of a URDF, which cannot have them: joints in `<gazebo>`, and frames that an exporter writes at both ends.

Sources: http://classic.gazebosim.org/tutorials?tut=kinematic_loop (a joint of SDF in the extension of a URDF), and
onshape-to-robot (https://github.com/Rhoban/onshape-to-robot), whose frames `closing_NAME_1` and `closing_NAME_2` meet.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

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
) -> tuple[ClosingJoint, ...]:
    """Joints that close loops where the tree's are at zero; what is left out, and who drives a loop, is noted."""
    above = {joint.child: joint for joint in joints}
    found = [
        *(_in_gazebo(child, links, above, notes) for gazebo in root.all("gazebo") for child in gazebo.all("joint")),
        *(_between(*ends, above, notes) for ends in _ends(links)),
    ]
    made = []
    for cut in (cut for cut in found if cut is not None):
        way = _way(cut.link_a, above) ^ _way(cut.link_b, above)
        if way & {relation.joint for relation in follows}:
            notes.append(Note("left out", f"{cut.name}, which closes a loop that <mimic> closes", cut.line))
        else:
            made.append(cut)
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
    return tuple(made)


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


def _between(one: str, other: str, above: Mapping[str, TreeJoint], notes: list[Note]) -> ClosingJoint | None:
    apart = float(np.linalg.norm((_at_zero(one, above) - _at_zero(other, above))[:3, 3]))
    if apart > _MEET:
        text = f"the loop between {one} and {other}, which are {apart:.3g} m apart with all joints at zero; {_OPEN}"
        notes.append(Note("left out", text))
        return None
    name = one.removesuffix("_1")
    notes.append(Note("approximate", f"{one} and {other} are taken for one point, where a loop is closed"))
    return ClosingJoint(name, "spherical", one, np.eye(4), other, np.eye(4))


def _at_zero(link: str, above: Mapping[str, TreeJoint]) -> Array:
    """Pose of a link in its root's frame where all joints are at zero, (4, 4)."""
    made, passed = np.eye(4), {link}
    while link in above and (joint := above[link]).parent not in passed:
        made, link = joint.placement @ made, joint.parent
        passed.add(link)
    return made


def _way(link: str, above: Mapping[str, TreeJoint]) -> set[str]:
    """Names of the joints that carry a link."""
    made: set[str] = set()
    while link in above and above[link].name not in made:
        made.add(above[link].name)
        link = above[link].parent
    return made
