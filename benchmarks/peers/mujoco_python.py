"""MuJoCo from Python: contacts, limits and all else that the robot does not have are switched off."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from peers.common import MANY, STEPS, Case, mjcf, samples
from stopwatch import Work

OFF = (
    "CONSTRAINT",
    "CONTACT",
    "LIMIT",
    "EQUALITY",
    "FRICTIONLOSS",
    "SPRING",
    "DAMPER",
    "EULERDAMP",
    "SENSOR",
    "ACTUATION",
)


def works(case: Case, folder: Path) -> dict[str, Work]:
    """See `ask.py`."""
    del folder
    model = mujoco.MjModel.from_xml_string(mjcf(case))
    for name in OFF:
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
    data = mujoco.MjData(model)
    q, v, a, tau = samples(case, MANY, "q", "qd", "qdd", "tau")
    made, M = np.zeros((MANY, len(case["parent"]))), np.zeros((MANY, *[len(case["parent"])] * 2))

    def inverse() -> np.ndarray:
        for k in range(MANY):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            made[k] = data.qfrc_inverse
        return made

    def forward() -> np.ndarray:
        for k in range(MANY):
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[k], v[k], tau[k]
            mujoco.mj_forward(model, data)
            made[k] = data.qacc
        return made

    def mass() -> np.ndarray:
        for k in range(MANY):
            data.qpos[:] = q[k]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeM(model, data)
            mujoco.mj_fullM(model, data, M[k])
        return M

    def simulated() -> np.ndarray:
        end = np.empty((MANY, 2 * made.shape[1]))
        for k in range(MANY):
            data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q[k], v[k], tau[k]
            mujoco.mj_step(model, data, STEPS)
            end[k, : made.shape[1]], end[k, made.shape[1] :] = data.qpos, data.qvel
        return end

    return {
        "inverse dynamics": Work(MANY, inverse),
        "mass matrix": Work(MANY, mass),
        "forward dynamics": Work(MANY, forward),
        "simulation step": Work(MANY * STEPS, simulated),
    }
