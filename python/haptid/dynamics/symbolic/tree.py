"""The tree of a mechanism with symbols for its lengths: joints, the frames of its cuts, and poses modulo a prime."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from haptid.dynamics.symbolic import placements
from haptid.dynamics.symbolic.placements import Placement
from haptid.dynamics.symbolic.residues import Field, Residues


@dataclass(frozen=True)
class ExactJoint:
    """A joint in normal form: it turns about, or slides along, its own z axis."""

    parent: int
    prismatic: bool
    placement: Placement


@dataclass(frozen=True)
class ExactFrame:
    """A frame on a link, -1 for the base."""

    link: int
    placement: Placement


@dataclass(frozen=True)
class ExactCut:
    """A joint of a loop that was cut, and the two frames that it brings together."""

    prismatic: bool
    frame: ExactFrame
    twin: ExactFrame


def about_z(cos: Residues, sin: Residues) -> Residues:
    """Turns about z, (n, 3, 3)."""
    made = np.zeros((len(cos), 3, 3), dtype=np.int64)
    made[:, 0, 0] = made[:, 1, 1] = cos
    made[:, 0, 1], made[:, 1, 0], made[:, 2, 2] = -sin, sin, 1
    return made


def poses(
    joints: Sequence[ExactJoint], field: Field, placed: Sequence[Residues], moved: tuple[Residues, Residues, Residues]
) -> list[Residues]:
    """Poses of all links in the base frame, (n, 4, 4) each.

    Args:
        joints: of the tree.
        field: the residues' prime.
        placed: placement of every joint, (n, 4, 4) each.
        moved: cosine, sine and slide of every joint, (joints, n) each.
    """
    made: list[Residues] = []
    for joint, pose, cos, sin, slide in zip(joints, placed, *moved, strict=True):
        motion = np.zeros_like(pose)
        motion[:, 3, 3] = 1
        motion[:, :3, :3] = about_z(cos, sin)
        motion[:, 2, 3] = slide
        at = field.product(pose, motion)
        made.append(field.product(made[joint.parent], at) if joint.parent >= 0 else at)
    return made


def all_placed(
    joints: Sequence[ExactJoint], field: Field, values: Mapping[str, Residues], count: int
) -> list[Residues]:
    """Placement of every joint, (count, 4, 4) each."""
    return [placements.modulo(joint.placement, field, values, count) for joint in joints]


def frame_pose(
    frame: ExactFrame, field: Field, links: Sequence[Residues], values: Mapping[str, Residues], count: int
) -> Residues:
    """Pose of a frame in the base frame, (count, 4, 4), from those of all links."""
    local = placements.modulo(frame.placement, field, values, count)
    return local if frame.link < 0 else field.product(links[frame.link], local)
