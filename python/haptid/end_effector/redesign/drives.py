"""Motors, gears and lengths for a wanted felt mass or force: what a change of drives and size does at the handle.

With each transmission ratio times its r, motors of t times the torque and i times the rotor inertia, and all lengths
times s, links taken as slender bars of the same section,

    M = s M_links + i r^2 / s^2 M_rotors,   torque limits times t r,   Jacobian times s,   static torque times s^2:

mass of a link grows with s, its inertia with s^3. A gear costs rotor inertia with r^2 and gives force with r. A motor
of the same diameter that is n times as long has t = i = n, so a longer motor is better than a larger ratio where only
felt mass and force count; its own mass is not counted, and on a moving link it is a counterweight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, positive
from haptid._internal.late import dataclass
from haptid._internal.pareto import pareto_front
from haptid.dynamics.inverse import inverse_dynamics, mass_matrix
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation import force_capability
from haptid.end_effector.characterisation.jacobian import LINEAR, HandleJacobian, handle_jacobian
from haptid.end_effector.characterisation.model import IdentifiedModel
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.force import WORST_CONDITION
from haptid.errors import IncompleteDeviceError, setting_error

RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)
LENGTHS = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5)
# Least share of the poses at which the mass matrix without rotors is positive definite.
_PHYSICAL = 0.5
# Most changes of one search.
MOST_CHANGES = 20_000


@dataclass(frozen=True)
class MotorOption:
    """Motors in place of the present ones, on every coordinate.

    Attributes:
        name: of the option.
        torque: factor of their torques.
        inertia: factor of their rotor inertia.
    """

    name: str
    torque: float = 1.0
    inertia: float = 1.0

    def __post_init__(self) -> None:
        for key in ("torque", "inertia"):
            if not positive(getattr(self, key)):
                raise setting_error(f"{key} of motor option {self.name}", getattr(self, key), "a finite factor above 0")


PRESENT = MotorOption("present")
# Of the present diameter, shorter and longer.
MOTORS = (PRESENT, *(MotorOption(f"{n:g} times as long", n, n) for n in (0.5, 0.7, 1.4, 2.0)))


@dataclass(frozen=True)
class DriveChange:
    """A change and what it does, medians over the poses.

    Attributes:
        ratios: factors of the motors' transmission ratios, (motors,).
        length: factor of all lengths.
        motor: the motors.
        mass: largest effective mass, kg.
        force: in the worst direction, N.
        poses: how many; those at which the handle is not singular and links without rotors have a positive inertia.
    """

    ratios: tuple[float, ...]
    length: float
    motor: MotorOption
    mass: float
    force: float
    poses: int

    @property
    def size(self) -> float:
        """How much is changed: the sum of the logarithms of all factors."""
        factors = [*self.ratios, self.length, self.motor.torque]
        return float(np.abs(np.log(factors)).sum())


def drive_changes(
    identified: IdentifiedModel,
    poses: ArrayLike,
    rotor_inertia: Mapping[str, float] | None = None,
    limits: Mapping[str, float] | None = None,
    ratios: Sequence[float] = RATIOS,
    lengths: Sequence[float] = LENGTHS,
    motors: Sequence[MotorOption] = (PRESENT,),
    *,
    each: bool = False,
) -> tuple[DriveChange, ...]:
    """Felt mass and force for every combination of factors.

    Args:
        identified: the parameters; rotor inertia is part of them.
        poses: positions of the active joints, (active, poses), rad or m.
        rotor_inertia: of motors, at their coordinates (shaft inertia times the ratio squared), kg m^2 or kg; of motors
            that it leaves out, that of the device file.
        limits: of the motors' torques, N m or N; the peak torques of the device file where None.
        ratios, lengths: factors.
        motors: options.
        each: whether every motor has a factor of its own, or all have the same.

    Raises:
        IncompleteDeviceError: a motor without rotor inertia or limit.
        UnknownNameError: rotor inertia or limit of a motor that the device does not have.
        SettingError: a factor that is not positive, rotors with more inertia than the device at half of the poses, only
            singular poses, or more than 20 000 changes.
    """
    model, qa = identified.model, np.asarray(poses, dtype=float)
    expect("poses", qa.shape, (len(model.device.active), None))
    for name, factors in (("ratios", ratios), ("lengths", lengths)):
        for factor in factors:
            if not positive(factor):
                raise setting_error(name, factor, "finite factors above 0")
    count = len(model.device.motors)
    if (changes := len(ratios) ** (count if each else 1) * len(lengths) * len(motors)) > MOST_CHANGES:
        raise setting_error("changes", changes, f"at most {MOST_CHANGES}: fewer factors, or one ratio for all motors")
    device = _Drives.of(identified, qa, _rotors(model, rotor_inertia or {}), limits)
    tuples = list(product(ratios, repeat=count)) if each else [(float(r),) * count for r in ratios]
    return tuple(device.changed(r, s, motor) for r in tuples for s in lengths for motor in motors)


def pareto(
    changes: Sequence[DriveChange], most_mass: float = np.inf, least_force: float = 0.0
) -> tuple[DriveChange, ...]:
    """Changes with at most this mass and at least this force that no other one beats in both, by mass."""
    kept = [one for one in changes if one.mass <= most_mass and one.force >= least_force]
    return pareto_front(kept, lambda one: (one.mass, -one.force))


def least_change(changes: Sequence[DriveChange], most_mass: float = np.inf, least_force: float = 0.0) -> DriveChange:
    """The change that reaches a wanted mass and force with the least sum of logarithms of its factors.

    Raises:
        SettingError: none does; the message has what is reached of each.
    """
    kept = [one for one in changes if one.mass <= most_mass and one.force >= least_force]
    if kept:
        return min(kept, key=lambda one: (one.size, one.mass))
    raise setting_error(
        "wanted mass and force",
        f"at most {most_mass:g} kg with at least {least_force:g} N",
        _reached(changes, most_mass, least_force),
    )


def _reached(changes: Sequence[DriveChange], most_mass: float, least_force: float) -> str:
    """What the changes reach of each, as what to ask for."""
    strong = [one.mass for one in changes if one.force >= least_force]
    light = [one.force for one in changes if one.mass <= most_mass]
    parts = [f"a mass from {min(strong):.3g} kg with that force"] if strong else []
    parts += [f"a force up to {max(light):.3g} N with that mass"] if light else []
    masses, forces = [one.mass for one in changes], [one.force for one in changes]
    parts = parts or [f"a mass from {min(masses):.3g} kg and a force up to {max(forces):.3g} N, not both"]
    return " or ".join(parts) + ", or search other motors, ratios and lengths"


def _rotors(model: DynamicModel, given: Mapping[str, float]) -> Array:
    """Rotor inertia of every motor at its coordinate, (motors,): given, or that of the device file."""
    tools = DeviceInstruments(rotor_inertia=given)
    known = tools.known(model, "rotor_inertia")
    for motor in model.device.motors:
        if motor.name not in known:
            raise IncompleteDeviceError(
                f"the rotor inertia of motor {motor.name} is not known.",
                where=motor.name,
                advice="Give it at the motor's coordinate (shaft inertia times the transmission ratio squared), or "
                "rotor_inertia at the shaft in [[motors]] of the device file.",
            )
    return np.array([known[motor.name] for motor in model.device.motors])


@dataclass(frozen=True, eq=False)
class _Drives:
    """A device at poses, with its rotors apart.

    Attributes:
        kept: the handle's Jacobian.
        links: mass matrix without rotors, (poses, n, n).
        B: rates of the motors' coordinates, (poses, motors, n).
        rotors: their inertia, (motors,).
        limits: torques of the motors, N m or N.
        static: torque that carries the device, (active, poses), N m or N.
    """

    kept: HandleJacobian
    links: Array
    B: Array
    rotors: Array
    limits: Mapping[str, float] | None
    static: Array

    @staticmethod
    def of(identified: IdentifiedModel, qa: Array, rotors: Array, limits: Mapping[str, float] | None) -> _Drives:
        """At the poses that are not singular."""
        model = identified.model
        handle = handle_jacobian(model, qa, LINEAR, WORST_CONDITION)
        if not handle.usable.any():
            raise setting_error("poses", qa.shape[1], "poses at which the handle is not singular")
        qa = qa[:, handle.usable]
        inner = list(handle.moving)
        A = mass_matrix(model, identified.beta, qa)[:, inner][:, :, inner]
        B = model.device.drive_jacobian(model.device.row_map @ qa)
        B = np.broadcast_to(B if B.ndim == 3 else B[None], (len(A), *B.shape[-2:]))[:, model.device.driven][:, :, inner]
        links = A - np.swapaxes(B, 1, 2) @ (rotors[:, None] * B)
        physical = np.linalg.eigvalsh(links)[:, 0] > 0
        if physical.mean() < _PHYSICAL:
            given = {motor.name: float(value) for motor, value in zip(model.device.motors, rotors, strict=True)}
            raise setting_error("rotor_inertia", given, "less than the inertia that was identified")
        kept = handle_jacobian(model, qa[:, physical], LINEAR, WORST_CONDITION)
        B, links = B[physical], links[physical]
        still = np.zeros_like(kept.qa)
        peak = DeviceInstruments().of(model, "peak") if limits is None else limits
        static = inverse_dynamics(model, identified.beta, kept.qa, still, still)
        return _Drives(kept, links, B, rotors, peak, static)

    def changed(self, ratios: tuple[float, ...], s: float, motor: MotorOption) -> DriveChange:
        """With these factors."""
        r = np.array(ratios)
        rotors = np.swapaxes(self.B, 1, 2) @ ((motor.inertia * r**2 * self.rotors)[:, None] * self.B)
        J = s * self.kept.jacobian
        mobility = J @ np.linalg.solve(s**3 * self.links + rotors, J.mT)
        mass = 1 / np.linalg.eigvalsh(mobility)[:, -min(J.shape[1:])]
        torques = force_capability.torque_limits(self.kept.model, self.limits)
        names = [one.name for one in self.kept.model.device.motors]
        limits = dict(zip(names, (motor.torque * r * torques).tolist(), strict=True))
        bounds = force_capability.torque_bounds(self.kept, limits)
        scaled = force_capability.TorqueBounds(bounds.normals, bounds.limits, s * bounds.jacobian)
        force = force_capability.least_force(scaled, scaled.of(s**2 * self.static))[0]
        figures = float(np.median(mass)), float(np.median(force))
        return DriveChange(tuple(map(float, ratios)), float(s), motor, *figures, len(mass))
