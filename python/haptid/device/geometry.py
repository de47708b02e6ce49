"""Geometry: Denavit-Hartenberg parameters and placements converted to one normal form; poses of links."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array, expect
from haptid.device.device import Device
from haptid.device.expressions import number
from haptid.device.parts import Frame, Joint
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import AnyJoint, BaseTable, FrameTable, ModifiedDHJoint, PlacementJoint, StandardDHJoint

# Largest angle of the geometry, rad: a turn, with a margin for rounding.
FULL_TURN = 2 * math.pi * (1 + 1e-9)

# Cosine of the pitch below which it counts as a right angle.
_LEVEL = 1e-14


def turn_x(angle: float) -> Array:
    """Homogeneous rotation about x, (4, 4)."""
    return _turn(angle, 1, 2)


def turn_y(angle: float) -> Array:
    """Homogeneous rotation about y, (4, 4)."""
    return _turn(angle, 2, 0)


def turn_z(angle: float) -> Array:
    """Homogeneous rotation about z, (4, 4)."""
    return _turn(angle, 0, 1)


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Array:
    """Homogeneous translation, (4, 4), m."""
    made = np.eye(4)
    made[:3, 3] = x, y, z
    return made


def _turn(angle: float, i: int, k: int) -> Array:
    c, s = _cos_sin(angle)
    made = np.eye(4)
    made[i, i] = made[k, k] = c
    made[i, k], made[k, i] = -s, s
    return made


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of pi/2: zero instead of 6e-17."""
    quarters = angle / (math.pi / 2)
    if abs(quarters - round(quarters)) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarters) % 4]
    return math.cos(angle), math.sin(angle)


def modified_dh(gamma: float, b: float, alpha: float, d: float, theta: float, r: float) -> Array:
    """Rz(gamma) Tz(b) Rx(alpha) Tx(d) Rz(theta) Tz(r), (4, 4) (Khalil and Kleinfinger 1986)."""
    return turn_z(gamma) @ shift(z=b) @ turn_x(alpha) @ shift(x=d) @ turn_z(theta) @ shift(z=r)


def placed(xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    """A placement as in URDF, (4, 4): roll, pitch, yaw about the fixed axes x, y, z."""
    return shift(*xyz) @ turn_z(rpy[2]) @ turn_y(rpy[1]) @ turn_x(rpy[0])


def angles(rotation: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw about fixed axes, rad: `placed` gives the rotation back to rounding, at any pitch.

    Where the pitch is a right angle, the yaw is zero.
    """
    R = rotation
    level = float(np.hypot(R[0, 0], R[1, 0]))
    yaw = float(np.arctan2(R[1, 0], R[0, 0])) if level > _LEVEL else 0.0
    R = turn_z(-yaw)[:3, :3] @ R  # roll and pitch of what is left, so that they undo the rounding of the yaw
    return float(np.arctan2(-R[1, 2], R[1, 1])), float(np.arctan2(-R[2, 0], R[0, 0])), yaw


def least_turn(axis: Array) -> Array:
    """The smallest rotation that takes z onto a unit axis, (4, 4); about x if the axis is -z."""
    c, across = axis[2], axis[0] ** 2 + axis[1] ** 2
    if c < 0 and across < 1e-24:
        return turn_x(math.pi)
    v = np.array([-axis[1], axis[0], 0.0])  # z x axis
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    made = np.eye(4)
    made[:3, :3] += K + K @ K * (1 / (1 + c) if c > 0 else (1 - c) / across)  # 1 + c cancels near -z
    return made


class Reader:
    """Reads the numbers of one file: expressions over its named lengths, angles, placements."""

    def __init__(self, lengths: Mapping[str, float]) -> None:
        self.lengths = lengths

    def number(self, value: float | str, place: Place) -> float:
        """Any number."""
        return number(value, self.lengths, place)

    def positive(self, value: float | str, place: Place) -> float:
        """A number above zero."""
        made = self.number(value, place)
        if made <= 0:
            raise place.error(f"found {made:g}", "Write a number above zero.")
        return made

    def not_negative(self, value: float | str, place: Place) -> float:
        """Zero or a number above it."""
        made = self.number(value, place)
        if made < 0:
            raise place.error(f"found {made:g}", "Write zero or a number above it.")
        return made

    def angle(self, value: float | str, place: Place) -> float:
        """An angle of the geometry, rad.

        Raises:
            DeviceFileError: it is more than a turn.
        """
        radians = number(value, self.lengths, place)
        if abs(radians) > FULL_TURN:
            raise place.error(
                f"the angle {radians:g} is more than a turn (limit 2 pi rad), so it looks like degrees",
                f'Write it in radians: {math.radians(radians):.6g}, or as "{radians:g}*pi/180".',
            )
        return radians

    def triple(self, values: Sequence[float | str], place: Place) -> list[float]:
        """Three numbers."""
        return [self.number(value, place.at(k)) for k, value in enumerate(values)]

    def placement(self, table: BaseTable | PlacementJoint, place: Place) -> Array:
        """xyz and rpy, (4, 4)."""
        rpy = [self.angle(value, place.at("rpy", k)) for k, value in enumerate(table.rpy)]
        return placed(self.triple(table.xyz, place.at("xyz")), rpy)

    def frame(self, table: FrameTable, place: Place) -> Array:
        """A frame on a link, (4, 4).

        Raises:
            DeviceFileError: it is given both ways.
        """
        fields = table.model_dump(exclude_none=True)
        mixed = [key for key in fields if key not in ("xyz", "rpy")]
        if len(mixed) < len(fields) and mixed:
            raise place.error(
                f"xyz or rpy is given together with {', '.join(mixed)}",
                "Use either xyz and rpy, or gamma b alpha d theta r.",
            )
        if mixed:
            return self.modified(fields, place)
        zero = [0.0, 0.0, 0.0]
        return self.placement(BaseTable(xyz=fields.get("xyz", zero), rpy=fields.get("rpy", zero)), place)

    def modified(self, fields: Mapping[str, float | str], place: Place) -> Array:
        """Modified Denavit-Hartenberg keys, (4, 4)."""
        angles = {key: self.angle(fields.get(key, 0.0), place.at(key)) for key in ("gamma", "alpha", "theta")}
        lengths = {key: self.number(fields.get(key, 0.0), place.at(key)) for key in ("b", "d", "r")}
        return modified_dh(**angles, **lengths)

    def joint(self, table: AnyJoint, place: Place) -> tuple[Array, Array]:
        """Placement of a joint's frame in its parent's frame of the file's convention, and the joint's own such frame.

        Returns:
            both (4, 4); the first at q = 0 with z the joint axis, the second in the first.
        """
        if isinstance(table, ModifiedDHJoint):
            return self.modified(table.model_dump(), place), np.eye(4)
        if isinstance(table, StandardDHJoint):
            theta, alpha = (self.angle(getattr(table, key), place.at(key)) for key in ("theta", "alpha"))
            d, a = (self.number(getattr(table, key), place.at(key)) for key in ("d", "a"))
            return turn_z(theta) @ shift(z=d), shift(x=a) @ turn_x(alpha)
        onto = least_turn(self.axis(table, place))
        return self.placement(table, place) @ onto, onto.T

    def axis(self, table: PlacementJoint, place: Place) -> Array:
        """Unit vector of an axis, (3,)."""
        axis = np.array(self.triple(table.axis, place.at("axis")))
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise place.at("axis").error(f"found {list(axis)}", "Write a direction, such as [0, 0, 1].")
        return np.asarray(axis / length)


def frame_on(joints: Sequence[Joint], link: int, local: Array, base: Array) -> Frame:
    """A frame given in a link's frame of the file's convention, as a frame in normal form; link -1 is the base."""
    convention = base
    if link >= 0:
        convention = np.eye(4)
        convention[:3, :3], convention[:3, 3] = joints[link].frame_rotation, joints[link].frame_translation
    pose = convention @ local
    return Frame(link, pose[:3, :3], pose[:3, 3])


def poses(device: Device, q_tree: Array) -> Array:
    """Poses of all links in the base frame, (samples, joints, 4, 4), m.

    Args:
        device: the mechanism.
        q_tree: positions of all joints, (samples, joints), rad or m.
    """
    return joint_poses(device.joints, q_tree)


def joint_poses(joints: Sequence[Joint], q_tree: Array) -> Array:
    """Poses of links of a tree, (samples, joints, 4, 4), from joint positions (samples, joints)."""
    axes, origins = link_frames(joints, np.asarray(q_tree, dtype=float).T)
    poses = np.zeros((origins.shape[2], len(joints), 4, 4))
    poses[:, :, :3, :3] = axes.transpose(3, 0, 2, 1)
    poses[:, :, :3, 3] = origins.transpose(2, 0, 1)
    poses[..., 3, 3] = 1.0
    return poses


def link_frames(joints: Sequence[Joint], q_tree: Array) -> tuple[Array, Array]:
    """Axes of links in the base frame, (joints, axis, component, samples), and origins, (joints, 3, samples).

    Samples are last, so that every step is an operation on long arrays.

    Args:
        joints: of the tree, parents before children.
        q_tree: positions of all joints, (joints, samples), rad or m.
    """
    q = np.asarray(q_tree, dtype=float)
    expect("q_tree", q.T.shape, (None, len(joints)))
    n = q.shape[1]
    axes, origins = np.empty((len(joints), 3, 3, n)), np.empty((len(joints), 3, n))
    cosines, sines = np.cos(q), np.sin(q)
    for j, joint in enumerate(joints):
        if joint.parent < 0:
            R = np.repeat(joint.rotation.T[:, :, None], n, axis=2)
            p = np.repeat(joint.translation[:, None], n, axis=1)
        else:
            above = axes[joint.parent].reshape(3, 3 * n)
            R = (joint.rotation.T @ above).reshape(3, 3, n)
            p = origins[joint.parent] + (joint.translation @ above).reshape(3, n)
        axes[j, 2] = R[2]
        if joint.prismatic:
            axes[j, :2], origins[j] = R[:2], p + R[2] * q[j]
        else:
            c, s = cosines[j], sines[j]
            np.add(c * R[0], s * R[1], out=axes[j, 0])
            np.subtract(c * R[1], s * R[0], out=axes[j, 1])
            origins[j] = p
    return axes, origins
