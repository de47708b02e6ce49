"""Whether a joint that moves far turns several times (rad) or a little (deg): by its torque, which gravity repeats.

The weight of a joint that turns is periodic in its angle, and nearly a straight line where it moves by some degrees. A
rigid joint with friction is fitted in both units; the torque of a joint without weight has no information on it. Where
no torque is explained, as of a pendulum that swings freely, the acceleration identifies several turns, and never some
degrees: that of a sine, which is planned, is a straight line of the position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.signals import polynomial_filter

# Rows that are fitted, and the residual power of one unit below which, as a share of the other's, it is taken.
_ROWS, _TOLD = 2000, 0.85
# The same where the joint turns several times in either unit.
_TOLD_OF_TURNS = 0.3
# Residual power, as a share of the torque's, above which no fit explains the torque.
_EXPLAINED = 0.7
# Least and greatest length of the smoothing filter, rows; and the period of the motion over that length.
_NARROW, _WIDE, _OF_PERIOD = 5, 201, 8


def turning_unit(position: NDArray[np.generic], torques: Iterable[NDArray[np.generic]], several: bool = False) -> str:
    """Either "rad" or "deg", whichever explains the joint's torque better; empty where it does not tell.

    Args:
        position: of the joint, (n,), in either unit.
        torques: channels of which one is the joint's, each (n,).
        several: whether it turns several times in either unit: a few turns follow any slow torque.
    """
    told = _TOLD_OF_TURNS if several else _TOLD
    x = np.asarray(position, dtype=np.float64)
    if x.size < 10 * _NARROW or not np.isfinite(x).all():
        return ""
    centred = x - x.mean()
    crossings = int(np.count_nonzero(np.diff(np.signbit(centred)))) + 1
    width = int(np.clip(2 * x.size / crossings / _OF_PERIOD, _NARROW, min(_WIDE, x.size // 10))) | 1
    rates = [polynomial_filter(x, width, 2, order) for order in (1, 2)]
    kept = slice(None, None, max(1, x.size // _ROWS))
    columns = {unit: _columns(x * scale, rates, kept) for unit, scale in (("rad", 1.0), ("deg", np.pi / 180))}
    unit, least = "", 1.0
    for torque in torques:
        y = np.asarray(torque, dtype=np.float64)
        if y.size == x.size and np.isfinite(y).all() and np.ptp(y) > 0:
            left = _left(y[kept], columns)
            better, worse = sorted(left, key=lambda u: left[u])
            if left[better] < least:
                unit, least = better if left[better] < told * left[worse] else "", left[better]
    if least < _EXPLAINED:
        return unit
    # A joint that swings freely has little torque, and the acceleration of its weight.
    left = _left(rates[1][kept], {unit: w[:, :-1] for unit, w in columns.items()})
    return "rad" if left["rad"] < min(told * left["deg"], _EXPLAINED) else ""


def _left(y: Array, columns: Mapping[str, Array]) -> dict[str, float]:
    """Residual power of a response in each unit, as a share of its own."""
    y = y - y.mean()
    whole = float(y @ y) or 1.0
    return {unit: float(np.sum((y - w @ (w.T @ y)) ** 2)) / whole for unit, w in columns.items()}


def _columns(angle: Array, rates: list[Array], kept: slice) -> Array:
    """Orthonormal columns of a rigid joint with weight and friction, (rows, 6)."""
    speed, acceleration = rates
    made = [np.ones_like(angle), np.sin(angle), np.cos(angle), speed, np.sign(speed), acceleration]
    columns = np.stack([column[kept] for column in made], axis=1)
    norm = np.linalg.norm(columns, axis=0)
    return np.asarray(np.linalg.qr(columns / np.where(norm > 0, norm, 1.0))[0])
