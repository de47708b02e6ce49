"""Frames: samples of positions and torques in one datagram or message, with version, counts and a sequence number.

All numbers are little-endian.

| bytes | type | what |
|---|---|---|
| 0 to 3 | 4 bytes | `HPTF` |
| 4 | uint8 | version, 1 |
| 5 | uint8 | 0 |
| 6, 7 | uint16 | position channels, 1 to 64 |
| 8, 9 | uint16 | torque channels, 1 to 64 |
| 10, 11 | uint16 | samples in this frame, 1 to 1024 |
| 12 to 15 | uint32 | number of the first sample, counted from any start, modulo 2^32 |
| from 16 | float64 | sample after sample: its positions, then its torques |
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect
from haptid._internal.late import dataclass
from haptid.errors import HaptidError

MAGIC, VERSION = b"HPTF", 1
_HEAD = struct.Struct("<4sBBHHHI")
# Most channels of a kind, samples of a frame, and bytes that a datagram of IPv4 carries.
MOST_CHANNELS, _MOST_SAMPLES, LARGEST = 64, 1024, 65_507


class FrameError(HaptidError):
    """Bytes that are no frame."""


@dataclass(frozen=True, eq=False)
class SampleFrame:
    """Consecutive samples.

    Attributes:
        number: of the first sample, 0 to 2^32 - 1.
        position, torque: (samples, channels), in the units of who sends.
    """

    number: int
    position: Array
    torque: Array


def read_frame(content: bytes) -> SampleFrame:
    """A frame from its bytes.

    Raises:
        FrameError: it is none, of another version, of a wrong length, or has a number that is not finite.
    """
    if len(content) < _HEAD.size or content[:4] != MAGIC:
        raise FrameError("a message is no frame of haptid.", advice="Check the port, and the layout of the sender.")
    _, version, flags, positions, torques, samples, number = _HEAD.unpack_from(content)
    if version != VERSION or flags:
        raise FrameError(f"a frame has version {version}, flags {flags}.", found=version, limit=VERSION)
    for what, count, most in (
        ("position channels", positions, MOST_CHANNELS),
        ("torque channels", torques, MOST_CHANNELS),
        ("samples", samples, _MOST_SAMPLES),
    ):
        if not 1 <= count <= most:
            raise FrameError(f"a frame has {count} {what}.", found=count, limit=(1, most))
    length = _HEAD.size + 8 * samples * (positions + torques)
    if len(content) != length:
        raise FrameError(f"a frame has {len(content)} bytes, and its head says {length}.", found=len(content))
    values = np.frombuffer(content, "<f8", offset=_HEAD.size).reshape(samples, -1).astype(np.float64)
    if not np.isfinite(values).all():
        raise FrameError("a frame has a number that is not finite.")
    return SampleFrame(number, values[:, :positions], values[:, positions:])


def pack_frame(number: int, position: ArrayLike, torque: ArrayLike) -> bytes:
    """The bytes of a frame.

    Args:
        number: of the first sample; taken modulo 2^32.
        position, torque: (samples, channels).

    Raises:
        ShapeError: not as many positions as torques.
        FrameError: too many channels or samples for one datagram.
    """
    q, tau = np.asarray(position, dtype=float), np.asarray(torque, dtype=float)
    expect("position", q.shape, (None, None))
    expect("torque", tau.shape, (len(q), None))
    content = np.concatenate([q, tau], axis=1).astype("<f8").tobytes()
    small = len(q) <= _MOST_SAMPLES and max(q.shape[1], tau.shape[1]) <= MOST_CHANNELS
    if not small or _HEAD.size + len(content) > LARGEST:
        raise FrameError(f"{len(q)} samples of {q.shape[1] + tau.shape[1]} channels are too many for one frame.")
    return _HEAD.pack(MAGIC, VERSION, 0, q.shape[1], tau.shape[1], len(q), number & 0xFFFFFFFF) + content
