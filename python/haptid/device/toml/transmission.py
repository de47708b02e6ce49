"""The transmission: from the [[motors]] of a device file to its drives, and the law by which redundant ones share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import TorqueRows
from haptid.device.geometry import Reader
from haptid.device.loops.formula import AnyClosure
from haptid.device.parts import DistributionLaw, Joint, Motor
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import AnyDevice, MotorTable, TransmissionTable
from haptid.errors import DeviceFileError

# Ratio of singular values below which a transmission matrix counts as singular.
_SINGULAR = 1e-9
# Random poses at which a transmission that varies with the pose has to determine the active joints at least once.
_POSES = 8


def free_joints(tables: AnyDevice, active: Sequence[int], place: Place) -> frozenset[int]:
    """Indices of the joints whose torque the file states to be zero.

    Raises:
        DeviceFileError: a loop moves one of them, or all joints are such.
    """
    free = frozenset(k for k, table in enumerate(tables.joints) if table.torque == "zero")
    for k in sorted(free - set(active)):
        found = f'joint "{tables.joints[k].name}" has torque = "zero", and a loop moves it'
        raise place.at(k, "torque").error(found, "Leave the key out: its balance is in the rows of the active joints.")
    if free and free.issuperset(active):
        raise place.at(min(free), "torque").error(
            "no motor drives any joint: where all torques are zero, the motion shows parameters only up to a common "
            "factor, such as friction over inertia",
            "Leave out one key, map the torque of that joint, and record motion that it drives.",
        )
    return free


def without_rows(drives: Sequence[Motor]) -> tuple[str, ...]:
    """A sentence on the joints whose torque is not known, so that they have no row."""
    names = [drive.name for drive in drives if not (drive.motorised or drive.unloaded or drive.free)]
    if not names:
        return ()
    one = len(names) == 1
    return (
        f"{'Joint' if one else 'Joints'} {', '.join(names)} {'has' if one else 'have'} no motor, and what moves "
        f"{'it' if one else 'them'} is not known: {'it has' if one else 'they have'} no row of torque. Where nothing "
        'does, no hand and no brake, torque = "zero" in the table of the joint adds one.',
    )


def read_drives(
    tables: Sequence[MotorTable],
    joints: Sequence[Joint],
    active: tuple[int, ...],
    free: frozenset[int],
    closure: AnyClosure,
    reader: Reader,
    place: Place,
) -> tuple[Motor, ...]:
    """The motors in order, then a drive without motor for every active joint that no motor moves.

    A file without motors has one motor for each active joint that is not free, with gear ratio 1 and torque constant 1.

    Raises:
        DeviceFileError: a motor drives no joint, or a free one, or the motors do not determine the active joints.
    """
    unit_rows = np.eye(len(joints))
    if not tables:
        ordered = sorted(active, key=lambda j: j in free)
        return tuple(_plain(joints[j], unit_rows[j], j not in free, j in free) for j in ordered)
    drives: list[Motor] = []
    for k, table in enumerate(tables):
        taken = [drive.name for drive in drives]
        if table.name in taken:
            raise place.at(k, "name").taken("motor", table.name, str(place.at(taken.index(table.name))))
        drives.append(_motor(table, [joint.name for joint in joints], reader, place.at(k)))
    reached = (closure.constant != 0) | closure.varying
    driven = np.any([reached[drive.row != 0].any(axis=0) for drive in drives], axis=0)
    for j in (active[k] for k in np.flatnonzero(driven)):
        if j in free:
            found = f'joint "{joints[j].name}" has torque = "zero", and a motor moves it'
            raise place.error(found, "Remove one of the two.")
    for k in np.flatnonzero(~driven).tolist():
        name = joints[active[k]].name
        if name in [drive.name for drive in drives]:
            raise place.taken("motor", name, f"joint {name}, which has no motor and is a drive of its own")
        drives.append(_plain(joints[active[k]], unit_rows[active[k]], False, active[k] in free))
    _check(np.array([drive.row for drive in drives]), closure, len(tables), place)
    return tuple(drives)


def torque_rows(table: TransmissionTable, drives: Sequence[Motor], active: tuple[int, ...], place: Place) -> TorqueRows:
    """Whether torque rows are the motors' or the joints': the joints' where motors are redundant or on passive joints.

    Raises:
        DeviceFileError: the file asks for motor rows of such motors.
    """
    if any(drive.sensor for drive in drives):
        return "joint"  # the coordinate of a torque sensor is always zero
    passive = next((drive.name for drive in drives if np.delete(drive.row, active).any()), None)
    if len(drives) == len(active) and passive is None:
        return table.torque_rows or "motor"
    if table.torque_rows == "motor":
        why = f"{len(drives)} drives move {len(active)} active joints" if passive is None else ""
        raise place.at("torque_rows").error(
            f'found "motor", but {why or f"motor {passive} drives a passive joint"}',
            'Write "joint", or leave it out: rows are then of the active joints, from the torques of all motors.',
        )
    return "joint"


def read_distribution(
    table: TransmissionTable,
    drives: Sequence[Motor],
    joints: Sequence[Joint],
    active: tuple[int, ...],
    reader: Reader,
    place: Place,
) -> DistributionLaw | None:
    """The distribution law; None where motors in N and in N m are redundant and the file gives no weights.

    Raises:
        DeviceFileError: a weight or preload of no motor, a weight that is not positive, a motor without a weight.
    """
    names = [drive.name for drive in drives]
    motors = [drive.name for drive in drives if drive.motorised]
    weights, preload = np.ones(len(names)), np.zeros(len(names))
    for key, values, made in (("weights", table.weights, weights), ("preload", table.preload, preload)):
        for name, value in (values or {}).items():
            at = place.at(key, name)
            if name not in motors:
                raise at.unknown("motor", name, motors)
            made[names.index(name)] = reader.positive(value, at) if key == "weights" else reader.number(value, at)
    missing = [name for name in motors if table.weights is not None and name not in table.weights]
    if missing:
        raise place.at("weights").error(f"motor {missing[0]} has no weight", "Give every motor a positive number.")
    slides = {joints[drive.first].prismatic for drive in drives}
    if table.weights is None and len(slides) > 1 and len(drives) > len(active):
        return None
    return DistributionLaw(weights, preload)


def _plain(joint: Joint, row: Array, motorised: bool, free: bool) -> Motor:
    """A drive that is the joint itself."""
    return Motor(joint.name, 1.0, 1.0, "N" if joint.prismatic else "N m", row, motorised, free=free)


def _motor(table: MotorTable, joints: list[str], reader: Reader, place: Place) -> Motor:
    drives: Mapping[str, float | str] = table.drives if table.drives is not None else {table.name: 1.0}
    row = np.zeros(len(joints))
    idle = f"Name joints with non-zero factors; the joints are {', '.join(joints)}."
    for name, factor in drives.items():
        at = place.at("drives", name) if table.drives is not None else place.at("name")
        if name not in joints:
            raise at.error(f'motor "{table.name}" drives "{name}", which is no joint', idle)
        row[joints.index(name)] = reader.number(factor, at)
    if not row.any():
        raise place.error(f'motor "{table.name}" drives no joint', idle)
    settings: dict[str, float] = {}
    for key, value in (("gear_ratio", table.gear_ratio), ("torque_constant", table.torque_constant)):
        settings[key] = reader.number(value, place.at(key))
        if settings[key] == 0 or not math.isfinite(1 / settings[key]):
            raise place.at(key).error(f"found {value!r}", "Write a number that is not zero.")
    return Motor(table.name, settings["gear_ratio"], settings["torque_constant"], table.command_unit, row)


def _check(rows: Array, closure: AnyClosure, motors: int, place: Place) -> None:
    """Raise unless the drives determine the active joints, at some pose at least."""
    B = rows @ closure.constant
    if (np.abs(rows) @ closure.varying).any():
        followed = closure.follow(closure.draw(np.random.default_rng(0), _POSES))
        B = np.einsum("dj,sja->sda", rows, followed.G)
    scaled = B / np.maximum(np.linalg.norm(B, axis=-1, keepdims=True), np.finfo(float).tiny)
    singular = np.linalg.svd(scaled, compute_uv=False)
    rank = int((singular > _SINGULAR * singular[..., :1]).sum(axis=-1).max())
    active = closure.constant.shape[1]
    if rank < active:
        raise DeviceFileError(
            f"{place}: {motors} motor coordinates do not determine the {active} active joint positions: the "
            f"transmission matrix has rank {rank}, rank {active} is required.",
            where=place.key,
            found=rank,
            limit=active,
            advice="Give each motor its own combination of joints, or name a motor for every active joint.",
        )
