"""Force capability: the largest force at the handle with limited motor torques, minus the torques for the weight."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.jacobian import HandleJacobian
from haptid.errors import IncompleteDeviceError, UnknownNameError, suggestion


def torque_limits(model: DynamicModel, given: Mapping[str, float] | None) -> Array:
    """Torque limit of each motor's coordinate, (motors,), N m or N: those given, else the joint's in the device.

    Raises:
        IncompleteDeviceError: a motor without a limit, or a limit that is not positive.
        UnknownNameError: a limit of an unknown motor.
    """
    known = given or {}
    made = [known.get(drive.name, _of_joint(model, drive.row)) for drive in model.device.motors]
    for drive, limit in zip(model.device.motors, made, strict=True):
        if limit is None or not (np.isfinite(limit) and limit > 0):
            raise IncompleteDeviceError(
                f"the torque limit of motor {drive.name} is {limit!r}.",
                where=drive.name,
                found=limit,
                advice="Give a finite torque of its coordinate above zero, N m or N, or limits of its joint.",
            )
    names = [drive.name for drive in model.device.motors]
    for name in known:
        if name not in names:
            raise UnknownNameError(
                f"a torque limit is given for {name!r}, which is no motor.",
                where=name,
                limit=tuple(names),
                advice=suggestion(name, names),
            )
    return np.array(made, dtype=float)


def _of_joint(model: DynamicModel, row: Array) -> float | None:
    """Limit of the one joint that a motor drives, at the motor; None where it drives several."""
    joints = np.flatnonzero(row)
    limit = model.device.joints[model.device.active[joints[0]]].torque_limit if len(joints) == 1 else None
    return None if limit is None else limit / abs(float(row[joints[0]]))


def motor_jacobian(handle: HandleJacobian) -> Array:
    """Velocity of the handle by rates of the motors' coordinates, (poses, m, motors)."""
    model, made = handle.model, np.zeros((len(handle), len(handle.rows), len(handle.model.device.active)))
    made[:, :, list(handle.moving)] = handle.jacobian
    driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    return np.asarray((made @ np.linalg.inv(model.device.drive_rates))[:, :, driven])


def motor_torque(model: DynamicModel, torque: Array) -> Array:
    """Torques of the motors' coordinates, (motors, samples), from those of the torque rows, (active, samples)."""
    driven = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    return np.asarray(np.linalg.solve(model.device.drive_rates.T, torque)[driven])


def weakest_motor(jacobian: Array, limits: Array, weight: Array) -> tuple[Array, Array, np.ndarray]:
    """Force in the direction in which it is least, that direction, and the limiting motor.

    A motor is loaded most by a force along its own column of the Jacobian, so the least force over all directions is
    the least of (limit - |weight|) / |column|: no search is needed.

    Args:
        jacobian: (poses, m, motors).
        limits: (motors,).
        weight: torque that carries the device, (motors, poses).
    """
    lengths = np.linalg.norm(jacobian, axis=1)
    available = np.maximum(limits - np.abs(weight.T), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        force = np.where(lengths > 0, available / lengths, np.inf)
    motor = np.argmin(force, axis=1)
    at = np.arange(len(force))
    # The sign for which the force loads the motor like the weight.
    column = jacobian[at, :, motor] * np.where(weight[motor, at] < 0, -1.0, 1.0)[:, None]
    return force[at, motor], column / np.linalg.norm(column, axis=1, keepdims=True), motor


def force_along(jacobian: Array, limits: Array, weight: Array, direction: Array) -> tuple[Array, Array, np.ndarray]:
    """Largest force along one direction, the limiting motor's torque per force, and that motor, (poses,) each.

    The force is infinite where no motor is loaded by it. Motors carry the weight and push: |weight + J' f d| <= limit.
    """
    load = np.einsum("pmk,m->pk", jacobian, direction)
    available = np.maximum(limits - np.sign(load) * weight.T, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        force = np.where(load != 0, available / np.abs(load), np.inf)
    motor, at = np.argmin(force, axis=1), np.arange(len(force))
    return force[at, motor], load[at, motor], motor
