"""`redesigned`: counterweights, and motors, gears and lengths, of one device in one go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from numpy.typing import ArrayLike

from haptid._internal.late import dataclass
from haptid.end_effector.characterisation.model import IdentifiedModel
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.redesign.counterweights import (
    Balance,
    Counterweight,
    WeightPlace,
    balance_front,
    weighed,
)
from haptid.end_effector.redesign.drives import (
    MOTORS,
    PRESENT,
    RATIOS,
    DriveChange,
    MotorOption,
    drive_changes,
    least_change,
    pareto,
)
from haptid.errors import IncompleteDeviceError, setting_error

# Share of the static torque below which it counts as nulled.
NULLED = 0.01
# Factors where each motor has one of its own.
_EACH = (0.7, 0.85, 1.0, 1.2, 1.5)


@dataclass(frozen=True)
class Wishes:
    """What a redesign is to reach, and what is known of the device in addition to its file.

    Attributes:
        most_mass: largest effective mass, kg.
        least_force: in the worst direction, N.
        places: of counterweights; those of the device file where None.
        weights: counterweights to try in place of a search.
        rotor_inertia: of motors at their coordinates, kg m^2 or kg; those of the device file where it leaves one out.
        peak: torques of motors' coordinates, N m or N; those of the device file where it leaves one out.
        motors: options of motors; the present ones, shorter and longer, where there are none.
        each: whether every motor's ratio is searched by itself.
    """

    most_mass: float = float("inf")
    least_force: float = 0.0
    places: tuple[WeightPlace, ...] | None = None
    weights: tuple[Counterweight, ...] = ()
    rotor_inertia: Mapping[str, float] = field(default_factory=dict)
    peak: Mapping[str, float] = field(default_factory=dict)
    motors: tuple[MotorOption, ...] = ()
    each: bool = False

    def __post_init__(self) -> None:
        if not self.most_mass > 0:
            raise setting_error("most_mass", self.most_mass, "a mass above 0 kg")
        if not 0 <= self.least_force < float("inf"):
            raise setting_error("least_force", self.least_force, "a finite force from 0 N")

    @property
    def of_drives(self) -> bool:
        """Whether a mass or a force is wanted."""
        return self.most_mass < float("inf") or self.least_force > 0


@dataclass(frozen=True, eq=False)
class Redesign:
    """What was found; parts of which too little is known are empty.

    Attributes:
        identified: the parameters without changes.
        wishes: what was to be reached.
        balances: counterweights, the front by price or those that were given.
        present: the drives as they are.
        changes: all changes of the drives.
        chosen: the least one that reaches what is wanted; None where nothing is.
        missing: why a part is empty.
    """

    identified: IdentifiedModel
    wishes: Wishes
    balances: tuple[Balance, ...]
    present: DriveChange | None
    changes: tuple[DriveChange, ...]
    chosen: DriveChange | None
    missing: tuple[str, ...]

    @property
    def best(self) -> Balance | None:
        """Of the balances that null the static torque, the lightest at the handle; else that with the least torque."""
        if not self.balances:
            return None
        nulled = [one for one in self.balances if one.static_after <= NULLED * one.static_before]
        if nulled:
            return min(nulled, key=lambda one: one.mass_after)
        return min(self.balances, key=lambda one: one.static_after)

    @property
    def front(self) -> tuple[DriveChange, ...]:
        """Changes of the drives that no other one beats."""
        return pareto(self.changes)


def redesigned(identified: IdentifiedModel, poses: ArrayLike, wishes: Wishes | None = None) -> Redesign:
    """Counterweights, and changes of the drives.

    Args:
        identified: the parameters.
        poses: positions of the active joints, (active, poses), rad or m.
        wishes: what is to be reached, and what the device file lacks.

    Raises:
        IncompleteDeviceError: too little is known for what is wished, or for any of both parts.
        UnknownNameError, SettingError: as of `balance`, `weighed`, `drive_changes` and `least_change`.
    """
    wishes = wishes or Wishes()
    missing: list[IncompleteDeviceError] = []
    balances: tuple[Balance, ...] = ()
    try:
        if wishes.weights:
            balances = (weighed(identified, poses, wishes.weights, wishes.places),)
        else:
            balances = balance_front(identified, poses, wishes.places)
    except IncompleteDeviceError as error:
        missing.append(error)
        if wishes.weights:
            raise
    present, changes = None, tuple[DriveChange, ...]()
    try:
        present, changes = _drives(identified, poses, wishes)
    except IncompleteDeviceError as error:
        missing.append(error)
        if wishes.of_drives or not balances:
            raise
    chosen = least_change(changes, wishes.most_mass, wishes.least_force) if wishes.of_drives else None
    return Redesign(identified, wishes, balances, present, changes, chosen, tuple(map(str, missing)))


def _drives(
    identified: IdentifiedModel, poses: ArrayLike, wishes: Wishes
) -> tuple[DriveChange, tuple[DriveChange, ...]]:
    limits = DeviceInstruments(peak=wishes.peak).of(identified.model, "peak") or wishes.peak
    options = (PRESENT, *wishes.motors) if wishes.motors else MOTORS
    given = identified, poses, wishes.rotor_inertia, limits
    (present,) = drive_changes(*given, ratios=(1.0,), lengths=(1.0,))
    ratios = _EACH if wishes.each else RATIOS
    return present, drive_changes(*given, ratios=ratios, motors=options, each=wishes.each)
