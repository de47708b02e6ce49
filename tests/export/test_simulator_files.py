"""MJCF and URDF: the bodies in them have the identified base parameters, and MuJoCo predicts what the model does."""

import re
import tempfile
import tomllib
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from bench_identification import CASES, device_of, log_of, record
from haptid.estimation.feasibility.conic_program import ENOUGH
from haptid.experiment import bench
from haptid.experiment.bench.mjcf import depth_first
from haptid.export import Simulator, export_mjcf, export_urdf
from haptid.export.formats.bodies import INSIDE, departure, standard_parameters_of
from haptid.export.formats.urdf import angles, upright
from haptid.observation.filtering import decimate
from haptid.observation.plan import Plan
from haptid.robot_files import import_robot
from mechanisms import mechanisms
from random_devices import as_device, parameters
from true_parameters import true_parameters

mujoco = pytest.importorskip("mujoco", reason="MuJoCo has no wheel for this platform")

SHIPPED = ["phantom_premium_15", "cea_medical_branch", "arm7", "rx90", "sr400", "staubli_tx40", "emps"]
ROUND_TRIPS = ["PHANToM, one parallelogram", "CEA branch, single and double parallelogram", "open arm, 7 joints"]


def mj_model(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    return model, model.base.of(true_parameters(model))


def loaded(export):
    return mujoco.MjModel.from_xml_path(str(export.folder / export.files[0]))


def tree_torques(built, model, q, qd, qdd):
    """MuJoCo's inverse dynamics of the tree, projected on the device's coordinates, (coordinates, samples).

    Forces of the pins do no work along the coordinates: they vanish in the projection, and are left out.
    """
    built.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    data, order = mujoco.MjData(built), list(depth_first(model))
    found = np.empty((len(model.device.active), q.shape[1]))
    for k in range(q.shape[1]):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[order, k], qd[order, k], qdd[order, k]
        mujoco.mj_inverse(built, data)
        mujoco.mj_fwdActuation(built, data)
        found[:, k] = model.device.rates[order].T @ (data.qfrc_inverse - data.qfrc_actuator)
    return found


@pytest.mark.parametrize("name", SHIPPED)
def test_mjcf_has_the_dynamics_of_the_model(tmp_path, name):
    """At random states torques are the same: so are the base parameters of the bodies, rotors and terms in it."""
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = model.base.of(true_parameters(model, FC=0.0))
    built = loaded(export_mjcf((model, beta), tmp_path))
    built.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_LIMIT
    qa, qda, qdda = np.random.default_rng(0).uniform(-1, 1, (3, len(model.device.active), 40))
    wanted = haptid.inverse_dynamics(model, beta, qa, qda, qdda)
    found = tree_torques(built, model, *model.tree(qa, qda, qdda))
    np.testing.assert_allclose(found, wanted, atol=1e-8 * np.abs(wanted).max())


def test_rotors_that_others_do_not_read_from_urdf_are_said(tmp_path):
    """Each joint's armature stands in the heading, to be set in a simulator that has none from this file."""
    model = haptid.DynamicModel(haptid.read_device("rx90"))
    beta = model.base.of(true_parameters(model, FC=0.0))
    export = export_urdf((model, beta), tmp_path)
    text = (export.folder / export.files[0]).read_text()
    said = re.search(r"set the armature of each joint there, kg m\^2 or kg\s+\(([^)]*)\)", " ".join(text.split()))
    assert said is not None
    named = dict(part.split() for part in said[1].split(", "))
    written = {
        transmission.find("joint").attrib["name"]: float(value.attrib["value"])
        for transmission in ElementTree.fromstring(text).iter("transmission")
        if (value := transmission.find("actuator/{http://drake.mit.edu}rotor_inertia")) is not None
    }
    assert written
    assert named.keys() == written.keys()
    np.testing.assert_allclose([float(named[name]) for name in written], list(written.values()), rtol=1e-5)
    assert not loaded(export).dof_armature.any()


@settings(max_examples=10, deadline=None)
@given(mechanisms(most=5, closed=False))
def test_random_mechanisms_keep_their_dynamics_in_mjcf(mechanism):
    """Trees with branches and sliding joints, rotors, viscous friction, springs and offsets."""
    model = as_device(mechanism, ("rotor", "viscous", "offset", "spring"))
    beta = model.base.of(parameters(mechanism, model))
    states = np.random.default_rng(1).uniform(-0.9, 0.9, (3, len(model.device.active), 10))
    wanted = haptid.inverse_dynamics(model, beta, *states)
    with tempfile.TemporaryDirectory() as folder:
        built = loaded(export_mjcf((model, beta), folder))
    found = tree_torques(built, model, *model.tree(*states))
    np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())


@settings(max_examples=10, deadline=None)
@given(mechanisms(most=5, closed=False))
def test_random_mechanisms_keep_their_dynamics_in_urdf(mechanism):
    model = as_device(mechanism, ("rotor",))
    beta = model.base.of(parameters(mechanism, model))
    states = np.random.default_rng(1).uniform(-0.9, 0.9, (3, len(model.device.active), 10))
    wanted = haptid.inverse_dynamics(model, beta, *states)
    with tempfile.TemporaryDirectory() as folder:
        made = export_urdf((model, beta), folder)
        path = made.folder / made.files[0]
        found = pinocchio_torque(path, model, *states, rotors(path, model))
    np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "arm7", "sr400"])
def test_damping_and_dry_friction_are_the_identified_ones(tmp_path, name):
    model, beta = mj_model(name)
    built = loaded(export_mjcf((model, beta), tmp_path))
    index = {n: k for k, n in enumerate(model.base.names)}
    named = [(joint.name, kind) for joint in model.device.joints for kind in ("FV", "FC") if kind + joint.name in index]
    for name_, kind in named:
        dof = built.joint(name_)
        value = (dof.damping if kind == "FV" else dof.frictionloss)[0]
        np.testing.assert_allclose(value, beta[index[kind + name_]], rtol=1e-9)


def joint_names(model):
    """Names in the URDF: identifiers."""
    return [f"joint_{joint.name}" if joint.name[0].isdigit() else joint.name for joint in model.device.joints]


def pinocchio_torque(path, model, qa, qda, qdda, armature):
    """Inverse dynamics of the URDF's tree, projected on the device's coordinates, (coordinates, samples)."""
    pin = pytest.importorskip("pinocchio")
    built = pin.buildModelFromUrdf(str(path))
    built.gravity.linear = np.array([0.0, 0.0, -np.linalg.norm(model.device.gravity)])
    data = built.createData()
    at = [built.joints[built.getJointId(name)] for name in joint_names(model)]
    found = np.empty_like(qa)
    q, qd, qdd = model.tree(qa, qda, qdda)
    for k in range(qa.shape[1]):
        x = pin.neutral(built)
        v, a = np.zeros(built.nv), np.zeros(built.nv)
        for j, joint in enumerate(at):
            if joint.nq == 2:  # a joint without limits is a point of the circle
                x[joint.idx_q : joint.idx_q + 2] = np.cos(q[j, k]), np.sin(q[j, k])
            else:
                x[joint.idx_q] = q[j, k]
            v[joint.idx_v], a[joint.idx_v] = qd[j, k], qdd[j, k]
        tau = pin.rnea(built, data, x, v, a)
        found[:, k] = model.device.rates.T @ ([tau[joint.idx_v] for joint in at] + armature * qdd[:, k])
    return found


def rotors(path, model):
    """Rotor inertia on each joint, as Drake reads it from the file."""
    from xml.etree import ElementTree

    made = np.zeros(len(model.device.joints))
    for element in ElementTree.parse(path).getroot().findall("transmission"):
        j = joint_names(model).index(element.find("joint").attrib["name"])
        made[j] = float(element.find("actuator/{http://drake.mit.edu}rotor_inertia").attrib["value"])
    return made


@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "arm7", "sr400", "emps"])
def test_urdf_has_the_dynamics_of_the_model(tmp_path, name):
    model = haptid.DynamicModel(haptid.read_device(name))
    chi = true_parameters(model, FV=0.0, FC=0.0, OFF=0.0)
    beta = model.base.of(chi)
    made = export_urdf((model, beta), tmp_path)
    path = made.folder / made.files[0]
    qa, qda, qdda = np.random.default_rng(0).uniform(-1, 1, (3, len(model.device.active), 30))
    wanted = haptid.inverse_dynamics(model, beta, qa, qda, qdda)
    found = pinocchio_torque(path, model, qa, qda, qdda, rotors(path, model))
    np.testing.assert_allclose(found, wanted, atol=1e-8 * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["cea_medical_branch", "sr400", "delta", "four_bar"])
def test_mjcf_starts_with_closed_loops_and_keeps_them(tmp_path, name):
    """Loops that are open at zero positions: the file begins at a pose that closes, and falls without coming apart."""
    model, beta = mj_model(name)
    made = export_mjcf((model, beta), tmp_path, Simulator(contacts=True))
    built, size = loaded(made), float(np.linalg.norm([joint.translation for joint in model.device.joints]))
    data = mujoco.MjData(built)
    apart = []
    for _ in range(200):
        mujoco.mj_step(built, data)
        apart.append(np.abs(data.efc_pos[: data.ne]).max())
    assert built.opt.timestep == 1e-3
    assert max(apart) < 1e-4 * size
    assert not built.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    assert data.ncon == 0  # its own links do not touch each other


def test_urdf_says_what_it_has_no_place_for(tmp_path):
    made = export_urdf(mj_model("phantom_premium_15"), tmp_path)
    text = (tmp_path / made.files[0]).read_text()
    assert (
        text.count("<gazebo>\n")
        == len(haptid.DynamicModel(haptid.read_device("phantom_premium_15")).device.closure.cuts)
        == 1
    )
    assert "URDF has no loops" in text
    model, beta = mj_model("cea_medical_branch")
    text = (tmp_path / export_urdf((model, beta), tmp_path).files[0]).read_text()
    assert "Not in this file: an offset" in text


NUMBERED = """
name = "Numbered"
gravity = [0, 0, -9.81]
[[joints]]
name = "1"
[[joints]]
name = "2"
alias = "joint 1"
d = 0.2
limits = { position = [-1.0, 1.0], torque = 5.0 }
[[joints]]
name = "3"
alias = "rail"
type = "prismatic"
"""


def test_urdf_has_identifiers_and_no_limit_that_nobody_knows(tmp_path):
    from xml.etree import ElementTree

    (tmp_path / "device.toml").write_text(NUMBERED)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "device.toml"))
    made = export_urdf((model, model.base.of(true_parameters(model))), tmp_path / "u")
    text = (tmp_path / "u" / made.files[0]).read_text()
    root = ElementTree.fromstring(text.partition("?>")[2])
    named = [one.attrib["name"] for one in root.iter() if "name" in one.attrib]
    assert all(re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name) for name in named), named
    joints = {one.get("name"): one for one in root.findall("joint")}
    assert list(joints) == ["base_mount", "joint_1", "joint_1_", "rail"]
    assert joints["joint_1"].find("limit") is None  # a continuous joint needs none
    assert joints["joint_1_"].find("limit").get("effort") == "5.0"
    said = "Limits that are not known, 1e+09 here because URDF requires a number: velocity of joint_1_, rail; "
    assert f"{said}effort of rail; position of rail." in " ".join(text.split())
    assert "'1' is joint_1, 'joint 1' is joint_1_" in " ".join(text.split())
    # Read again, these limits are unknown as before.
    again = tomllib.loads(import_robot(tmp_path / "u" / made.files[0]).text)["joints"]
    assert [one.get("limits", {}).get("torque") for one in again] == [None, 5.0, None]


@given(st.integers(0, 2**32 - 1))
def test_angles_are_those_of_the_rotation(seed):
    from scipy.spatial.transform import Rotation

    R = Rotation.random(random_state=seed).as_matrix()
    quarter = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    for turned_by in (R, quarter, quarter @ Rotation.from_euler("x", 0.3).as_matrix(), quarter.T):
        again = Rotation.from_euler("xyz", angles(turned_by)).as_matrix()
        np.testing.assert_allclose(again, turned_by, atol=1e-9)


@settings(max_examples=20)
@given(st.tuples(*[st.floats(-20, 20)] * 3))
def test_things_fall_down_in_the_world(gravity):
    g = np.array(gravity)
    R = upright(g)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-7)
    np.testing.assert_allclose(R @ g, [0, 0, -np.linalg.norm(g)], atol=1e-6)


def test_an_estimate_on_the_border_is_brought_inside(tmp_path):
    """Held estimates have bodies without thickness; a simulator takes them all the same."""
    model, beta = mj_model("arm3")
    wrong = np.array(beta)
    wrong[model.base.names.index("ZZ3R" if "ZZ3R" in model.base.names else "ZZ3")] *= -0.01
    held = haptid.estimation.project_to_feasible(model, wrong, np.eye(len(beta)))
    chi = standard_parameters_of(model, held.beta)
    # Each body is moved inside by INSIDE and by what the solver leaves outside; a base parameter groups several bodies.
    assert departure(model, held.beta, chi) < len(model.device.joints) * (INSIDE + ENOUGH)
    assert loaded(export_mjcf((model, held.beta), tmp_path)).nv == 3


def simulated_torque(built, model, plan):
    """The same of the treated rows, decimated as the measured one, (coordinates, rows)."""
    c, cd, cdd, _ = plan.signals(*plan.window(0, plan.rows))
    to_joints = np.linalg.inv(model.device.row_map)
    torque = tree_torques(built, model, *model.tree(*(to_joints @ x for x in (c, cd, cdd))))
    return decimate(torque, plan.filter.taps, plan.motion.treatment.decimation)


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_mujoco_predicts_the_unseen_log_as_the_model_does(tmp_path, name):
    case = CASES[name]
    model = device_of(case)
    made = [(seed, record(case, seed, 4000, seconds, bench.Physics(5e-4))) for seed, seconds in ((1, 12.0), (2, 6.0))]
    logs = [replace(log_of(case, recording), sha256=str(seed)) for seed, recording in made]
    treatment = haptid.propose(model, logs[0]).treatment
    fit, unseen = (haptid.treat(log, treatment) for log in logs)
    estimate = haptid.estimate(haptid.observe(model, fit), haptid.PhysicallyConsistent())
    validation = haptid.validate(estimate, unseen)
    built = loaded(export_mjcf(estimate, tmp_path, validation=validation))
    prediction = haptid.predict(estimate, unseen)
    torque = simulated_torque(built, model, Plan.of(model, unseen))[list(model.device.measured)]
    wanted = np.where(prediction.used, prediction.measured, 0.0)
    missed = np.where(prediction.used, torque - prediction.measured, 0.0)
    relative = 100 * np.linalg.norm(missed, axis=1) / np.linalg.norm(wanted, axis=1)
    for found, motor in zip(relative, validation.motors, strict=True):
        assert abs(found - motor.relative) < 0.1, motor.motor
