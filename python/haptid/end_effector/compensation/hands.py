"""Hands that hold the handle: the five-parameter model, a published range of it, and the motions a hand makes.

The handle is joined to the mass of hand and forearm by the spring and damper of the grasp, and this mass to a place
that the person moves by the spring and damper of the arm:

    handle -(grip_stiffness | grip_damping)- mass -(stiffness | damping)- place.
"""

from __future__ import annotations

from itertools import product

from haptid._internal.arrays import positive
from haptid._internal.late import dataclass
from haptid.errors import setting_error


@dataclass(frozen=True)
class HandModel:
    """A hand, alike in all directions.

    Attributes:
        mass: of hand and forearm as far as it moves with the handle, kg.
        damping, stiffness: of the arm, N s/m and N/m.
        grip_damping, grip_stiffness: of the grasp, N s/m and N/m.
    """

    mass: float
    damping: float
    stiffness: float
    grip_damping: float
    grip_stiffness: float

    def __post_init__(self) -> None:
        for name in ("mass", "grip_stiffness"):
            if not positive(getattr(self, name)):
                raise setting_error(name, getattr(self, name), "a finite number above 0")
        for name in ("damping", "stiffness", "grip_damping"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise setting_error(name, getattr(self, name), "a finite number from 0")


# Least and greatest value over 15 subjects, three axes and grip forces of 1 to 3 N, of a hand that holds the stylus of
# a PHANToM Premium 1.5A, fitted from 0.6 to 30 Hz: Fu and Cavusoglu (2012), IEEE Trans. Systems, Man, Cybernetics B
# 42(6), 1633-1644, Tables II and III.
PUBLISHED_RANGE = {
    "mass": (0.02, 0.57),
    "damping": (3.7, 27.6),
    "stiffness": (63.0, 533.0),
    "grip_damping": (0.0, 4.6),
    "grip_stiffness": (230.0, 1040.0),
}
# The middle of the subjects' means in the same tables.
TYPICAL_HAND = HandModel(0.21, 11.0, 175.0, 1.3, 575.0)
# The stiffest hand of the range with the least damping.
STIFF_HAND = HandModel(0.57, 3.7, 533.0, 0.0, 1040.0)


def published_hands() -> tuple[HandModel, ...]:
    """The corners of the published range, 32 hands."""
    return tuple(HandModel(*values) for values in product(*PUBLISHED_RANGE.values()))


@dataclass(frozen=True)
class HandMotion:
    """The motions that a person makes on purpose: the fastest sine at each frequency.

    Below 10 Hz hands move on purpose; faster motion is the passive answer of the hand (Hatzfeld and Kern 2023,
    Engineering Haptic Devices, ch. 3). The two limits of a sine are assumptions, those of quick work.

    Attributes:
        bandwidth_hz: highest frequency.
        speed: greatest speed, m/s.
        acceleration: greatest acceleration, m/s^2.
    """

    bandwidth_hz: float = 10.0
    speed: float = 0.5
    acceleration: float = 10.0

    def __post_init__(self) -> None:
        for name in ("bandwidth_hz", "speed", "acceleration"):
            if not positive(getattr(self, name)):
                raise setting_error(name, getattr(self, name), "a finite number above 0")
