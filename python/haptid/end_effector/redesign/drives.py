"""Gears and lengths for a wanted felt mass or force: what a change of the drives and of the size does at the handle.

With the transmission ratios times r and all lengths times s, links taken as slender bars of the same section,

    M = s M_links + r^2 / s^2 M_rotors,   torque limits times r,   Jacobian times s,   static torque of links times s^2:

mass of a link grows with s, its inertia with s^3. A gear costs rotor inertia with r^2 and gives force with r.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, positive
from haptid._internal.pareto import pareto_front
from haptid.dynamics.inverse import inverse_dynamics, mass_matrix
from haptid.end_effector.characterisation import force_capability
from haptid.end_effector.characterisation.jacobian import LINEAR, HandleJacobian, handle_jacobian
from haptid.end_effector.characterisation.model import IdentifiedModel
from haptid.end_effector.datasheet.instruments import DeviceInstruments
from haptid.end_effector.force import WORST_CONDITION
from haptid.errors import IncompleteDeviceError, setting_error

RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5, 1.75, 2.0)
LENGTHS = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5)


@dataclass(frozen=True)
class DriveChange:
    """A change and what it does, medians over the poses.

    Attributes:
        ratio: factor of all transmission ratios.
        length: factor of all lengths.
        mass: largest effective mass, kg.
        force: in the worst direction, N.
    """

    ratio: float
    length: float
    mass: float
    force: float


def drive_changes(
    identified: IdentifiedModel,
    poses: ArrayLike,
    rotor_inertia: Mapping[str, float],
    limits: Mapping[str, float] | None = None,
    ratios: Sequence[float] = RATIOS,
    lengths: Sequence[float] = LENGTHS,
) -> tuple[DriveChange, ...]:
    """Felt mass and force for every pair of factors.

    Args:
        identified: the parameters; rotor inertia is part of them.
        poses: positions of the active joints, (active, poses), rad or m.
        rotor_inertia: of every motor, at its coordinate (shaft inertia times the ratio squared), kg m^2 or kg.
        limits: of the motors' torques, N m or N; the peak torques of the device file where None.
        ratios, lengths: factors.

    Raises:
        IncompleteDeviceError: a motor without rotor inertia or limit.
        SettingError: a factor that is not positive, rotors with more inertia than the device, or only singular poses.
    """
    model, qa = identified.model, np.asarray(poses, dtype=float)
    expect("poses", qa.shape, (len(model.device.active), None))
    for name, factors in (("ratios", ratios), ("lengths", lengths)):
        for factor in factors:
            if not positive(factor):
                raise setting_error(name, factor, "finite factors above 0")
    missing = [motor.name for motor in model.device.motors if motor.name not in rotor_inertia]
    if missing:
        raise IncompleteDeviceError(
            f"the rotor inertia of motor {missing[0]} is not given.",
            where=missing[0],
            advice="Give it at the motor's coordinate: shaft inertia times the transmission ratio squared.",
        )
    handle = handle_jacobian(model, qa, LINEAR, WORST_CONDITION)
    if not handle.usable.any():
        raise setting_error("poses", qa.shape[1], "poses at which the handle is not singular")
    kept = handle_jacobian(model, qa[:, handle.usable], LINEAR, WORST_CONDITION)
    inner = list(kept.moving)
    A = mass_matrix(model, identified.beta, kept.qa)[:, inner][:, :, inner]
    B = model.device.drive_jacobian(model.device.row_map @ kept.qa)
    B = (B if B.ndim == 3 else B[None])[:, model.device.driven][:, :, inner]
    rotors = np.array([rotor_inertia[motor.name] for motor in model.device.motors])
    of_rotors = np.broadcast_to(np.swapaxes(B, 1, 2) @ (rotors[:, None] * B), A.shape)
    if np.linalg.eigvalsh(A - of_rotors)[:, 0].min() <= 0:
        raise setting_error("rotor_inertia", dict(rotor_inertia), "less than the inertia that was identified")
    still = np.zeros_like(kept.qa)
    limits = DeviceInstruments().of(model, "peak") if limits is None else limits
    static = inverse_dynamics(model, identified.beta, kept.qa, still, still)
    return tuple(_changed(kept, A - of_rotors, of_rotors, static, limits, r, s) for r in ratios for s in lengths)


def _changed(
    kept: HandleJacobian,
    links: Array,
    rotors: Array,
    static: Array,
    limits: Mapping[str, float] | None,
    r: float,
    s: float,
) -> DriveChange:
    J, A = s * kept.jacobian, s**3 * links + r**2 * rotors
    mobility = J @ np.linalg.solve(A, J.mT)
    rank = min(J.shape[1:])
    mass = 1 / np.linalg.eigvalsh(mobility)[:, -rank]
    bounds = force_capability.torque_bounds(kept, limits)
    scaled = force_capability.TorqueBounds(bounds.normals, r * bounds.limits, s * bounds.jacobian)
    force = force_capability.least_force(scaled, scaled.of(s**2 * static))[0]
    return DriveChange(float(r), float(s), float(np.median(mass)), float(np.median(force)))


def pareto(
    changes: Sequence[DriveChange], most_mass: float = np.inf, least_force: float = 0.0
) -> tuple[DriveChange, ...]:
    """Changes with at most this mass and at least this force that no other one beats in both, by mass."""
    kept = [one for one in changes if one.mass <= most_mass and one.force >= least_force]
    return pareto_front(kept, lambda one: (one.mass, -one.force))
