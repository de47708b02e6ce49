"""The device in MuJoCo is the device: its dynamics, without the pins and projected, are haptid's own."""

import mujoco
import numpy as np
import pytest

import haptid
from haptid import errors
from haptid.experiment.bench import Physics, SimulatedPayload, mjcf
from haptid.experiment.bench.mjcf import closed, cut_sites, depth_first
from true_parameters import drawn, put, true_parameters

DEVICES = ["phantom_premium_15", "cea_medical_branch", "arm7", "rx90", "sr400", "staubli_tx40"]


def tree_torques(model, chi, qa, qda, qdda):
    """MuJoCo's inverse dynamics of the tree, projected on the device's coordinates, (coordinates, samples)."""
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, chi))
    mj_model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    data, order = mujoco.MjData(mj_model), list(depth_first(model))
    found = np.empty_like(qa)
    for k in range(qa.shape[1]):
        data.qpos[:] = closed(model, qa[:, k])
        data.qvel[:], data.qacc[:] = (
            model.device.closure.G[order] @ qda[:, k],
            model.device.closure.G[order] @ qdda[:, k],
        )
        mujoco.mj_inverse(mj_model, data)
        mujoco.mj_fwdActuation(mj_model, data)
        found[:, k] = model.device.rates[order].T @ (data.qfrc_inverse - data.qfrc_actuator)
    return found


@pytest.mark.parametrize("name", DEVICES)
def test_tree_dynamics_projected_are_haptids(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    chi = true_parameters(model, FC=0.0)
    rng = np.random.default_rng(0)
    qa, qda, qdda = rng.uniform(-1, 1, (3, len(model.device.active), 40)) * np.array([1.5, 3.0, 20.0])[:, None, None]
    wanted = haptid.inverse_dynamics(model, model.base.of(chi), qa, qda, qdda)
    found = tree_torques(model, chi, qa, qda, qdda)
    np.testing.assert_allclose(found, wanted, atol=1e-12 * np.abs(wanted).max(), rtol=0)


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch"])
def test_cut_sites_meet_where_the_relations_state(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, true_parameters(model)))
    data = mujoco.MjData(mj_model)
    for qa in np.random.default_rng(1).uniform(-2, 2, (20, len(model.device.active))):
        data.qpos[:] = closed(model, qa)
        mujoco.mj_kinematics(mj_model, data)
        for one, other in cut_sites(model):
            assert np.linalg.norm(data.site(one).xpos - data.site(other).xpos) < 1e-14


def test_inertia_that_no_body_has_is_moved_to_the_rotor():
    """The published arm and lever break the triangle inequality: their motors' inertia is in them."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    mj_model = mujoco.MjModel.from_xml_string(mjcf(model, true_parameters(model)))
    order = [model.device.joints[j].name for j in depth_first(model)]
    armature = dict(zip(order, mj_model.dof_armature, strict=True))
    assert armature["ba"] == 11.87e-4
    assert 0.4e-4 < armature["be"] < 1.4e-4
    assert armature["df"] > 0
    assert armature["a"] == armature["c"] == 0


RELATED = """
schema = 1
name = "a forearm held parallel by a relation"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[joints]]
name = "2"
d = 0.3
[[joints]]
name = "3"
d = 0.2
[[loops]]
relations = ["q2 = 0.4 - q1"]
[[motors]]
name = "1"
drives = { 1 = 1 }
[[motors]]
name = "2"
drives = { 1 = -1, 3 = 2 }
[[terms]]
kind = "viscous"
motors = "all"
[[terms]]
kind = "rotor-inertia"
motors = "all"
[[terms]]
kind = "spring"
joints = ["2"]
rest = 0.3
[[terms]]
kind = "offset"
motors = "all"
[handle]
link = "3"
xyz = [0.1, 0, 0]
"""


def test_relations_coupled_motors_springs_and_offsets_keep_the_dynamics(tmp_path):
    path = tmp_path / "related.toml"
    path.write_text(RELATED)
    model = haptid.DynamicModel(haptid.read_device(path))
    rng = np.random.default_rng(1)
    chi = rng.uniform(0.1, 1.0, len(model.device.parameters))
    for joint in model.device.joints:
        put(model, chi, joint.name, *drawn(rng))
    qa, qda, qdda = rng.uniform(-1, 1, (3, 2, 40))
    wanted = haptid.inverse_dynamics(model, model.base.of(chi), qa, qda, qdda)
    np.testing.assert_allclose(tree_torques(model, chi, qa, qda, qdda), wanted, atol=1e-12 * np.abs(wanted).max())


def test_payload_is_a_mass_at_the_handle():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    chi, step = true_parameters(model), Physics(step=2e-4)
    bare = mujoco.MjModel.from_xml_string(mjcf(model, chi, step))
    laden = mujoco.MjModel.from_xml_string(mjcf(model, chi, step, SimulatedPayload(0.1, (0.01, 0.0, 0.0))))
    assert laden.body_mass.sum() - bare.body_mass.sum() == pytest.approx(0.1, rel=1e-12)
    assert laden.opt.timestep == 2e-4


@pytest.mark.parametrize(
    ("changes", "error", "part"),
    [
        ({"YYa": 1e-2}, errors.PhysicalConsistencyError, "link a"),
        ({"Ma": 0.0}, errors.PhysicalConsistencyError, "mass is 0 kg"),
        ({"Ma": 0.0, "MXa": 0.0, "XXa": 0.0, "YYa": 0.0, "ZZa": 0.0}, errors.PhysicalConsistencyError, "link a"),
    ],
)
def test_what_no_body_can_be_is_rejected(changes, error, part):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    chi = true_parameters(model)
    for name, value in changes.items():
        chi[model.device.parameters.index[name]] = value
    with pytest.raises(error, match=part):
        mjcf(model, chi)


def test_terms_without_counterpart_and_payload_without_handle_are_rejected(tmp_path):
    model = haptid.DynamicModel(haptid.read_device("kuka_kr300"))
    chi = true_parameters(model, FC=0.0)
    external = next(term.name for term in model.terms if term.kind == "external")
    chi[model.device.parameters.index[external]] = 5.0
    with pytest.raises(errors.ExportError) as raised:
        mjcf(model, chi)
    assert raised.value.where == external
    path = tmp_path / "related.toml"
    path.write_text(RELATED.partition("[handle]")[0])
    bare = haptid.DynamicModel(haptid.read_device(path))
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        mjcf(bare, np.ones(len(bare.device.parameters)), payload=SimulatedPayload(0.1))
    assert raised.value.where == "payload"
