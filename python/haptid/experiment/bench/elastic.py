"""Elastic motors on the bench: motion is planned as if they were rigid, and springs are in balance at the start."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentError


def rotors(device: Device) -> list[int]:
    """Indices of the elastic motors' rotors in the active joints."""
    return [device.active.index(drive.first) for drive in device.elastic]


def without_torsion(device: Device, links: Array, position: bool) -> Array:
    """Motion of all active joints without torsion, (n, active), from that of those that are no rotors, (n, links).

    Args:
        device: the device.
        links: positions or rates.
        position: whether they are positions.
    """
    own, made = rotors(device), np.zeros((len(links), len(device.active)))
    made[:, np.delete(np.arange(len(device.active)), own)] = links
    for k, drive in zip(own, device.elastic, strict=True):
        behind = drive.row - drive.torsion
        offset = float(behind @ device.closure.offset) if position else 0.0
        made[:, k] = made @ (behind @ device.closure.constant) + offset
    return made


def planned_torque(device: Device, c: Array, tau: Array) -> Array:
    """Torques of the motors' coordinates on a motion without torsion, (motors, samples), N m or N.

    Args:
        device: the device.
        c: positions of the torque rows' coordinates, (active, samples), rad or m.
        tau: torques of the rows, (active, samples), N m or N.
    """
    if not device.elastic:
        return device.drive_torque(c, tau)
    held = np.delete(np.arange(len(c)), _torsions(device))
    B = device.drive_jacobian(c)[..., device.driven, :][..., held]
    shares = device.law.of(device.driven).shares(B)
    return np.asarray(np.einsum("...dr,r...->d...", shares, tau[held]) if B.ndim == 3 else shares @ tau[held])


def balanced_start(model: DynamicModel, chi: Array, q: Array) -> Array:
    """Positions of the active joints, (active,), with links moved from q so that springs balance gravity.

    Raises:
        ExperimentError: a spring without stiffness.
    """
    device, start = model.device, np.array(q)
    if not device.elastic:
        return start
    pose, rest = start[:, None], np.zeros((len(q), 1))
    motors = [drive.name for drive in device.motors]
    tau = inverse_dynamics(model, model.base.of(chi), pose, rest, rest)
    torque = planned_torque(device, device.row_map @ pose, tau)[:, 0]
    bent = [torque[motors.index(d.name)] / stiffness(model, chi, d.name) for d in device.elastic]
    own = rotors(device)
    links = np.delete(np.arange(len(q)), own)
    moved = np.array([d.row - d.torsion for d in device.elastic]) @ device.closure.constant[:, links]
    start[links] -= np.linalg.pinv(moved) @ bent
    return start


def stiffness(model: DynamicModel, chi: Array, motor: str) -> float:
    """Stiffness of an elastic motor's spring, N m/rad or N/m.

    Raises:
        ExperimentError: it is not positive.
    """
    raw = (model.device.parameters.S @ chi)[10 * len(model.device.joints) :]
    on = f"elastic {motor}"
    name, found = next(
        (term.name, float(value))
        for term, value in zip(model.terms, raw, strict=True)
        if term.on == on and term.nature == "spring"
    )
    if found <= 0:
        raise ExperimentError(
            f"motor {motor} is elastic, and its stiffness {name} is {found:g}; the bench requires a positive one.",
            where=name,
            found=found,
            limit=0.0,
            advice=f"Give {name} under [parameters] in the experiment, N m/rad or N/m.",
        )
    return found


def _torsions(device: Device) -> list[int]:
    """Indices of the torque rows' coordinates that are torsions of elastic motors."""
    if device.torque_rows == "joint":
        return rotors(device)
    return [k for k, drive in enumerate(device.drives) if drive.load_side is not None]
