"""Loops that are not linear, in MuJoCo: its dynamics with the same cuts are haptid's, along motions that it makes."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment import bench
from haptid.experiment.bench import mjcf
from haptid.experiment.bench.limits import FLAT, loop_conditioning
from haptid.experiment.bench.mjcf import cut_sites, depth_first
from true_parameters import put

# Of each device: centre of the motion, its size, and the controller's springs and dampers.
MOTIONS = {
    "four_bar": ((1.57,), (0.8,), (4.0,), (0.06,)),
    "slider_crank": ((0.6,), (0.8,), (4.0,), (0.06,)),
    "five_bar": ((2.356, 0.785), (0.4, 0.4), (4.0, 4.0), (0.06, 0.06)),
    "delta": ((0.3, 0.3, 0.3), (0.35, 0.35, 0.35), (4.0, 4.0, 4.0), (0.06, 0.06, 0.06)),
}
SIZES = {"IA": 2e-5, "FV": 1e-3, "FC": 0.0}


def light(model, **sizes):
    """Free standard parameters, (p,): bars of some 10 cm and 50 g, rotors and viscous friction."""
    rng, chi = np.random.default_rng(4), np.zeros(len(model.device.parameters))
    for joint in model.device.joints:
        if joint.body:
            half = np.diag(rng.uniform(1e-5, 3e-5, 3)) + 1e-6
            J = np.trace(half) * np.eye(3) - half
            com = np.array([0.04, 0.005, 0.003]) * rng.uniform(0.5, 1.5, 3)
            put(model, chi, joint.name, rng.uniform(0.03, 0.06), com, np.diag(J), [J[0, 1], J[0, 2], J[1, 2]])
    for k, kind in enumerate(model.device.parameters.kinds):
        chi[k] = {**SIZES, **sizes}.get(kind, chi[k])
    return chi


def tree_torques(model, chi, tree, G):
    """MuJoCo's inverse dynamics of the tree, without the pins, projected on the active joints, (active, samples).

    Args:
        tree: position, velocity and acceleration of all joints, (3, joints, samples).
        G: their rates by the active ones, (samples, joints, active).
    """
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, order = mujoco.MjData(mj_model), list(depth_first(model))
    found = np.empty((len(model.device.active), len(G)))
    for k in range(len(G)):
        data.qpos[:], data.qvel[:], data.qacc[:] = tree[:, order, k]
        mujoco.mj_inverse(mj_model, data)
        found[:, k] = G[k][order].T @ data.qfrc_inverse
    return found


@pytest.mark.parametrize("name", MOTIONS)
def test_tree_dynamics_projected_are_haptids(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    chi, rng = light(model), np.random.default_rng(0)
    qa = model.device.closure.draw(rng, 40)
    qda, qdda = rng.uniform(-1, 1, (2, *qa.shape)) * np.array([5.0, 50.0])[:, None, None]
    wanted = haptid.inverse_dynamics(model, model.base.of(chi), qa, qda, qdda)
    found = tree_torques(model, chi, np.stack(model.tree(qa, qda, qdda)), model.device.closure.follow(qa).G)
    limit = 1e-5 if name == "delta" else 1e-10  # weightless links of the delta have a rotor in the simulator
    np.testing.assert_allclose(found, wanted, atol=limit * np.abs(wanted).max(), rtol=0)


def recorded(name, seconds=0.8, **settings):
    """A short multisine on the bench."""
    model = haptid.DynamicModel(haptid.read_device(name))
    centre, size, kp, kd = MOTIONS[name]
    kind = bench.Multisine(seconds, centre, size, ramp=0.3)
    setup = bench.Setup(model, light(model), bench.Controller(kp, kd), **settings)
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(1))
    return setup, bench.simulate(setup, trajectory, np.random.default_rng(2))


@pytest.mark.parametrize("name", MOTIONS)
def test_motor_torques_are_those_of_the_model_at_the_exact_states(name):
    """The pins give way by up to some 1e-3 of the torque; with those of all joints, the balance is far closer."""
    setup, found = recorded(name)
    model, active = setup.model, list(setup.model.device.active)
    q, qd, qdd = (x[:, active].T for x in (found.q, found.qd, found.qdd))
    tree = model.tree(q, qd, qdd)
    assert found.gap < 1e-8
    np.testing.assert_allclose(tree[0].T, found.q, atol=1e-7)
    np.testing.assert_allclose(tree[1].T, found.qd, atol=1e-5 * np.abs(found.qd).max())
    size = np.linalg.norm(found.torque)
    tau = haptid.inverse_dynamics(model, model.base.of(setup.chi), q, qd, qdd).T
    assert np.linalg.norm(tau - found.torque) < 2e-3 * size
    simulated = np.stack([x.T for x in (found.q, found.qd, found.qdd)])
    projected = tree_torques(model, setup.chi, simulated, model.device.closure.follow(q).G).T
    assert np.linalg.norm(projected - found.torque) < 1e-6 * size


def test_a_loop_of_a_plane_has_one_pin_and_a_loop_in_space_a_hinge():
    assert len(cut_sites(haptid.DynamicModel(haptid.read_device("five_bar")))) == 1
    assert len(cut_sites(haptid.DynamicModel(haptid.read_device("delta")))) == 4


def test_a_motion_near_a_flat_pose_is_rejected():
    """At 2.356 and 0.785 the handle is in the middle; inwards the outer bars come to lie on one line."""
    model = haptid.DynamicModel(haptid.read_device("five_bar"))
    kind = bench.Multisine(0.8, (3.012, 0.13), (0.002, 0.002), ramp=0.3)
    setup = bench.Setup(model, light(model), bench.Controller((4.0,), (0.06,)))
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(1))
    assert 1e-3 < loop_conditioning(model, model.device.closure.positions(trajectory.q.T).T).min() < 0.05
    with pytest.raises(errors.TrajectoryError) as raised:
        bench.simulate(setup, trajectory, np.random.default_rng(2))
    assert raised.value.found < raised.value.limit == FLAT


INVERTED = """
name = "a rod that slides through a block on the base"
gravity = [0, -9.81, 0]
[[joints]]
name = "crank"
[[joints]]
name = "rod"
d = 0.05
[[joints]]
name = "block"
parent = "base"
d = 0.15
[[loops]]
passive = ["rod", "block"]
guess = { rod = 0, block = 0 }
[loops.cut]
type = "prismatic"
body_a = "rod"
frame_a = { rpy = [0, "pi/2", 0] }
body_b = "block"
frame_b = { rpy = [0, "pi/2", 0] }
"""


def test_a_sliding_cut_that_is_not_linear_has_no_pin(tmp_path: Path):
    (tmp_path / "inverted.toml").write_text(INVERTED)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "inverted.toml"))
    q = model.device.closure.positions(np.array([[0.0, 0.4, 1.2]]))
    tip = 0.05 * np.array([np.cos(q[0]), np.sin(q[0])])
    np.testing.assert_allclose(np.tan(q[2]), -tip[1] / (0.15 - tip[0]), atol=1e-14)
    with pytest.raises(errors.ExportError) as raised:
        mjcf(model, light(model))
    assert raised.value.where == model.device.name
