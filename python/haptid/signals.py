"""What a motion's channels mean to a device: joint-side coordinates and torques, whichever side was measured."""

from __future__ import annotations

import numpy as np

from haptid._values import Array
from haptid.device import Device
from haptid.errors import ChannelCountError, CommandUnitError
from haptid.log import Log, check_against
from haptid.treatment import Motion


def check_log(device: Device, log: Log) -> tuple[str, ...]:
    """Compare a log with the joints it is said to be of; returns a sentence for each doubt.

    Raises:
        ChannelCountError: more or fewer channels than the device has coordinates or motors.
        LooksLikeDegreesError, LooksLikeRadiansError, SwappedChannelsError: positions that do not fit the joints.
    """
    joints = [device.joints[k] for k in device.active]
    if log.position.shape[1] != len(joints):
        raise ChannelCountError("position", log.position.shape[1], [joint.name for joint in joints])
    motors = [drive.name for drive in device.motors]
    if log.torque.shape[1] != len(motors):
        raise ChannelCountError("torque", log.torque.shape[1], motors)
    ranges = [joint.position_limits for joint in joints]
    return check_against(log, ranges, [joint.prismatic for joint in joints], [joint.name for joint in joints])


def coordinates(device: Device, motion: Motion, start: int, stop: int) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the device's coordinates, each (coordinates, stop - start).

    A motor's shaft angle is divided by its gear; joint positions go through the coupling of the transmission.

    Raises:
        ChannelCountError: the motion has more or fewer position channels than the device has coordinates.
    """
    if motion.q.shape[1] != len(device.drives):
        raise ChannelCountError("position", motion.q.shape[1], [drive.name for drive in device.drives])
    q, qd, qdd = motion.kinematics(start, stop)
    to_coordinates = scale(device, motion)
    if (to_coordinates == np.eye(len(q))).all():
        return q, qd, qdd
    return to_coordinates @ q, to_coordinates @ qd, to_coordinates @ qdd


def external(device: Device, c: Array, cd: Array, cdd: Array) -> Array:
    """Columns that the device computes itself (counterbalances, a user's own), (columns, samples)."""
    if not device.externals:
        return np.zeros((0, c.shape[1]))
    to_joints = np.linalg.inv(device.coupling)
    return np.ascontiguousarray(device.external(to_joints @ c, to_joints @ cd, to_joints @ cdd))


def rows(device: Device, c: Array, cd: Array, cdd: Array) -> Array:
    """All of the core's columns of every coordinate's torque, (coordinates, columns, samples)."""
    mechanism = device.mechanism
    columns = list(range(mechanism.columns))
    return np.asarray(mechanism.regressor(c, cd, cdd, external(device, c, cd, cdd), columns))


def scale(device: Device, motion: Motion) -> Array:
    """Matrix from position channels to coordinates."""
    side = motion.log.channels.position.side if motion.log else "joint"
    if side == "motor":
        return np.diag([1.0 / drive.gear for drive in device.drives])
    return np.asarray(device.coupling)


def coordinate_torque(device: Device, motion: Motion, start: int, stop: int) -> Array:
    """Joint-side torque of every coordinate, (coordinates, stop - start), N m or N; zero where there is no motor.

    Raises:
        ChannelCountError: the motion has more or fewer torque channels than the device has motors.
        CommandUnitError: the log's unit of torque is not the unit of the device's command.
    """
    motors = [k for k, drive in enumerate(device.drives) if drive.motorised]
    if motion.tau.shape[1] != len(motors):
        raise ChannelCountError("torque", motion.tau.shape[1], [device.drives[k].name for k in motors])
    tau = np.zeros((len(device.drives), stop - start))
    for k, channel in zip(motors, motion.tau.T, strict=True):
        tau[k] = channel[start:stop] * torque_gain(device, motion, k)
    return tau


def torque_gain(device: Device, motion: Motion, k: int) -> float:
    """Joint-side torque of coordinate k per unit of its torque channel."""
    drive = device.drives[k]
    if motion.log is None:
        return 1.0
    side, unit = motion.log.channels.torque.side, motion.log.channels.torque_unit
    if side == "joint":
        if unit != device.torque_units[k]:
            raise CommandUnitError(drive.name, unit, device.torque_units[k], "joint")
        return 1.0
    if unit != drive.unit:
        raise CommandUnitError(drive.name, unit, drive.unit, "motor")
    return float(drive.gear * drive.gain)
