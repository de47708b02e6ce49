"""The transmission: from a file's motors to one drive for each active joint."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.device import Joint, Motor
from haptid.device.geometry import Reader
from haptid.device.toml.place import Place
from haptid.device.toml.schema import MotorTable
from haptid.errors import DeviceValueError, DuplicateNameError, IdleMotorError, TransmissionError

# A transmission matrix with a smaller ratio of singular values cannot be inverted.
SINGULAR = 1e-9


def read_drives(
    tables: Sequence[MotorTable],
    joints: Sequence[Joint],
    active: tuple[int, ...],
    reader: Reader,
    place: Place,
) -> tuple[Motor, ...]:
    """The motors in order, then a drive without motor for every active joint that no motor drives.

    A file without motors has one motor for each active joint, with gear 1 and gain 1.

    Raises:
        IdleMotorError: a motor drives no active joint.
        TransmissionError: the motors' coordinates do not determine the active joints.
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
            raise DuplicateNameError(str(place.at(k, "name")), "motor", table.name, first)
        drives.append(_motor(table, names, [joint.name for joint in joints], reader, place.at(k)))
    driven = np.any([drive.row != 0 for drive in drives], axis=0)
    for k in np.flatnonzero(~driven).tolist():
        if names[k] in [drive.name for drive in drives]:
            raise DuplicateNameError(
                str(place),
                "motor",
                names[k],
                f"joint {names[k]}, which has no motor and is a drive of its own",
            )
        unit = "N" if joints[active[k]].prismatic else "N m"
        drives.append(Motor(names[k], 1.0, 1.0, unit, np.eye(len(names))[k], motorised=False))
    _check(np.array([drive.row for drive in drives]), len(tables), place)
    return tuple(drives)


def _motor(table: MotorTable, active: list[str], joints: list[str], reader: Reader, place: Place) -> Motor:
    drives = table.drives if table.drives is not None else {table.name: 1.0}
    row = np.zeros(len(active))
    for name, factor in drives.items():
        at = place.at("drives", name) if table.drives is not None else place.at("name")
        if name not in active:
            found = f'drives "{name}", which is {"a passive joint" if name in joints else "no joint"}'
            raise IdleMotorError(str(at), table.name, found, active)
        row[active.index(name)] = reader.number(factor, at)
    if not row.any():
        raise IdleMotorError(str(place), table.name, "drives no active joint", active)
    settings: dict[str, float] = {}
    for key, value in (("gear", table.gear), ("gain", table.gain)):
        settings[key] = reader.number(value, place.at(key))
        if settings[key] == 0 or not math.isfinite(1 / settings[key]):
            raise DeviceValueError(str(place.at(key)), f"found {value!r}", "Write a number that is not zero.")
    return Motor(table.name, settings["gear"], settings["gain"], table.unit, row)


def _check(N: Array, motors: int, place: Place) -> None:
    scaled = N / np.linalg.norm(N, axis=1, keepdims=True)
    singular = np.linalg.svd(scaled, compute_uv=False)
    rank = int((singular > SINGULAR * singular[0]).sum())
    if N.shape[0] != N.shape[1] or rank < N.shape[1]:
        raise TransmissionError(str(place), motors, N.shape[1], rank)
