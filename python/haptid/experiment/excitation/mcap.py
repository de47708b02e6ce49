"""A ROS 2 `trajectory_msgs/JointTrajectory` as an MCAP file (mcap.dev/spec) of one message in CDR (OMG DDS-XTypes)."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array

_MAGIC = b"\x89MCAP0\r\n"
_TOPIC = "/joint_trajectory"
_KIND = "trajectory_msgs/msg/JointTrajectory"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _DATA_END = 0x01, 0x02, 0x03, 0x04, 0x05, 0x0F
_BETWEEN = "\n" + 80 * "=" + "\n"
_DEFINITION = _BETWEEN.join(
    (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint[] points",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
        "MSG: trajectory_msgs/JointTrajectoryPoint\nfloat64[] positions\nfloat64[] velocities\n"
        "float64[] accelerations\nfloat64[] effort\nbuiltin_interfaces/Duration time_from_start",
        "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec",
    )
)


def trajectory_file(names: Sequence[str], t: Array, q: Array, qd: Array, qdd: Array) -> bytes:
    """The file: one message at time 0 with all points.

    Args:
        names: of the joints.
        t: times of the points, (n,), s.
        q, qd, qdd: position, velocity and acceleration, each (n, joints), SI.
    """
    schema = struct.pack("<H", 1) + _text(_KIND) + _text("ros2msg") + _text(_DEFINITION)
    channel = struct.pack("<HH", 0, 1) + _text(_TOPIC) + _text("cdr") + struct.pack("<I", 0)
    message = struct.pack("<HIQQ", 0, 0, 0, 0) + _trajectory(names, t, np.stack([q, qd, qdd], axis=1))
    records = (
        (_HEADER, _text("ros2") + _text("haptid")),
        (_SCHEMA, schema),
        (_CHANNEL, channel),
        (_MESSAGE, message),
        (_DATA_END, struct.pack("<I", 0)),
        (_FOOTER, struct.pack("<QQI", 0, 0, 0)),  # neither summary nor checksums
    )
    made = (struct.pack("<BQ", code, len(content)) + content for code, content in records)
    return _MAGIC + b"".join(made) + _MAGIC


def _text(value: str) -> bytes:
    """A string of MCAP: its length in bytes, then UTF-8."""
    coded = value.encode()
    return struct.pack("<I", len(coded)) + coded


def _trajectory(names: Sequence[str], t: Array, rates: Array) -> bytes:
    """The message in little-endian CDR; rates (n, 3, joints)."""
    made = bytearray(struct.pack("<iI", 0, 0))
    _string(made, "")
    made += _count(made, len(names))
    for name in names:
        _string(made, name)
    made += _count(made, len(t))
    for at, point in zip(np.rint(1e9 * t).astype(np.int64).tolist(), rates, strict=True):
        for values in point:
            made += _count(made, len(values))
            made += _padding(made, 8) + values.astype("<f8").tobytes()
        made += _count(made, 0)  # no effort
        made += struct.pack("<iI", *divmod(at, 10**9))
    return b"\x00\x01\x00\x00" + bytes(made)


def _string(made: bytearray, value: str) -> None:
    coded = value.encode() + b"\x00"
    made += _count(made, len(coded))
    made += coded


def _count(made: bytearray, value: int) -> bytes:
    return _padding(made, 4) + struct.pack("<I", value)


def _padding(made: bytearray, size: int) -> bytes:
    """Zeros up to the next multiple of a size, counted from the end of the four bytes of encapsulation."""
    return bytes(-len(made) % size)
