"""The transmission: from the [[motors]] of a device file to one drive for each active joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Joint, Motor
from haptid.device.geometry import Reader
from haptid.device.toml.errors_at import Place
from haptid.device.toml.schema import MotorTable
from haptid.errors import DeviceFileError

# Ratio of singular values below which a transmission matrix counts as singular.
_SINGULAR = 1e-9


def read_drives(
    tables: Sequence[MotorTable],
    joints: Sequence[Joint],
    active: tuple[int, ...],
    reader: Reader,
    place: Place,
) -> tuple[Motor, ...]:
    """The motors in order, then a drive without motor for every active joint that no motor drives.

    A file without motors has one motor for each active joint, with gear ratio 1 and torque constant 1.

    Raises:
        DeviceFileError: a motor drives no active joint, or the motors do not determine the active joints.
    """
    names = [joints[j].name for j in active]
    if not tables:
        units = ["N" if joints[j].prismatic else "N m" for j in active]
        return tuple(
            Motor(n, 1.0, 1.0, unit, row) for n, unit, row in zip(names, units, np.eye(len(names)), strict=True)
        )
    drives: list[Motor] = []
    for k, table in enumerate(tables):
        taken = [drive.name for drive in drives]
        if table.name in taken:
            first = str(place.at(taken.index(table.name)))
            raise place.at(k, "name").taken("motor", table.name, first)
        drives.append(_motor(table, names, [joint.name for joint in joints], reader, place.at(k)))
    driven = np.any([drive.row != 0 for drive in drives], axis=0)
    for k in np.flatnonzero(~driven).tolist():
        if names[k] in [drive.name for drive in drives]:
            raise place.taken("motor", names[k], f"joint {names[k]}, which has no motor and is a drive of its own")
        unit = "N" if joints[active[k]].prismatic else "N m"
        drives.append(Motor(names[k], 1.0, 1.0, unit, np.eye(len(names))[k], motorised=False))
    _check(np.array([drive.row for drive in drives]), len(tables), place)
    return tuple(drives)


def _motor(table: MotorTable, active: list[str], joints: list[str], reader: Reader, place: Place) -> Motor:
    drives = table.drives if table.drives is not None else {table.name: 1.0}
    row = np.zeros(len(active))
    idle = f"Name active joints with non-zero factors; the active joints are {', '.join(active)}."
    for name, factor in drives.items():
        at = place.at("drives", name) if table.drives is not None else place.at("name")
        if name not in active:
            found = f'drives "{name}", which is {"a passive joint" if name in joints else "no joint"}'
            raise at.error(f'motor "{table.name}" {found}', idle)
        row[active.index(name)] = reader.number(factor, at)
    if not row.any():
        raise place.error(f'motor "{table.name}" drives no active joint', idle)
    settings: dict[str, float] = {}
    for key, value in (("gear_ratio", table.gear_ratio), ("torque_constant", table.torque_constant)):
        settings[key] = reader.number(value, place.at(key))
        if settings[key] == 0 or not math.isfinite(1 / settings[key]):
            raise place.at(key).error(f"found {value!r}", "Write a number that is not zero.")
    return Motor(table.name, settings["gear_ratio"], settings["torque_constant"], table.command_unit, row)


def _check(N: Array, motors: int, place: Place) -> None:
    scaled = N / np.linalg.norm(N, axis=1, keepdims=True)
    singular = np.linalg.svd(scaled, compute_uv=False)
    rank = int((singular > _SINGULAR * singular[0]).sum())
    if N.shape[0] != N.shape[1] or rank < N.shape[1]:
        raise DeviceFileError(
            f"{place}: {motors} motor coordinates do not determine the {N.shape[1]} active joint positions: the "
            f"transmission matrix has rank {rank}, {N.shape[1]} rows of rank {N.shape[1]} are required.",
            where=place.key,
            found=rank,
            limit=N.shape[1],
            advice="Give each motor its own combination of active joints.",
        )
