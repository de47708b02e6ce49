"""`play`: a log sent as frames at its own pace, as a controller would: of the virtual bench, or of an earlier day."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid.live.frames import pack_frame

# Pause between two looks at the clock, s.
_TICK = 2e-3
# Numbers of a sender that begins again are so far from where they would go on.
_ELSEWHERE = 2**31


def play(
    position: Array,
    torque: Array,
    rate_hz: float,
    address: tuple[str, int],
    *,
    each: int = 1,
    again: bool = False,
    stop: Callable[[], bool] = lambda: False,
) -> int:
    """Send samples by UDP in real time; how many were sent.

    Args:
        position, torque: (n, channels).
        rate_hz: samples in a second.
        address: host and port.
        each: samples in a frame.
        again: whether to begin again at the end, as a sender that is started anew: its numbers do not go on, so that
            the leap of the positions counts as a pause.
        stop: asked now and then whether to end.
    """
    q, tau = np.asarray(position, dtype=float), np.asarray(torque, dtype=float)
    sent, begun = 0, time.monotonic()
    pause = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        while not stop():
            due = int((time.monotonic() - begun) * rate_hz)
            due = due if again else min(due, len(q))
            while sent + (1 if due == len(q) and not again else each) <= due:
                at = sent % len(q)
                count = min(each, len(q) - at, due - sent)
                number = sent + sent // len(q) * _ELSEWHERE
                out.sendto(pack_frame(number, q[at : at + count], tau[at : at + count]), address)
                sent += count
            if not again and sent >= len(q):
                return sent
            pause.wait(_TICK)
    return sent
