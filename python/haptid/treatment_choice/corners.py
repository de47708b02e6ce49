"""Corners of a motion at its reversals, which a position filter rounds off, told from noise by where they are.

At the limit of a control loop with coarse feedback dry friction holds a joint at its reversals: its acceleration jumps.
A low position filter spreads the jump over the rows beside, and delays and inertia follow it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import MotionTooShortError
from haptid.log import Log
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment

# Power near reversals over that elsewhere of what a lower position filter removes, above which it is motion.
_CORNERS = 4.0


def cuts_corners(logs: Sequence[Log], wide: Treatment, narrow: Treatment) -> bool:
    """Whether what a lower position filter removes of a channel is motion near its reversals; noise is even.

    Args:
        logs: recordings.
        wide, narrow: treatments that differ in the position filter.
    """
    if wide.cutoff_hz is None or narrow.cutoff_hz is None or np.min(narrow.cutoff_hz) >= np.min(wide.cutoff_hz):
        return False
    return bool(corners_cut(logs, wide, narrow).any())


def corners_cut(logs: Sequence[Log], wide: Treatment, narrow: Treatment) -> Array:
    """Of which channels what a lower position filter removes is motion near reversals, (channels,), bool.

    Args:
        logs: recordings.
        wide, narrow: treatments that differ in the position filter.
    """
    power = np.zeros((2, 2, logs[0].position.shape[1]))  # near reversals and elsewhere: sum of squares, samples
    for log in logs:
        try:
            power += _removed(log, *(replace(t, torque_delay_s=0.0) for t in (wide, narrow)))
        except MotionTooShortError:
            continue
    near, elsewhere = power
    known = (near[1] > 0) & (elsewhere[1] > 0) & (elsewhere[0] > 0)
    cut = np.zeros(len(known), dtype=bool)
    cut[known] = near[0, known] * elsewhere[1, known] > _CORNERS * near[1, known] * elsewhere[0, known]
    return cut


def _removed(log: Log, wide: Treatment, narrow: Treatment) -> Array:
    """What the narrower filter removes: [near reversals, elsewhere] by [sum of squares, samples], by channel."""
    before, after = treat(log, wide), treat(log, narrow)
    reach = max(1, round(0.5 / float(np.max(np.atleast_1d(narrow.cutoff_hz or 0.0))) / float(log.dt)))
    power = np.zeros((2, 2, log.position.shape[1]))
    for start, stop in after.usable_segments:
        removed = (np.asarray(before.q[start:stop]) - np.asarray(after.q[start:stop])).T ** 2
        v = after.state(start, stop)[1]
        for k, (own, speed) in enumerate(zip(removed, v, strict=True)):
            reversed_at = np.flatnonzero(speed[1:] * speed[:-1] < 0)
            edges = np.zeros(len(own) + 1, dtype=int)
            np.add.at(edges, np.maximum(reversed_at - reach, 0), 1)
            np.add.at(edges, np.minimum(reversed_at + reach + 2, len(own)), -1)
            near = np.cumsum(edges[:-1]) > 0
            power[0, :, k] += own[near].sum(), near.sum()
            power[1, :, k] += own[~near].sum(), (~near).sum()
    return power
