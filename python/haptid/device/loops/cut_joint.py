"""Named cut joints, on which terms act: position and rates of frame b relative to frame a."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.geometry import joint_poses
from haptid.device.loops.formula import AnyClosure
from haptid.device.loops.relations import nearest, relation_text
from haptid.device.parts import Cut, Frame, Joint
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceFileError

# Random poses at which the rates of a cut joint are compared.
_POSES = 8
# Rates that differ by less than this are one.
_SAME = 1e-6


@dataclass(frozen=True, eq=False)
class CutJoint:
    """A cut joint that has a name: its position is that of frame b in frame a, along or about z.

    Attributes:
        name: of the joint.
        prismatic: whether it slides.
        row: its position as a combination of the active joints' positions, (active,).
        offset: its position where they are zero, rad, within half a turn of zero, or m.
        relation: as text, such as "q10 = -q2 + q5".
    """

    name: str
    prismatic: bool
    row: Array
    offset: float
    relation: str

    def __post_init__(self) -> None:
        freeze_fields(self, "row")

    def positions(self, qa: Array) -> Array:
        """Its positions, (samples,), rad or m, from the active joints', (active, samples)."""
        return np.asarray(self.row @ qa + self.offset)


def cut_joints(
    joints: Sequence[Joint], active: tuple[int, ...], closure: AnyClosure, place: Place
) -> tuple[CutJoint, ...]:
    """The cuts that have a name, in the file's order.

    Raises:
        DeviceFileError: the rates of one by the active joints vary with the pose.
    """
    named = [cut for cut in closure.cuts if cut.name is not None]
    if not named:
        return ()
    qa = closure.draw(np.random.default_rng(0), _POSES)
    followed = closure.follow(qa)
    links = joint_poses(joints, followed.q.T)
    G = np.broadcast_to(followed.G, (_POSES, *followed.G.shape[-2:]))
    cuts = []
    for cut in named:
        if cut.kind == "spherical":
            found = f"the spherical cut {cut.name} has a name, but three rates, so that terms cannot act on it"
            raise place.error(found, "Remove its name.")
        rates = _rates(joints, cut, links, G)
        spread = float(np.ptp(rates, axis=0).max())
        if spread > _SAME:
            raise DeviceFileError(
                f"{place}: the cut joint {cut.name} has a name, but its rates by the active joints vary with the pose, "
                f"by {spread:.3g} (limit {_SAME:.0e}), so that terms cannot act on it.",
                where=place.key,
                found=spread,
                limit=_SAME,
                advice="Remove its name, or cut the loop at another joint and list this one in joints.",
            )
        cuts.append(_joint(joints, active, cut, rates[0], float(_position(cut, links)[0]), qa[:, 0]))
    return tuple(cuts)


def _joint(
    joints: Sequence[Joint], active: tuple[int, ...], cut: Cut, rates: Array, position: float, qa: Array
) -> CutJoint:
    """A cut joint from its rates, and its position at one pose of the active joints; rounded to simple fractions."""
    row = np.array([nearest(float(rate), 1 / 12) for rate in rates])
    offset = position - float(row @ qa)
    if cut.kind == "revolute":
        turns = math.ceil(offset / (2 * math.pi) - 0.5 - 1e-9)
        offset = nearest(offset - 2 * math.pi * turns, math.pi / 12)
    name = str(cut.name)
    relation = relation_text([*(joint.name for joint in joints), name], len(joints), active, row, offset)
    return CutJoint(name, cut.kind == "prismatic", row, offset, relation)


def _position(cut: Cut, links: Array) -> Array:
    """Angle of the x axis of frame b, or position of its origin, in frame a, (n,), from poses of links."""
    a, b = (_pose(frame, links) for frame in (cut.frame_a, cut.frame_b))
    if cut.kind == "prismatic":
        return np.asarray(np.einsum("ni,ni->n", a[:, :3, 2], b[:, :3, 3] - a[:, :3, 3]))
    x, y = (np.einsum("ni,ni->n", a[:, :3, axis], b[:, :3, 0]) for axis in (0, 1))
    return np.asarray(np.arctan2(y, x))


def _rates(joints: Sequence[Joint], cut: Cut, links: Array, G: Array) -> Array:
    """Rates of a cut joint, (n, active): those of frame b along or about the common axis, less those of frame a.

    Args:
        joints: of the tree.
        cut: the joint cut.
        links: poses, (n, joints, 4, 4).
        G: rates of all joints, (n, joints, active).
    """
    axis, sliding = _pose(cut.frame_a, links)[:, :3, 2], cut.kind == "prismatic"
    rates = np.zeros((len(links), G.shape[2]))
    for frame, sign in ((cut.frame_b, 1.0), (cut.frame_a, -1.0)):
        origin = _pose(frame, links)[:, :3, 3]
        k = frame.link
        while k >= 0:
            z, slides = links[:, k, :3, 2], joints[k].prismatic
            if sliding and not slides:
                z = np.cross(z, origin - links[:, k, :3, 3])
            if sliding or not slides:  # a sliding joint turns nothing
                rates += sign * np.einsum("ni,ni->n", axis, z)[:, None] * G[:, k]
            k = joints[k].parent
    return rates


def _pose(frame: Frame, links: Array) -> Array:
    """Poses of a frame, (n, 4, 4)."""
    local = np.eye(4)
    local[:3, :3], local[:3, 3] = frame.rotation, frame.translation
    return np.asarray(links[:, frame.link] @ local) if frame.link >= 0 else np.broadcast_to(local, (len(links), 4, 4))
