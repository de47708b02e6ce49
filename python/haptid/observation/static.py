"""Rows of held poses: one for each motor and pose, one cluster for each configuration."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import freeze
from haptid.dynamics.static import StaticModel
from haptid.errors import NoRowsError
from haptid.motion.channels import check_log
from haptid.motion.holds import Poses
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Block
from haptid.observation.r_factor import r_factor


def observe_poses(model: StaticModel, poses: Poses) -> Observation:
    """Reduce poses to R factors in the static base parameters; a block is a configuration.

    The rows of a motor with Coulomb friction are left out at poses to which it has not moved.

    Args:
        model: the static model.
        poses: of its device.

    Raises:
        NoRowsError: no motor has a row.
        LogMismatchError: the channels do not fit the device.
    """
    check_log(model.device, poses.log)
    chosen = list(model.base.independent_columns)
    Y = model.columns(poses.c.T, poses.approach.T)[:, chosen]
    used = model.used_rows(poses.approach.T).T
    count = poses.configurations
    motors, notes = [], list(poses.notes)
    own = np.arange(len(chosen))  # of all motors, so that recordings of other poses add
    for row in np.flatnonzero(model.device.measured).tolist():
        size = len(own) + 1
        stack, rows = np.zeros((count, size, size)), np.zeros(count, dtype=int)
        for k in range(count):
            members = np.flatnonzero((poses.configuration == k) & used[:, row])
            part = np.zeros((max(size, len(members)), size))
            part[: len(members), :-1], part[: len(members), -1] = Y[row][:, members].T, poses.tau[members, row]
            stack[k], rows[k] = r_factor(part), len(members)
        label = model.device.row_labels[row]
        if lost := int((~used[:, row]).sum()):
            notes.append(f"{label} has not moved to {lost} of {len(poses)} poses; its torque there is not used.")
        motors.append(
            MotorRows(
                model.device.row_names[row], label, model.device.torque_units[row], own.copy(), freeze(stack), rows
            )
        )
    if not any(motor.rows.sum() for motor in motors):
        raise NoRowsError("no joint moved between the poses, so no torque is used.", found=0, limit=1)
    name = poses.log.sha256 or str(poses.log.path)
    blocks = []
    for k in range(count):
        members = poses.configuration == k
        blocks.append(Block(f"{name} configuration {k + 1}", *_ends(poses, members)))
    return Observation(model, tuple(motors), tuple(blocks), (), tuple(notes))


def _ends(poses: Poses, members: np.ndarray) -> tuple[float, float]:
    """First and last time of some poses; a row of a table is one unit long."""
    if not members.any():
        return 0.0, 0.0
    start, stop = float(poses.start[members].min()), float(poses.stop[members].max())
    return start, stop if stop > start else start + 1.0
