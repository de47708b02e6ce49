"""Friction terms that the core does not compute by itself: load-dependent friction, viscous friction by direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import CustomColumn, column

if TYPE_CHECKING:
    from haptid.device.terms.build import Target, TermTargets
    from haptid.device.toml.errors_at import Place

# Kinds of dry friction: the column depends on the sign of a velocity.
DRY = ("coulomb", "coulomb+", "coulomb-", "stribeck")
# Index of each constant in the settings of a kind.
PLACES: Mapping[str, Mapping[str, int]] = {
    "coulomb": {"width": 0},
    "coulomb+": {"width": 0},
    "coulomb-": {"width": 0},
    "stribeck": {"velocity": 0, "exponent": 1, "width": 2},
}


@dataclass(frozen=True, eq=False)
class LoadDependentFriction:
    """Load-dependent Coulomb friction of a coordinate: sgn(v) |torque of the bodies on it|.

    The torque is that of the bodies of an estimate, see `DynamicModel.with_load`. Before the first estimate all bodies
    are alike, so that the column is linearly independent of the others, and its values mean nothing.

    Source: Hamon, Gautier and Garrec (2010), Proc. IEEE/RSJ IROS, 6187-6193, where friction is (alpha |tau| + beta)
    sgn(v).

    Attributes:
        row: index of the coordinate.
        width: tanh(v / width) replaces sgn v, rad/s or m/s; 0 is sgn.
        bodies: parameters of links, then of rotors, (r,), SI; None before the first estimate.
    """

    row: int
    width: float
    bodies: Array | None = None

    @property
    def text(self) -> str:
        """The formula."""
        turning = f"tanh(v / {self.width})" if self.width else "sgn(v)"
        return f"{turning} |torque of the bodies| on coordinate {self.row + 1}"

    def values(self, torque: Array, speed: Array) -> Array:
        """The column, (samples,), from torque of the bodies and velocity of the coordinates, (active, samples)."""
        return np.asarray(np.abs(torque[self.row]) * self.side(speed))

    def side(self, speed: Array) -> Array:
        """sgn v, or its smooth replacement, (samples,), from velocity of the coordinates, (active, samples)."""
        v = speed[self.row]
        return np.asarray(np.tanh(v / self.width) if self.width else np.sign(v))


def load_row(target: Target, place: Place) -> int:
    """Index of the coordinate that a target is, so that its torque is a row of the model.

    Raises:
        DeviceFileError: it is a combination of several, or a joint whose rates vary with the pose.
    """
    moved = np.flatnonzero(target.weights)
    if len(moved) != 1 or target.varies:
        found = f"{target.on} is not one of the coordinates of the torque rows"
        raise place.error(found, 'Name a motor, or an active joint where torque_rows = "joint".')
    return int(moved[0])


def one_direction(target: Target, sign: str, targets: TermTargets, place: Place) -> CustomColumn:
    """The target's velocity where it is positive ("+") or negative ("-"), else zero."""
    joints = [joint.name for joint in targets.joints]
    made = column(f"0.5*({target.speed} {sign} abs({target.speed}))", joints, {}, place)
    return replace(made, nature="viscous", side=1 if sign == "+" else -1)
