"""Ranges of the inputs of generated code: limits of the device file, and settings where it has none."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.functions_in_intervals import Interval
from haptid.export.output import CCode

# Positions of joints without limits: a turn, rad, or so many m to both sides.
_TURN, _SLIDE = np.pi, 1.0


@dataclass(frozen=True, eq=False)
class Ranges:
    """Ranges of the coordinates of the torque rows.

    Attributes:
        position: lower and upper end, (active, 2), rad or m.
        rate, acceleration: largest magnitudes, (active,), rad/s or m/s, and per s.
        passive: positions of the passive joints of loops, (passive, 2), rad or m.
    """

    position: Array
    rate: Array
    acceleration: Array
    passive: Array

    @staticmethod
    def of(model: DynamicModel, passive: tuple[int, ...], settings: CCode) -> Ranges:
        """Of a device's coordinates, combinations of its active joints.

        Args:
            passive: joints whose positions the code takes as inputs.
            settings: rate and acceleration of joints without a limit of the rate.
        """
        joints, rows = model.device.joints, model.device.row_map
        ends = np.array([_positions(joints[j].position_limits, joints[j].prismatic) for j in model.device.active])
        reached = rows[:, :, None] * ends
        rates = np.array([joints[j].velocity_limit or settings.rate for j in model.device.active])
        rate = np.abs(rows) @ rates
        return Ranges(
            np.stack([reached.min(axis=2).sum(axis=1), reached.max(axis=2).sum(axis=1)], axis=1),
            rate,
            rate * (settings.acceleration / settings.rate),
            np.array([_positions(joints[j].position_limits, joints[j].prismatic) for j in passive]).reshape(-1, 2),
        )

    @property
    def inputs(self) -> dict[str, Interval]:
        """By the names of the code's inputs."""
        made: dict[str, Interval] = {}
        for name, ends in (
            ("q", self.position),
            ("z", self.passive),
            ("qd", np.outer(self.rate, [-1, 1])),
            ("qdd", np.outer(self.acceleration, [-1, 1])),
        ):
            made |= {f"{name}[{k}]": Interval(float(low), float(high)) for k, (low, high) in enumerate(ends)}
        return made


def _positions(limits: tuple[float, float] | None, prismatic: bool) -> tuple[float, float]:
    most = _SLIDE if prismatic else _TURN
    return limits or (-most, most)
