"""Joint-side coordinates and torques of a device from a motion's channels, measured at the joints or the motors."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device
from haptid.device.parts import DistributionLaw
from haptid.errors import LogMismatchError
from haptid.log import Log, check_against
from haptid.motion.motion import Motion


def check_log(device: Device, log: Log) -> tuple[str, ...]:
    """Check a log against the device's joints; returns a note for each joint outside its limits.

    Raises:
        LogMismatchError: more or fewer channels than the device has coordinates or motors, or positions that do not fit
            the joints.
    """
    _expect_seen(device, log)
    for kind, count, names in (
        ("position", log.position.shape[1], position_channels(device, log.channels.position.side)),
        ("torque", log.torque.shape[1], torque_channels(device, log.channels.torque.side)),
    ):
        if count != len(names):
            raise _wrong_count(kind, count, names)
    _expect_torque_of_springs(device)
    joints = [device.joints[k] for k in device.active]
    ranges = [joint.position_limits for joint in joints]
    return check_against(log, ranges, [joint.prismatic for joint in joints], [joint.name for joint in joints])


def position_channels(device: Device, side: str) -> list[str]:
    """Names of the position channels: active joints, or motors' shafts; torsions that sensors measure have none."""
    if side == "joint":
        sensed = [int(np.argmax(drive.sensed)) for drive in device.elastic if drive.sensed is not None]
        return [device.joints[k].name for k in device.active if k not in sensed]
    return [drive.name for drive in device.drives if not drive.sensor]


def torque_channels(device: Device, side: str) -> list[str]:
    """Names of the torque channels: joints with measured torque, or motors."""
    if side == "motor":
        return [drive.name for drive in device.motors]
    return [device.joints[j].name for k, j in enumerate(device.active) if _joint_measured(device)[k]]


def _joint_measured(device: Device) -> np.ndarray:
    """Whether each active joint's torque is measured: all drives coupled to it have a motor."""
    acts = device.drive_rows @ (np.abs(device.closure.constant) + device.closure.varying) != 0
    acts[~device.unknown_torque] = False
    return np.asarray(~acts.any(axis=0))


def coordinates(device: Device, motion: Motion, start: int, stop: int) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of the device's coordinates, each (coordinates, stop - start).

    Raises:
        LogMismatchError: the motion has more or fewer position channels than the device has coordinates.
        MissingAccelerationError: velocity is by a causal differentiator.
    """
    q, qd, qdd = motion.kinematics(start, stop)
    change = position_map(device, motion)
    return change(q), change(qd), change(qdd)


def state(device: Device, motion: Motion, start: int, stop: int) -> tuple[Array, Array]:
    """Position and velocity of the device's coordinates, each (coordinates, stop - start).

    Raises:
        LogMismatchError: the motion has more or fewer position channels than the device has coordinates.
    """
    q, qd = motion.state(start, stop)
    change = position_map(device, motion)
    return change(q), change(qd)


def position_map(device: Device, motion: Motion) -> Callable[[Array], Array]:
    """Linear map from position channels, or their rates, to the coordinates', both (channels, samples).

    Raises:
        LogMismatchError: the motion has more or fewer position channels than the device has coordinates or drives.
        IncompleteDeviceError: the shafts of its log do not determine the active joints.
    """
    side = motion.log.channels.position.side if motion.log else "joint"
    names = position_channels(device, side)
    if motion.q.shape[1] != len(names):
        raise _wrong_count("position", motion.q.shape[1], names)
    change = np.asarray(device.row_map) @ _active_from_channels(device, side)
    if change.shape == (len(names), len(names)) and (change == np.eye(len(names))).all():
        return lambda x: x
    return lambda x: np.asarray(change @ x)


def _active_from_channels(device: Device, side: str) -> Array:
    """Positions of the active joints by those of the position channels, (active, channels)."""
    if side == "motor":
        own = [k for k, drive in enumerate(device.drives) if not drive.sensor]  # a sensor's coordinate is zero
        return np.asarray(device.active_from_drives[:, own] / [device.drives[k].gear_ratio for k in own])
    made = np.eye(len(device.active))
    sensed = []
    for drive in device.elastic:
        if drive.sensed is not None and drive.load_side is not None:
            sensed.append(device.active.index(int(np.argmax(drive.sensed))))
            made[sensed[-1]] = (drive.row - drive.load_side) @ device.closure.constant
    return np.delete(made, sensed, axis=1)


def coordinate_torque(device: Device, motion: Motion, start: int, stop: int) -> Array:
    """Torque of every coordinate, at the joint side, (coordinates, stop - start), N m or N; zero where not measured.

    A motion without a log holds the coordinates' torques; a log holds the motors' commands, or joint torques.

    Raises:
        LogMismatchError: the motion has more or fewer torque channels than the device has motors.
        LogMismatchError: the log's unit of torque is not the unit of the device's command.
    """
    known = [name for name, measured in zip(device.row_names, device.measured, strict=True) if measured]
    names = torque_channels(device, motion.log.channels.torque.side) if motion.log else known
    if motion.tau.shape[1] != len(names):
        raise _wrong_count("torque", motion.tau.shape[1], names)
    measured = np.ascontiguousarray(motion.tau[start:stop].T)
    if motion.log is None:
        tau = np.zeros((len(device.active), stop - start))
        tau[list(device.measured)] = measured
        return tau
    if motion.log.channels.torque.side == "motor" and device.drive_varies.any():
        shafts = motor_torque(device, motion.log, measured)
        c = position_map(device, motion)(np.ascontiguousarray(motion.q[start:stop].T))
        return np.ascontiguousarray(np.einsum("sda,ds->as", channel_shares(device, motion, c), shafts))
    return np.ascontiguousarray(torque_map(device, motion.log) @ measured)


def channel_shares(device: Device, motion: Motion, c: Array) -> Array:
    """B: the coordinates' torques are B' times those of the torque channels, (samples or 1, channels, coordinates).

    Channels are taken at the joint side: motors' torques include gear and torque constant.

    Args:
        motion: whose channels.
        c: positions of the coordinates, (active, samples), rad or m.
    """
    if motion.log is None:
        return np.eye(len(device.active))[None, list(device.measured)]
    if motion.log.channels.torque.side != "motor":
        return np.asarray(np.linalg.inv(device.row_map)[None, _joint_measured(device)], dtype=np.float64)
    B = device.drive_jacobian(c)
    return (B if B.ndim == 3 else B[None])[:, device.driven]


def channel_torque(device: Device, shares: Array, torque: Array) -> Array:
    """Torque of the channels by the distribution law, or by the minimal norm where the device file has none.

    Args:
        shares: see `channel_shares`.
        torque: of the coordinates, (active, samples), N m or N; only those whose torque is measured count.

    Returns:
        At the joint side, without preload, (channels, samples), N m or N.
    """
    law = device.distribution or DistributionLaw.even(len(device.drives))
    law = law.of(device.driven) if shares.shape[1] == len(device.driven) else DistributionLaw.even(shares.shape[1])
    measured = list(np.flatnonzero(device.measured))
    D, rows = law.shares(shares[:, :, measured]), torque[measured].T
    return np.asarray(np.einsum("scr,sr->cs", np.broadcast_to(D, (len(rows), *D.shape[1:])), rows))


def motor_torque(device: Device, log: Log, commands: Array) -> Array:
    """Torques of the motors' coordinates from the log's commands, both (motors, samples), N m or N.

    Raises:
        LogMismatchError: the log has torques of joints, or in another unit than the device's command.
    """
    if log.channels.torque.side != "motor":
        raise LogMismatchError(
            f"the log has torques of joints, and those of the motors of {device.name} are required.",
            where="torque",
            found="joint",
            limit="motor",
            advice="Record one torque for each motor.",
        )
    for drive, unit in zip(device.motors, log.channels.torque_units, strict=False):
        if unit != drive.command_unit:
            raise _wrong_unit(drive.name, unit, drive.command_unit, "motor")
    factors = [drive.gear_ratio * drive.torque_constant for drive in device.motors]
    return np.asarray(commands * np.array(factors)[:, None])


def torque_map(device: Device, log: Log) -> Array:
    """Matrix from torque channels to the coordinates' torques, (coordinates, channels).

    Raises:
        LogMismatchError: the log's unit is not the device's, or the matrix varies with the pose.
    """
    if log.channels.torque.side == "motor":
        if device.drive_varies.any():
            raise LogMismatchError(
                f"the torques of {device.name}'s coordinates are combinations of its motors' that vary with the pose; "
                "this method requires constant ones.",
                where=device.name,
                advice="Record the torques of the active joints, or use a method that evaluates every sample.",
            )
        return np.asarray(device.drive_rates[device.driven].T @ motor_torque(device, log, np.eye(len(device.motors))))
    for j, unit in zip(np.asarray(device.active)[_joint_measured(device)], log.channels.torque_units, strict=False):
        wanted = "N" if device.joints[j].prismatic else "N m"
        if unit != wanted:
            raise _wrong_unit(device.joints[j].name, unit, wanted, "joint")
    return np.asarray(np.linalg.inv(device.row_map).T[:, _joint_measured(device)])


def _expect_seen(device: Device, log: Log) -> None:
    """Raise LogMismatchError where joints that springs hold and no motor moves seem to have no position in the log."""
    names = position_channels(device, log.channels.position.side)
    active = [device.joints[k].name for k in device.active]
    held = {
        name
        for term in device.tables.terms
        if term.kind == "spring"
        for name in (active if term.joints == "all" else term.joints or ())
    }
    still = _without_known_torque(device)
    unseen = [name for name in active if name in held & still]
    if not unseen or len(names) - log.position.shape[1] != len(unseen):
        return
    words = {word for source in log.channels.position.channels for word in re.split(r"[^\w]|_", source)}
    if words.intersection(unseen):  # it is another one that the log lacks
        return
    what = f"the position of {', '.join(unseen)}, which a spring holds and no motor moves"
    # Channels are in order, not named: which one is missing is known where they have the names of all others.
    known = words.issuperset(set(names).difference(unseen))
    raise LogMismatchError(
        (
            f"no channel has {what}: "
            if known
            else f"the log has {log.position.shape[1]} position channels, and the device requires {len(names)}: "
            f"{', '.join(names)}. If none of them is {what}, "
        )
        + "how far it gives is nowhere in the log, and its stiffness cannot be told from the inertia that it carries.",
        where="position",
        found=log.position.shape[1],
        limit=len(names),
        advice=("" if known else "If another one is missing, map one channel for each, in this order. Else: ")
        + f"Record its position ({', '.join(names)}) with an encoder, a gyroscope or a camera on what it carries, and "
        "remove the spring term: its torque is in no measured one, and the other parameters are told without it. "
        "Where it gives in line with a motor's joint, leave the joint out and write an elastic term for that motor: "
        "stiffness is then found from the motor alone, by motion up to the resonance. Or leave it out as rigid: "
        "the diagnosis says up to which frequency that holds.",
    )


def _expect_torque_of_springs(device: Device) -> None:
    """Raise LogMismatchError where a spring is on a joint that no motor moves: its torque is in no measured one."""
    still = _without_known_torque(device)
    springs = [term for term in device.tables.terms if term.kind == "spring" and term.joints not in (None, "all")]
    unseen = sorted({name for term in springs for name in term.joints or ()} & still)
    if unseen:
        raise LogMismatchError(
            f"a spring holds {', '.join(unseen)}, which no motor moves: its torque is in no torque that is measured, "
            "and its stiffness cannot be told.",
            where=", ".join(unseen),
            advice="Where it gives in line with a motor's joint, leave it out and write an elastic term for that "
            "motor, whose position and link's are then measured. Else remove the spring term: parameters that the "
            "motors' torques tell do not depend on it.",
        )


def _without_known_torque(device: Device) -> set[str]:
    """Names of active joints that no motor moves, by passive joints of a loop neither.

    That of a joint behind an elastic motor, and of a free one, is known to be zero: a spring is in a row of its own.
    """
    rates = np.abs(device.closure.constant) + device.closure.varying
    free = np.array([drive.free for drive in device.drives])
    known = (np.abs(device.drive_rows[~device.unknown_torque | free]) @ rates).any(axis=0)
    return {device.joints[k].name for k, own in zip(device.active, known, strict=True) if not own}


def _wrong_count(kind: str, got: int, names: list[str]) -> LogMismatchError:
    """Error of too many or too few channels."""
    advice = ["Map one channel for each, in this order."]
    if got < len(names):
        advice.append(
            "A joint that stands still and that the log lacks is held in the device file: import the robot with "
            "--hold JOINT=0."
        )
        if kind == "torque":
            advice.append(
                'A joint that nothing drives has torque = "zero" in its [[joints]], and [[motors]] are those of the '
                "others."
            )
    return LogMismatchError(
        f"the log has {got} {kind} channels, and the device requires {len(names)}: {', '.join(names)}.",
        where=kind,
        found=got,
        limit=len(names),
        advice=" ".join(advice),
    )


def _wrong_unit(name: str, got: str, wanted: str, side: str) -> LogMismatchError:
    """Error of a torque in another unit than the device's command."""
    return LogMismatchError(
        f"the torque channel of {name} is in {got!r} at the {side} side, and the device file has {wanted!r}.",
        where=name,
        found=got,
        limit=wanted,
        advice=(
            "Set the motor's `command_unit` and `torque_constant` in the device file; or write in the study "
            f'`side = "joint"`, `unit = "{wanted}"`, and as `gain` what one unit of the channel exerts at the joint '
            "(torque constant times gear ratio)."
        ),
    )
