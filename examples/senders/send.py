"""Sends samples to the live page of the workbench as frames by UDP; needs nothing but Python.

python send.py 127.0.0.1 PORT [SAMPLES]
"""

from __future__ import annotations

import math
import socket
import struct
import sys
import time
from collections.abc import Sequence


def frame_of(number: int, position: Sequence[float], torque: Sequence[float]) -> bytes:
    """One sample as a frame of version 1."""
    head = struct.pack("<4sBBHHHI", b"HPTF", 1, 0, len(position), len(torque), 1, number & 0xFFFFFFFF)
    return head + struct.pack(f"<{len(position) + len(torque)}d", *position, *torque)


def main(address: str, port: int, samples: int = 60_000) -> None:
    """Two joints at 1 kHz, in place of what your controller has measured and commanded."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        begun = time.monotonic()
        for number in range(samples):
            t = 1e-3 * number
            position, torque = (0.5 * math.sin(t), 0.5 * math.sin(1.3 * t)), (math.cos(t), math.cos(1.3 * t))
            out.sendto(frame_of(number, position, torque), (address, port))
            time.sleep(max(0.0, begun + t + 1e-3 - time.monotonic()))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *map(int, sys.argv[3:4]))
