"""Laws of the figures at the handle, on random mechanisms and shipped devices."""

import sys

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import haptid
from haptid import _core
from haptid.dynamics.inverse import bias_torque, mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import GivenParameters, apparent_mass, characterise
from haptid.end_effector.characterisation.apparent_mass import core_arguments
from haptid.end_effector.characterisation.velocity_forces import velocity_product_acceleration
from mechanisms import draw, mechanisms
from random_devices import as_device, parameters
from true_parameters import true_parameters

WORST = 1e4


def bodies(model, chi):
    """A model whose core columns are these very standard parameters."""
    return GivenParameters(model, model.base.of(chi))


@st.composite
def held(draw_from, most=8):
    """A random device with the parameters of bodies that can exist, and some poses."""
    mechanism = draw_from(mechanisms(most=most))
    model = as_device(mechanism)
    qa = np.random.default_rng(draw_from(st.integers(0, 99))).normal(size=(mechanism.coordinates, 11))
    return model, bodies(model, parameters(mechanism, model)), qa


@settings(max_examples=40, deadline=None)
@given(held())
def test_the_kernel_takes_the_road_of_python(case):
    model, identified, qa = case
    n = len(model.device.active)
    for count in (1, 7, 8, 11):
        part = np.ascontiguousarray(qa[:, :count])
        got = _core.end_effector_dynamics(*core_arguments(identified, part), list(range(6)))
        J, A = np.split(got, [6 * n], axis=1)
        wanted = handle_motion(model, part).row_jacobian
        np.testing.assert_allclose(J.reshape(-1, 6, n), wanted, atol=1e-12 * (1 + np.abs(wanted).max()))
        wanted = mass_matrix(model, identified.beta, part)
        np.testing.assert_allclose(A.reshape(-1, n, n), wanted, atol=1e-10 * (1 + np.abs(wanted).max()))


@settings(max_examples=60, deadline=None)
@given(held())
def test_masses_are_inverse_mobilities(case):
    """M = (J A^-1 J')^+, symmetric and positive definite where A is."""
    model, identified, qa = case
    A, J = mass_matrix(model, identified.beta, qa), handle_motion(model, qa).row_jacobian[:, :3]
    assume((np.linalg.eigvalsh(A)[:, 0] > 1e-6 * np.abs(A).max()).all())
    found = apparent_mass(identified, qa, worst_condition=WORST)
    r = min(3, len(model.device.active))
    s = np.linalg.svd(J, compute_uv=False)
    np.testing.assert_array_equal(found.usable[s[:, -1] == 0], False)
    clear = found.usable & (s[:, 0] < 0.9 * WORST * s[:, -1])
    mobility = J @ np.linalg.solve(A, J.mT)
    wanted = 1 / np.linalg.eigvalsh(mobility[clear])[:, ::-1][:, :r][:, ::-1]
    np.testing.assert_allclose(found.mass.values[clear], wanted, rtol=1e-5)
    assert (found.mass.values[clear] > 0).all()
    v = found.directions[clear]
    np.testing.assert_allclose(v @ v.mT, np.broadcast_to(np.eye(r), (len(v), r, r)), atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(held(), st.integers(0, 9))
def test_kinetic_energy_is_the_same_at_the_handle(case, seed):
    """1/2 xd' M xd = 1/2 qd' A qd where the handle's motion determines the joints'."""
    model, identified, qa = case
    assume(len(model.device.active) <= 3)
    found = apparent_mass(identified, qa, worst_condition=WORST)
    A, J = mass_matrix(model, identified.beta, qa), handle_motion(model, qa).row_jacobian[:, :3]
    qd = np.random.default_rng(seed).normal(size=(qa.shape[1], len(model.device.active)))
    xd = np.einsum("pij,pj->pi", J, qd)
    known = found.definite
    along = np.einsum("pei,pi->pe", found.directions, xd)
    left = (found.mass.values * along**2).sum(axis=1)[known]
    right = np.einsum("pi,pij,pj->p", qd, A, qd)[known]
    np.testing.assert_allclose(left, right, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(mechanisms(most=8))
def test_drift_is_the_change_of_the_jacobian(mechanism):
    model = as_device(mechanism)
    rng = np.random.default_rng(3)
    qa, qda = rng.normal(size=(2, mechanism.coordinates, 3))
    h = 1e-5
    ahead, behind = (handle_motion(model, qa + side * h * qda).jacobian for side in (1, -1))
    wanted = np.einsum("pij,jp->pi", (ahead - behind) / (2 * h), qda)
    scale = 1 + np.abs(wanted).max() + (np.abs(mechanism.rates).sum() * np.abs(qda).max()) ** 3
    np.testing.assert_allclose(velocity_product_acceleration(model, qa, qda), wanted, atol=1e-8 * scale)


def shipped(name="cea_medical_branch", poses=5, seed=4):
    model = haptid.DynamicModel(haptid.read_device(name))
    rng = np.random.default_rng(seed)
    middle = np.array([0.0, -0.9, 1.0 + np.pi] if name.startswith("cea") else [0.0, 0.3, 0.4])
    qa = middle[:, None] + rng.uniform(-0.4, 0.4, (3, poses))
    return model, bodies(model, true_parameters(model)), qa


@pytest.mark.parametrize("threads", ["", "0", "2"])
def test_parts_of_many_poses_are_those_together(monkeypatch, threads):
    """With any number of threads; zero is the core's default."""
    _, identified, qa = shipped("phantom_premium_15", poses=11)
    together = apparent_mass(identified, qa)
    monkeypatch.setenv("RAYON_NUM_THREADS", threads)
    monkeypatch.setattr(sys.modules[core_arguments.__module__], "_TOGETHER", 4)
    parts = apparent_mass(identified, qa)
    np.testing.assert_allclose(parts.mass.values, together.mass.values, rtol=1e-13)
    np.testing.assert_array_equal(parts.condition, together.condition)


@pytest.mark.parametrize("name", ["cea_medical_branch", "phantom_premium_15"])
def test_neglected_force_by_differences(name):
    """The torque of a motion along a straight line at constant speed, taken to the handle."""
    model, identified, qa = shipped(name)
    c, v, h = characterise(identified, qa), np.array([0.3, -0.2, 0.4]), 1e-4
    J = handle_motion(model, qa).row_jacobian[:, :3]
    qd = np.linalg.solve(J, np.broadcast_to(v, (5, 3))[..., None])[..., 0].T
    rates = []
    for side in (1, -1):
        ahead = handle_motion(model, qa + side * h * qd).row_jacobian[:, :3]
        rates.append(np.linalg.solve(ahead, np.broadcast_to(v, (5, 3))[..., None])[..., 0].T)
    qdd = (rates[0] - rates[1]) / (2 * h)
    tau = bias_torque(model, identified.beta, qa, qd) + np.einsum(
        "pij,jp->ip", mass_matrix(model, identified.beta, qa), qdd
    )
    wanted = np.linalg.solve(J.mT, tau.T[..., None])[..., 0]
    np.testing.assert_allclose(c.neglected_force_of(v).values, wanted, rtol=1e-5, atol=1e-7)
    assert (c.neglected_force(np.linalg.norm(v)).values >= 0.97 * np.linalg.norm(wanted, axis=1)).all()


@pytest.mark.parametrize("name", ["cea_medical_branch", "phantom_premium_15"])
def test_dry_friction_takes_the_power_that_joints_lose(name):
    model, identified, qa = shipped(name)
    c = characterise(identified, qa)
    J = handle_motion(model, qa).row_jacobian[:, :3]
    raw = dict(zip((t.name for t in model.terms), true_terms(model), strict=True))
    for d in np.random.default_rng(0).normal(size=(4, 3)):
        d = d / np.linalg.norm(d)
        qd = np.linalg.solve(J, np.broadcast_to(d, (5, 3))[..., None])[..., 0].T
        lost = sum(raw[t.name] * np.abs(t.weights @ qd) for t in model.terms if t.kind == "coulomb")
        np.testing.assert_allclose(c.coulomb_friction(d).values @ d, lost, rtol=1e-9)
        thick = sum(raw[t.name] * (t.weights @ qd) ** 2 for t in model.terms if t.kind == "viscous")
        np.testing.assert_allclose(c.viscous_along(d).values, thick, rtol=1e-9)
        weight = c.weight.values @ d
        np.testing.assert_allclose(c.backdrive_force(d).values, lost + weight, rtol=1e-9)


def true_terms(model):
    """Values of the terms' parameters, as core columns."""
    chi = true_parameters(model)
    return (model.device.parameters.S @ chi)[10 * len(model.device.joints) :]


def test_weight_is_the_slope_of_the_energy():
    """A force that holds the device does the work that gravity, springs and offsets ask for."""
    model, identified, qa = shipped()
    c = characterise(identified, qa)
    still = np.zeros_like(qa)
    tau = haptid.inverse_dynamics(model, identified.beta, qa, still, still)
    J = handle_motion(model, qa).row_jacobian[:, :3]
    np.testing.assert_allclose(np.einsum("pij,pi->jp", J, c.weight.values), tau, rtol=1e-9, atol=1e-12)


def test_stiffness_moves_as_joints_do():
    model, identified, qa = shipped()
    K = np.diag([100.0, 200.0, 300.0])
    values, directions = characterise(identified, qa).stiffness([100.0, 200.0, 300.0])
    J = handle_motion(model, qa).row_jacobian[:, :3]
    compliance = np.einsum("pe,pei,pej->pij", 1 / values, directions, directions)
    np.testing.assert_allclose(compliance, J @ np.linalg.inv(K) @ J.mT, rtol=1e-8, atol=1e-12)


def test_no_direction_is_weaker_than_the_weakest():
    model, identified, qa = shipped()
    c = characterise(identified, qa)
    limits = dict(zip((m.name for m in model.device.motors), (3.0, 2.5, 2.0), strict=True))
    worst, direction = c.greatest_force(limits)
    for d in np.random.default_rng(1).normal(size=(200, 3)):
        assert (c.force_along(d, limits).values >= worst.values * (1 - 1e-12)).all()
    for k in range(5):
        np.testing.assert_allclose(c.force_along(direction[k], limits).values[k], worst.values[k], rtol=1e-9)


def test_pinocchio_agrees():
    """J A^-1 J' with another library's mass matrix and Jacobian."""
    pin = pytest.importorskip("pinocchio", reason="Pinocchio (package `pin`) has no wheel for this platform")
    mechanism = draw(11, 5, closed=False, chain=True)
    model = as_device(mechanism, kinds=())
    identified = bodies(model, parameters(mechanism, model))
    qa = np.random.default_rng(0).normal(size=(5, 4))
    robot = pin.Model()
    for i, parent in enumerate(mechanism.parent):
        joint = pin.JointModelPZ() if mechanism.prismatic[i] else pin.JointModelRZ()
        k = robot.addJoint(parent + 1, joint, pin.SE3(mechanism.rotation[i], mechanism.translation[i]), f"joint{i}")
        robot.appendBodyToJoint(
            k, pin.Inertia(mechanism.mass[i], mechanism.com[i], mechanism.inertia[i]), pin.SE3.Identity()
        )
    placement = pin.SE3(model.device.handle.rotation, model.device.handle.translation)
    frame = robot.addFrame(pin.Frame("handle", 5, 0, placement, pin.FrameType.OP_FRAME))
    data = robot.createData()
    found = apparent_mass(identified, qa, worst_condition=WORST)
    for k in range(4):
        A = pin.crba(robot, data, qa[:, k])
        A = np.triu(A) + np.triu(A, 1).T
        pin.computeJointJacobians(robot, data, qa[:, k])
        pin.updateFramePlacements(robot, data)
        J = pin.getFrameJacobian(robot, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[:3]
        wanted = np.linalg.eigvalsh(np.linalg.inv(J @ np.linalg.solve(A, J.T)))[::-1]
        np.testing.assert_allclose(found.mass.values[k], wanted, rtol=1e-8)
