"""Torques of other programs: of URDF and MJCF from the same file, of other formats by Pinocchio from the tree."""

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

# Armature of ball joints, kg m^2, with which MuJoCo's mass matrix is regular; its torque is subtracted.
_ARMATURE = 1e-3


def ask_others(path: Path, of: MovingTree, states: ComparedStates) -> dict[str, float]:
    """Greatest relative difference of torques from another program, by its name.

    Raises:
        MissingDependencyError: the program for this format is not installed.
        RobotFileError: the program differs, or cannot read the file.
    """
    asked = {"urdf": ("pinocchio", pinocchio_torque, "oracle"), "mjcf": ("mujoco", mujoco_torque, "robots")}
    # Of files that neither program reads, Pinocchio gets the links and joints as they were read here.
    as_read = ("pinocchio", pinocchio_tree_torque, "oracle")
    module, torque, extra = as_read if path.suffix == ".xacro" else asked.get(of.tree.form, as_read)
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
    return _by_pinocchio(pin, model, of, states)


def pinocchio_tree_torque(pin: Any, _: Path, of: MovingTree, states: ComparedStates) -> Array:
    """The same of moving links and joints as they were read, of formats that Pinocchio does not read."""
    model = pin.Model()
    model.gravity.linear = of.base[:3, :3].T @ np.array(of.tree.gravity)
    made: list[int] = []
    for one in of.moving:
        kind = pin.JointModelPrismaticUnaligned if one.joint.kind == "prismatic" else pin.JointModelRevoluteUnaligned
        above = made[one.parent] if one.parent >= 0 else 0
        frame = pin.SE3(one.placement[:3, :3], one.placement[:3, 3])
        made.append(model.addJoint(above, kind(np.array(one.joint.axis)), frame, one.joint.name))
        if one.body is not None:
            body = pin.Inertia(one.body.mass, np.array(one.body.com), np.array(one.body.inertia))
            model.appendBodyToJoint(made[-1], body, pin.SE3.Identity())
    return _by_pinocchio(pin, model, of, states)


def _by_pinocchio(pin: Any, model: Any, of: MovingTree, states: ComparedStates) -> Array:
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
    known = {tendon.name: tendon for tendon in of.tendons}
    for t in range(model.ntendon):
        tendon = known.get(model.tendon(t).name or f"tendon {t}")
        model.tendon_stiffness[t] = tendon.stiffness if tendon else 0.0
        model.tendon_armature[t] = tendon.armature if tendon else 0.0
        model.tendon_damping[t] = model.tendon_stiffnesspoly[t] = model.tendon_dampingpoly[t] = 0.0
    _bodies_of(mujoco, model, of)
    data = mujoco.MjData(model)
    index: Mapping[str, int] = {model.joint(j).name or f"joint {j}": j for j in range(model.njnt)}
    names = [one.joint.name for one in of.moving]
    hinges = {joint.name for joint in of.tree.joints if joint.ball}
    balls = [_Ball(of, name, index[name]) for name in dict.fromkeys(x.ball for x in of.tree.joints if x.ball)]
    balls = [ball for ball in balls if ball.moves]
    made = np.zeros((len(names), len(states.rows)))
    for k in range(len(states.rows)):
        mujoco.mj_resetData(model, data)
        data.qvel[:] = data.qacc[:] = 0.0
        for name, held in of.held.items():
            if name in index and model.jnt_type[index[name]] in (2, 3):
                data.qpos[model.jnt_qposadr[index[name]]] = held
        for name in names:
            if name in hinges:
                continue
            j = index[name]
            data.qpos[model.jnt_qposadr[j]] = states.q[name][k]
            data.qvel[model.jnt_dofadr[j]] = states.qd[name][k]
            data.qacc[model.jnt_dofadr[j]] = states.qdd[name][k]
        for ball in balls:
            ball.place(mujoco, model, data, states, k)
        mujoco.mj_inverse(model, data)
        torque = {x: y for ball in balls for x, y in ball.torque(model, data).items()}
        made[:, k] = [
            torque[name] if name in hinges else data.qfrc_inverse[model.jnt_dofadr[index[name]]] for name in names
        ]
    return made


def _bodies_of(mujoco: Any, model: Any, of: MovingTree) -> None:
    """Give rods that spin the bodies of the tree, which have no moment of inertia about their line."""
    spun = {joint.child for joint in of.tree.joints if joint.name in of.spinning}
    at = {of.frames[link][0] for link in spun}
    for name, (k, _) in of.frames.items():
        inertial = of.tree.links[name].inertial
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        if k in at and inertial is not None and body > 0:
            own = of.tree.links[name].own_frame[:3, :3]
            axes = np.zeros(9)  # of the principal moments, which stay: a rod's line is one of them
            mujoco.mju_quat2Mat(axes, model.body_iquat[body])
            axes = own @ axes.reshape(3, 3)
            model.body_inertia[body] = np.diag(axes.T @ inertial.inertia @ axes)
    for j in np.flatnonzero(model.jnt_type == int(mujoco.mjtJoint.mjJNT_BALL)):
        model.dof_armature[model.jnt_dofadr[j] :][:3] = _ARMATURE


class _Ball:
    """A ball joint of MuJoCo, and the three hinges that it is in the tree.

    Its quaternion is that of R0 Rx Ry Rz R0', with R0 the hinges' frame in the link's; velocities and torques of MuJoCo
    are in the link's frame.
    """

    def __init__(self, of: MovingTree, name: str, joint: int) -> None:
        self.joint, self.hinges = joint, [x.name for x in of.tree.joints if x.ball == name]
        self.moving = {one.joint.name for one in of.moving}
        self.onto = next(x for x in of.tree.joints if x.name == f"{name} frame").placement[:3, :3].T

    @property
    def moves(self) -> bool:
        return any(name in self.moving for name in self.hinges)

    def place(self, mujoco: Any, model: Any, data: Any, states: ComparedStates, k: int) -> None:
        """Set its position, velocity and acceleration."""
        q, v, a = (
            [values[name][k] if name in self.moving else 0.0 for name in self.hinges]
            for values in (states.q, states.qd, states.qdd)
        )
        _, Ry, Rz = (_about(axis, x) for axis, x in zip(np.eye(3), q, strict=True))
        # Rates of the link's angular velocity in its own frame by those of the hinges, and the change of these rates.
        E = np.column_stack([Rz.T @ Ry.T @ [1, 0, 0], Rz.T @ [0, 1, 0], [0, 0, 1]])
        w = [v[1] * E[:, 1] + v[2] * E[:, 2], v[2] * E[:, 2]]
        drift = -v[0] * np.cross(w[0], E[:, 0]) - v[1] * np.cross(w[1], E[:, 1])
        self.rates = self.onto @ E
        dof, at = model.jnt_dofadr[self.joint], model.jnt_qposadr[self.joint]
        R = self.onto @ _about(np.eye(3)[0], q[0]) @ Ry @ Rz @ self.onto.T
        mujoco.mju_mat2Quat(data.qpos[at : at + 4], R.ravel())
        data.qvel[dof : dof + 3] = self.rates @ v
        data.qacc[dof : dof + 3] = self.rates @ a + self.onto @ drift

    def torque(self, model: Any, data: Any) -> dict[str, float]:
        """Torques of its hinges by name."""
        dof = model.jnt_dofadr[self.joint]
        torque = data.qfrc_inverse[dof : dof + 3] - _ARMATURE * data.qacc[dof : dof + 3]
        return dict(zip(self.hinges, self.rates.T @ torque, strict=True))


def _about(axis: Array, angle: float) -> Array:
    K = np.cross(np.eye(3), axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)
