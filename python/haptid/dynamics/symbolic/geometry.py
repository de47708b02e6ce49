"""Geometry with symbolic lengths: placements, the joint tree and cut frames, and their reading from a device file.

The frames are the same as the numeric ones, but unrounded; poses are evaluated modulo a prime.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import number, sum_of_names
from haptid.device.toml.schema import (
    AnyDevice,
    AnyJoint,
    BaseTable,
    FrameTable,
    ModifiedDHJoint,
    PlacementJoint,
    StandardDHJoint,
)
from haptid.dynamics.symbolic.arithmetic import ONE, Laurent, Points, PrimeField, Residues
from haptid.dynamics.symbolic.symbols import CHECKED, LENGTH, Symbols, ratio


@dataclass(frozen=True)
class Rotation:
    """A rotation about an axis of the current frame: 0 is x, 1 is y, 2 is z."""

    axis: int
    cos: Laurent
    sin: Laurent

    @property
    def entries(self) -> tuple[tuple[int, int, Laurent], ...]:
        """Row, column and value of the matrix entries that differ from the identity."""
        i, k = (self.axis + 1) % 3, (self.axis + 2) % 3
        return ((i, i, self.cos), (k, k, self.cos), (i, k, -self.sin), (k, i, self.sin))


@dataclass(frozen=True)
class Translation:
    """A translation along an axis of the current frame, m."""

    axis: int
    length: Laurent

    @property
    def entries(self) -> tuple[tuple[int, int, Laurent], ...]:
        """Row, column and value of the matrix entries that differ from the identity."""
        return ((self.axis, 3, self.length),)


# Applied from the left: the first step is in the parent's frame.
Placement = tuple[Rotation | Translation, ...]


def inverse_placement(placement: Placement) -> Placement:
    """The inverse transform."""
    return tuple(
        Rotation(step.axis, step.cos, -step.sin) if isinstance(step, Rotation) else Translation(step.axis, -step.length)
        for step in reversed(placement)
    )


def placement_residues(placement: Placement, points: Points) -> Residues:
    """Residues of a placement, (count, 4, 4)."""
    field = points.field
    pose: Residues = np.zeros((points.count, 4, 4), dtype=field.dtype)
    pose[:, range(4), range(4)] = 1
    for step in placement:
        if isinstance(step, Translation):
            shift = pose[:, :, step.axis] * step.length.modulo(points)[:, None]
            pose[:, :, 3] = field.reduce(pose[:, :, 3] + shift)
        else:
            i, k = (step.axis + 1) % 3, (step.axis + 2) % 3
            x, y = pose[:, :, i], pose[:, :, k]
            if not step.cos.terms and not step.sin.symbols:  # a quarter turn
                left = step.sin == ONE
                pose[:, :, i], pose[:, :, k] = (y.copy(), field.reduce(-x)) if left else (field.reduce(-y), x.copy())
                continue
            cos, sin = (part.modulo(points)[:, None] for part in (step.cos, step.sin))
            pose[:, :, i], pose[:, :, k] = field.reduce(x * cos + y * sin), field.reduce(y * cos - x * sin)
    return pose


def placement_value(placement: Placement, values: Mapping[str, float]) -> Array:
    """A placement as numbers, (4, 4), m."""
    pose = np.eye(4)
    for step in placement:
        matrix = np.eye(4)
        for row, column, entry in step.entries:
            matrix[row, column] = entry.value(values)
        pose = pose @ matrix
    return pose


def _least_turn(axis: tuple[float, float, float]) -> tuple[tuple[int, float], ...]:
    """The smallest rotation that takes z onto a unit axis, as axes and angles, rad; about x where the axis is -z."""
    x, y, z = axis
    across = math.hypot(x, y)
    if across < 1e-12:
        return () if z > 0 else ((0, math.pi),)
    heading = math.atan2(y, x)
    return ((2, heading), (1, math.atan2(across, z)), (2, -heading))


@dataclass(frozen=True)
class SymbolicJoint:
    """A joint in normal form: it turns about, or slides along, its own z axis."""

    parent: int
    prismatic: bool
    placement: Placement


@dataclass(frozen=True)
class SymbolicFrame:
    """A frame on a link, -1 for the base."""

    link: int
    placement: Placement


@dataclass(frozen=True)
class SymbolicCut:
    """A cut joint, and the two frames that coincide when its loop is closed."""

    kind: str
    frame_a: SymbolicFrame
    frame_b: SymbolicFrame


# Cosine, sine and slide of every joint, (joints, n) each.
JointCoordinates = tuple[Residues, Residues, Residues]


def about_z(cos: Residues, sin: Residues) -> Residues:
    """Rotations about z, (n, 3, 3)."""
    R = np.zeros((len(cos), 3, 3), dtype=cos.dtype)
    R[:, 0, 0] = R[:, 1, 1] = cos
    R[:, 0, 1], R[:, 1, 0], R[:, 2, 2] = -sin, sin, 1
    return R


def symbolic_poses(
    joints: Sequence[SymbolicJoint], field: PrimeField, placed: Sequence[Residues], moved: JointCoordinates
) -> list[Residues]:
    """Poses of all links in the base frame, (n, 4, 4) each.

    Args:
        joints: of the tree.
        field: the residues' prime.
        placed: placement of every joint, (n, 4, 4) each.
        moved: cosine, sine and slide of every joint, (joints, n) each.
    """
    links: list[Residues] = []
    for joint, pose, cos, sin, slide in zip(joints, placed, *moved, strict=True):
        motion = np.zeros_like(pose)
        motion[:, 3, 3] = 1
        motion[:, :3, :3] = about_z(cos, sin)
        motion[:, 2, 3] = slide
        pose_here = field.product(pose, motion)
        links.append(field.product(links[joint.parent], pose_here) if joint.parent >= 0 else pose_here)
    return links


def joint_placements(joints: Sequence[SymbolicJoint], points: Points) -> list[Residues]:
    """Placement of every joint, (count, 4, 4) each."""
    return [placement_residues(joint.placement, points) for joint in joints]


def frame_pose(frame: SymbolicFrame, links: Sequence[Residues], points: Points) -> Residues:
    """Pose of a frame in the base frame, (count, 4, 4), from those of all links."""
    local = placement_residues(frame.placement, points)
    return local if frame.link < 0 else points.field.product(links[frame.link], local)


X, Y, Z = 0, 1, 2


class GeometryReader:
    """Placements of one file, every length a sum of symbols.

    A length that is written as a sum of named lengths stays one. Any other number becomes a symbol, named after its key
    and joint; numbers of the same size share one.
    """

    def __init__(self, lengths: Mapping[str, float | str], values: Mapping[str, float], symbols: Symbols) -> None:
        self._values = values
        self._symbols = symbols
        self._lengths: dict[str, Laurent] = {}
        for name, written in lengths.items():
            if isinstance(written, str) and (total := sum_of_names(written, self._lengths)) and total.factors:
                self._lengths[name] = self.length(written, name)
            else:
                self._lengths[name] = symbols.named(name, values[name], LENGTH, name)

    def length(self, written: float | str, name: str) -> Laurent:
        """A length; `name` is that of its own symbol, where one is created."""
        known = sum_of_names(written, self._lengths) if isinstance(written, str) else None
        if known is None or not known.factors:
            size = number(written, self._values, CHECKED)
            return self._symbols.quantity(size, name, written=written) if size else Laurent()
        length = self._symbols.quantity(known.constant, f"{name}_0") if known.constant else Laurent()
        for symbol, factor in known.factors.items():
            length = length + self._lengths[symbol].times(ratio(factor))
        return length

    def turn(self, axis: int, written: float | str, name: str) -> Placement:
        """A rotation by an angle, none where it is zero."""
        angle = number(written, self._values, CHECKED)
        return (Rotation(axis, *self._symbols.turn(angle, name, written)),) if angle else ()

    def shift(self, axis: int, written: float | str, name: str) -> Placement:
        """A translation by a length, none where it is zero."""
        length = self.length(written, name)
        return (Translation(axis, length),) if length.terms else ()

    def modified(self, parameters: Mapping[str, Any], joint: str) -> Placement:
        """Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r), absent ones zero."""
        steps = (
            (self.turn, Z, "gamma"),
            (self.shift, Z, "b"),
            (self.turn, X, "alpha"),
            (self.shift, X, "d"),
            (self.turn, Z, "theta"),
            (self.shift, Z, "r"),
        )
        return tuple(
            step for make, axis, key in steps for step in make(axis, parameters.get(key) or 0.0, f"{key}{joint}")
        )

    def placed(self, xyz: Sequence[float | str], rpy: Sequence[float | str], name: str) -> Placement:
        """A translation, then yaw, pitch and roll about the axes that they turn."""
        shifts = [self.shift(axis, value, f"{'xyz'[axis]}{name}") for axis, value in enumerate(xyz)]
        names = ("roll", "pitch", "yaw")
        turns = [self.turn(axis, rpy[axis], f"{names[axis]}{name}") for axis in (Z, Y, X)]
        return tuple(step for part in (*shifts, *turns) for step in part)

    def base(self, table: BaseTable) -> Placement:
        """The placement of the first frame."""
        return self.placed(table.xyz, table.rpy, "0")

    def frame(self, table: FrameTable, name: str) -> Placement:
        """A frame on a link, in either convention."""
        if table.xyz is None and table.rpy is None:
            return self.modified(table.model_dump(), name)
        zero = (0.0, 0.0, 0.0)
        return self.placed(table.xyz or zero, table.rpy or zero, name)

    def joint(self, table: AnyJoint) -> tuple[Placement, Placement]:
        """Placement of a joint's frame in its parent's convention frame, and of that convention's frame in it."""
        name = table.name
        if isinstance(table, ModifiedDHJoint):
            return self.modified(table.model_dump(), name), ()
        if isinstance(table, StandardDHJoint):
            before = (*self.turn(Z, table.theta, f"theta{name}"), *self.shift(Z, table.d, f"d{name}"))
            return before, (*self.shift(X, table.a, f"a{name}"), *self.turn(X, table.alpha, f"alpha{name}"))
        onto = self._onto(table)
        return (*self.placed(table.xyz, table.rpy, name), *onto), inverse_placement(onto)

    def _onto(self, table: PlacementJoint) -> Placement:
        axis = np.array([number(value, self._values, CHECKED) for value in table.axis])
        x, y, z = (float(part) for part in axis / np.linalg.norm(axis))
        names = ("", f"tilt{table.name}", f"heading{table.name}")
        return tuple(step for at, angle in _least_turn((x, y, z)) for step in self.turn(at, angle, names[at]))


def placements(
    tables: AnyDevice, parents: Sequence[int], reader: GeometryReader
) -> tuple[list[Placement], list[Placement]]:
    """Placement of every joint in its parent's normal form, and of every link's convention frame in its own."""
    base = reader.base(tables.base)
    joints: Sequence[AnyJoint] = tables.joints
    placements: list[Placement] = []
    frames: list[Placement] = []
    for table, parent in zip(joints, parents, strict=True):
        placement, frame = reader.joint(table)
        placements.append((*(base if parent < 0 else frames[parent]), *placement))
        frames.append(frame)
    return placements, frames
