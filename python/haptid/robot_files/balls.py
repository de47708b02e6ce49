"""Ball joints of a tree as three revolute joints, and the spin of rods between two ball joints.

The first two joints are perpendicular to the line from the ball joint to the next one on its link, the third is about
it; all are at right angles where the source draws the robot. The second one is singular at a quarter turn, so that rods
may swing that far. A rod between two ball joints spins freely about that line. Without friction in the balls, a rod
that starts without spin never takes one up, whatever its moment of inertia about the line: that moment is left out, and
the third joint is held. Which rotations are held is then a choice without effect on torques and base parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.geometry import least_turn
from haptid.robot_files.tree import Inertial, Note, RobotLink, RobotTree, TreeJoint

# Share of a rod's inertia, or of its length, by which it may differ from a body that is symmetric about its line.
_SYMMETRIC = 1e-6


def with_ball_hinges(tree: RobotTree, held: Collection[str]) -> RobotTree:
    """The tree with its ball joints as three revolute joints each; those that are held stay as they are."""
    balls = [joint for joint in tree.joints if joint.kind == "spherical" and joint.name not in held]
    if not balls:
        return tree
    links, joints, notes = dict(tree.links), [], list(tree.notes)
    for joint in tree.joints:
        if joint not in balls:
            joints.append(joint)
            continue
        line = _line(tree, joint)
        onto = np.eye(4) if line is None else least_turn(line)
        above, placement = joint.parent, joint.placement @ onto
        for letter, axis in zip("xyz", np.eye(3), strict=True):
            name = f"{joint.name} {letter}"
            links[f"{name} link"] = RobotLink(f"{name} link", massless=True)
            hinge = TreeJoint(name, "revolute", above, f"{name} link", placement, axis, actuated=bool(joint.actuated))
            spins = letter == "z" and line is not None
            joints.append(replace(hinge, ball=joint.name, spins=spins, line=joint.line))
            above, placement = f"{name} link", np.eye(4)
        joints.append(TreeJoint(f"{joint.name} frame", "fixed", above, joint.child, onto.T, joint.axis))
        text = f"ball joint {joint.name} is three joints, {joint.name} x, y and z; y stays within a quarter turn"
        notes.append(Note("exact", text, joint.line))
    return replace(tree, links=links, joints=tuple(joints), notes=tuple(notes))


def _line(tree: RobotTree, joint: TreeJoint) -> Array | None:
    """The direction in the child's frame from a ball joint to the only other one of its link; None without one."""
    ends = [
        frame[:3, 3]
        for cut in tree.closing
        for link, frame in ((cut.link_a, cut.frame_a), (cut.link_b, cut.frame_b))
        if link == joint.child and cut.kind == "spherical"
    ]
    ends += [x.placement[:3, 3] for x in tree.joints if x.parent == joint.child and x.kind == "spherical"]
    lengths = [float(np.linalg.norm(end)) for end in ends]
    return ends[0] / lengths[0] if len(ends) == 1 and lengths[0] > 0 else None


def without_spin(
    tree: RobotTree, frames: Mapping[str, tuple[int, Array]], carried: Mapping[str, int], idle: Sequence[str]
) -> tuple[RobotTree, frozenset[str]]:
    """The tree with the moments of inertia of rods about the line between their ball joints left out.

    Args:
        tree: with ball joints as hinges.
        frames: for every link, the index of its moving joint and its pose there, (4, 4).
        carried: indices of the moving joints by name.
        idle: joints whose rotation nothing determines.

    Returns:
        the tree, and the joints whose link is symmetric about their axis.
    """
    links, notes, symmetric = dict(tree.links), list(tree.notes), set[str]()
    joints = {joint.name: joint for joint in tree.joints}
    for name in idle:
        on = [link for link, (k, _) in frames.items() if k == carried[name] and tree.links[link].inertial is not None]
        about = joints[name].axis
        bodies = {link: tree.links[link].inertial.moved(frames[link][1]) for link in on}  # type: ignore[union-attr]
        if not joints[name].spins or any(not _is_symmetric(body, about) for body in bodies.values()):
            text = f"the rotation of joint {name} is held: nothing drives it, and its link is not symmetric about it"
            notes.append(Note("approximate", text))
            continue
        symmetric.add(name)
        for link, body in bodies.items():
            own = frames[link][1][:3, :3].T @ about
            inertial = tree.links[link].inertial
            assert inertial is not None
            spin = float(about @ body.inertia @ about)
            thin = replace(inertial, inertia=inertial.inertia - spin * np.outer(own, own))
            links[link] = replace(tree.links[link], inertial=thin)
        text = f"joint {name} is held: a rod that spins freely, whose moment about its line no torque shows"
        notes.append(Note("exact", text))
    return replace(tree, links=links, notes=tuple(notes)), frozenset(symmetric)


def _is_symmetric(body: Inertial, axis: Array) -> bool:
    """Whether a body has its centre of mass on an axis, and equal moments across it."""
    across = body.com - axis * (axis @ body.com)
    P = np.eye(3) - np.outer(axis, axis)
    J = P @ body.inertia @ P
    apart = body.inertia - (axis @ body.inertia @ axis) * np.outer(axis, axis) - np.trace(J) / 2 * P
    size = float(np.trace(body.inertia)) + body.mass * float(body.com @ body.com)
    offset = body.mass * float(across @ across)
    return float(np.abs(apart).max()) <= _SYMMETRIC * size and offset <= _SYMMETRIC**2 * size
