"""Deltas with rods between ball joints: torques as by MuJoCo, whichever spin of the rods is held."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import haptid
from deltas import delta_device, delta_mjcf
from haptid.estimation import feasible_parameters
from haptid.robot_files import ImportedRobot, import_robot

mujoco = pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def delta(tmp_path_factory: pytest.TempPathFactory) -> tuple[ImportedRobot, Path]:
    path = tmp_path_factory.mktemp("delta") / "delta.xml"
    path.write_text(delta_mjcf())
    return import_robot(path, ask=True), path


def test_a_delta_with_ball_rods_is_imported(delta: tuple[ImportedRobot, Path]) -> None:
    """Six rods of two hinges each, a platform of three; six spins are held, and nothing is approximate."""
    robot, _ = delta
    assert [robot.device.joints[k].name for k in robot.device.active] == ["arm0", "arm1", "arm2"]
    assert len(robot.device.joints) == 3 + 6 * 2 + 3
    assert robot.is_exact
    assert robot.check.torque < 1e-10
    assert robot.check.others["mujoco"] < 1e-10
    assert robot.check.gap < 1e-12


def test_torques_are_those_of_rods_that_spin(delta: tuple[ImportedRobot, Path]) -> None:
    """With all moments of inertia of the rods, and accelerations about their lines such that no torque acts there.

    Source: d'Alembert, G'(M a + c) = tau of the motors and N'(M a + c) = 0 of the spins, by MuJoCo's M and c.
    """
    robot, path = delta
    device = robot.device
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    haptid_model = haptid.DynamicModel(device)
    rng = np.random.default_rng(3)
    qa = rng.uniform(-0.3, 0.3, (3, 5))
    qda, qdda = rng.uniform(-1, 1, (2, 3, 5))
    tau = haptid.inverse_dynamics(haptid_model, haptid_model.base.of(np.nan_to_num(device.chi_prior)), qa, qda, qdda)
    for k in range(5):
        found = _with_spins(model, data, qa[:, k], qda[:, k], qdda[:, k])
        np.testing.assert_allclose(found, tau[:, k], atol=1e-9 * np.abs(tau).max())


def _with_spins(model, data, qa, qda, qdda):
    """Torques of the arms, from MuJoCo's tree, constraints closed by Newton's method, spins at rest about the lines."""
    arms = [model.joint(f"arm{k}").dofadr[0] for k in range(3)]
    others = [k for k in range(model.nv) if k not in arms]
    mujoco.mj_resetData(model, data)
    for k in range(3):
        data.qpos[model.joint(f"arm{k}").qposadr[0]] = qa[k]
    for _ in range(20):
        gap, J = _gap(model, data)
        step = np.zeros(model.nv)
        step[others] = -np.linalg.pinv(J[:, others], rcond=1e-9) @ gap
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    gap, J = _gap(model, data)
    assert np.abs(gap).max() < 1e-13
    # Spins: about the lines of the rods, in the rods' frames z, opposed by the platform's ball joint on its rod.
    spins = np.zeros((model.nv, 6))
    rods = [f"ball{k}{side}" for k in range(3) for side in (-1, 1)]
    for i, name in enumerate(rods):
        spins[model.joint(name).dofadr[0] + 2, i] = 1.0
    platform = model.joint("platform ball").dofadr[0]
    turn = data.body("platform").xmat.reshape(3, 3).T @ data.body("rod0-1").xmat.reshape(3, 3)
    spins[platform : platform + 3, 0] = -turn[:, 2]
    assert np.abs(J @ spins).max() < 1e-12
    closed = np.vstack([J[:, others], spins[others].T])

    def rates(rhs):
        return np.linalg.lstsq(closed, rhs, rcond=1e-12)[0]

    G = np.zeros((model.nv, 3))
    for i, arm in enumerate(arms):
        G[arm, i] = 1.0
        G[others, i] = rates(np.concatenate([-J[:, arm], np.zeros(6)]))
    # No rod has an angular velocity about its line: the third component in its own frame. Arms turn rods, too.
    velocity = G @ qda
    for i, name in enumerate(rods):
        w = _angular(model, data, velocity, name)
        velocity -= spins[:, i] * w
    data.qvel[:] = velocity
    h = 1e-6  # by differences: the rate of the gap along the motion
    start = data.qpos.copy()
    ends = []
    for sign in (1, -1):
        data.qpos[:] = start
        mujoco.mj_integratePos(model, data.qpos, velocity, sign * h)
        ends.append(_gap(model, data)[1] @ velocity)
    drift = (ends[0] - ends[1]) / (2 * h)
    data.qpos[:] = start
    acceleration = np.zeros(model.nv)
    acceleration[arms] = qdda
    acceleration[others] = rates(np.concatenate([-J[:, arms] @ qdda - drift, np.zeros(6)]))
    data.qvel[:] = velocity
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    bias = data.qfrc_bias.copy()
    free = spins.T @ (M @ acceleration + bias)
    acceleration -= spins @ np.linalg.solve(spins.T @ M @ spins, free)
    return G.T @ (M @ acceleration + bias)


def _gap(model, data):
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    gaps, rows = [], []
    for e in range(model.neq):
        jacobians = []
        for side, column in ((0, model.eq_obj1id[e]), (1, model.eq_obj2id[e])):
            point = model.eq_data[e, 3 * side : 3 * side + 3]
            world = data.xpos[column] + data.xmat[column].reshape(3, 3) @ point
            J = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, J, None, world, column)
            jacobians.append((world, J))
        gaps.append(jacobians[1][0] - jacobians[0][0])
        rows.append(jacobians[1][1] - jacobians[0][1])
    return np.concatenate(gaps), np.concatenate(rows)


def _angular(model, data, velocity, ball: str) -> float:
    """Angular velocity of a rod about its line."""
    body = model.joint(ball).bodyid[0]
    J = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, None, J, data.xpos[body], body)
    return float(data.xmat[body].reshape(3, 3)[:, 2] @ J @ velocity)


def test_torques_and_base_parameters_do_not_depend_on_the_gauge(
    delta: tuple[ImportedRobot, Path], tmp_path: Path
) -> None:
    """A device file with universal joints, their first axes turned about the rods; and the imported one."""
    robot, _ = delta
    devices = [robot.device]
    for spin in (0.0, 0.7):
        path = tmp_path / "delta.toml"
        path.write_text(delta_device(spin))
        devices.append(haptid.read_device(path))
    rng = np.random.default_rng(4)
    qa = rng.uniform(-0.3, 0.3, (3, 6))
    qda, qdda = rng.uniform(-1, 1, (2, 3, 6))
    found, ranks = [], []
    for device in devices:
        model = haptid.DynamicModel(device)
        friction = [name.startswith(("FV", "FC")) for name in device.parameters.names]
        without_friction = np.where(friction, 0.0, device.chi_prior)
        found.append(haptid.inverse_dynamics(model, model.base.of(without_friction), qa, qda, qdda))
        ranks.append(sum(not name.startswith(("FV", "FC")) for name in model.base.names))
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-9 * np.abs(found[0]).max())
    assert len(set(ranks)) == 1


def test_rods_without_a_moment_about_their_line_are_bodies(delta: tuple[ImportedRobot, Path]) -> None:
    """Their pseudo-inertia has no extent across the line; physical consistency asks for the rest of it."""
    model = haptid.DynamicModel(delta[0].device)
    friction = [name.startswith(("FV", "FC")) for name in delta[0].device.parameters.names]
    chi = np.where(friction, 0.01, np.nan_to_num(delta[0].device.chi_prior))
    beta = model.base.of(chi)
    found = feasible_parameters(model, beta)
    assert found.ok
    np.testing.assert_allclose(model.base.of(found.chi), beta, rtol=1e-6, atol=1e-9 * np.abs(beta).max())
    wrong = beta.copy()
    wrong[[k for k, name in enumerate(model.base.names) if name.startswith("ZZ")]] *= -1
    assert not feasible_parameters(model, wrong).ok
