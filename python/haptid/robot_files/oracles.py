"""Torques of other programs from the same file: Pinocchio for URDF, MuJoCo for MJCF."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import MissingDependencyError, RobotFileError
from haptid.robot_files.check import LARGEST_ERROR, ComparedStates, difference
from haptid.robot_files.moving_tree import MovingTree
from haptid.robot_files.newton_euler import tree_torque
from haptid.robot_files.xml import refused


def ask_others(path: Path, of: MovingTree, states: ComparedStates) -> dict[str, float]:
    """Greatest relative difference of torques from another program, by its name.

    Raises:
        MissingDependencyError: the program for this format is not installed.
        RobotFileError: the program differs, or cannot read the file.
    """
    asked = {"urdf": ("pinocchio", pinocchio_torque, "oracle"), "mjcf": ("mujoco", mujoco_torque, "robots")}
    if of.tree.form not in asked or path.suffix == ".xacro":
        raise refused(str(path), f"no other program is asked about {of.tree.form}", "Import it without --check.")
    module, torque, extra = asked[of.tree.form]
    try:
        library = importlib.import_module(module)
    except ImportError:
        raise MissingDependencyError(
            f"the comparison requires the package {module}, which is not installed.",
            where=module,
            advice=f"Install it with `pip install haptid[{extra}]`.",
        ) from None
    try:
        others = torque(library, path, of, states)
    except (ValueError, RuntimeError, KeyError) as error:
        found = f"{module} cannot be compared: {' '.join(str(error).split())[:300]}"
        raise refused(str(path), found, "Import it without --check.") from None
    bodies = tree_torque(of, states.q, states.qd, states.qdd, False)
    own = tree_torque(of, states.q, states.qd, states.qdd)
    # Friction of the source is the same on both sides: other programs smooth it, or leave it out.
    found_difference = difference(states, others + (own - bodies), bodies)
    if not found_difference < LARGEST_ERROR:
        raise RobotFileError(
            f"{path}: the device's torques differ from those of {module} by {found_difference:.1e} of the greatest one "
            f"(limit {LARGEST_ERROR:g}).",
            where=str(path),
            found=found_difference,
            limit=LARGEST_ERROR,
            advice="Something that the notes name may be the reason; import without --check if so.",
        )
    return {module: found_difference}


def pinocchio_torque(pin: Any, path: Path, of: MovingTree, states: ComparedStates) -> Array:
    """Torque of every moving joint without friction, (moving, n), by Pinocchio's RNEA."""
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array(of.tree.gravity)
    data = model.createData()
    names = [one.joint.name for one in of.moving]
    made = np.zeros((len(names), len(states.rows)))
    for k in range(len(states.rows)):
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for name, held in of.held.items():
            if model.existJointName(name):
                _set(model, name, held, q)
        for name in names:
            joint = model.joints[model.getJointId(name)]
            _set(model, name, float(states.q[name][k]), q)
            v[joint.idx_v], a[joint.idx_v] = states.qd[name][k], states.qdd[name][k]
        tau = pin.rnea(model, data, q, v, a)
        made[:, k] = [tau[model.joints[model.getJointId(name)].idx_v] for name in names]
    return made + _own(of, states)


def _set(model: Any, name: str, value: float, q: Array) -> None:
    joint = model.joints[model.getJointId(name)]
    if joint.nq == 2:  # a continuous joint is a point on the circle
        q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
    elif joint.nq == 1:
        q[joint.idx_q] = value


def _own(of: MovingTree, states: ComparedStates) -> Array:
    """Torque of armatures and springs, (moving, n), which Pinocchio does not read."""
    joints = [one.joint for one in of.moving]
    return np.array([x.armature * states.qdd[x.name] + x.stiffness * (states.q[x.name] - x.rest) for x in joints])


def mujoco_torque(mujoco: Any, path: Path, of: MovingTree, states: ComparedStates) -> Array:
    """Torque of every moving joint without friction, (moving, n), by mj_inverse with constraints off."""
    model = mujoco.MjModel.from_xml_path(str(path))
    return mujoco_model_torque(mujoco, model, of, states)


def mujoco_model_torque(mujoco: Any, model: Any, of: MovingTree, states: ComparedStates) -> Array:
    """The same of a model."""
    flags = mujoco.mjtDisableBit
    for flag in (flags.mjDSBL_CONSTRAINT, flags.mjDSBL_CONTACT, flags.mjDSBL_ACTUATION, flags.mjDSBL_DAMPER):
        model.opt.disableflags |= int(flag)
    model.opt.density = model.opt.viscosity = 0.0
    model.body_gravcomp[:] = 0.0
    if model.ntendon:
        model.tendon_stiffness[:] = model.tendon_damping[:] = model.tendon_armature[:] = 0.0
    data = mujoco.MjData(model)
    index: Mapping[str, int] = {model.joint(j).name or f"joint {j}": j for j in range(model.njnt)}
    names = [one.joint.name for one in of.moving]
    made = np.zeros((len(names), len(states.rows)))
    for k in range(len(states.rows)):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = data.qacc[:] = 0.0
        for name, held in of.held.items():
            if name in index and model.jnt_type[index[name]] in (2, 3):
                data.qpos[model.jnt_qposadr[index[name]]] = held
        for name in names:
            j = index[name]
            data.qpos[model.jnt_qposadr[j]] = states.q[name][k]
            data.qvel[model.jnt_dofadr[j]] = states.qd[name][k]
            data.qacc[model.jnt_dofadr[j]] = states.qdd[name][k]
        mujoco.mj_inverse(model, data)
        made[:, k] = [data.qfrc_inverse[model.jnt_dofadr[index[name]]] for name in names]
    return made
