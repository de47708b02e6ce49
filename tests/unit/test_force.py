"""The hand's wrench is recovered from its torques; undetermined components are reported; settings are checked."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid import errors
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.force import estimate_force
from haptid.observation.reversals import friction_uncertainty, smoothed_friction
from mechanisms import draw
from motions import motion, multisine, truth
from random_devices import as_device, parameters
from sampling import of_deviation

PLAIN = haptid.Treatment(cutoff_hz=None)


def estimated(model, beta, noise=0.0, seconds=4.0):
    made = motion(model, beta, seconds=seconds, noise=noise, treatment=PLAIN)
    return haptid.estimate(haptid.observe(model, made), haptid.WLS())


def pushed(estimate, wrench, seconds=0.4, seed=7, treatment=PLAIN, at=None):
    """A motion with exact rates whose motors also balance a wrench in the base frame, wrench (n, 6)."""
    model = estimate.model
    q, qd, qdd = multisine(len(model.device.active), seconds, 1e-3, seed) if at is None else at
    load = np.einsum("nij,ni->jn", handle_motion(model, q).row_jacobian, wrench)
    tau = haptid.inverse_dynamics(model, estimate.beta, q, qd, qdd) - load
    return haptid.Motion(1e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T))


@pytest.fixture(scope="module")
def phantom():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    return estimated(model, truth(model), noise=0.01)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 8))
def test_the_wrench_that_was_there_is_given_back(seed, joints):
    """Six joints or more tell all of it; with a known moment three tell the force; fewer, the part they can feel."""
    mechanism = draw(seed, joints, closed=False, chain=True)
    model = as_device(mechanism, ("rotor", "viscous", "coulomb"))
    estimate = estimated(model, model.base.of(parameters(mechanism, model)))
    wrench = np.random.default_rng(1).normal(size=(50, 6))
    made = pushed(estimate, wrench, seconds=0.05)
    handle = handle_motion(model, np.ascontiguousarray(made.q.T))
    moment = None if joints >= 6 else np.einsum("nij,ni->nj", handle.rotation, wrench[:, 3:])
    found = estimate_force(estimate, made, moment=moment, reversal_speed=0.0, worst_condition=1e5)
    kept = found.usable
    if joints >= 3:
        wanted = wrench[:, :3]
    else:
        inverse = np.linalg.pinv(handle.jacobian[:, :3].mT, rcond=1e-12)
        wanted = np.einsum("nij,nj->ni", inverse @ handle.jacobian[:, :3].mT, wrench[:, :3])
    np.testing.assert_allclose(found.force[kept], wanted[kept], atol=1e-5)
    assert found.moment == ("estimated" if joints >= 6 else "given")
    if kept.any():
        np.testing.assert_allclose(found.wrench[kept, 3:], wrench[kept, 3:], atol=1e-5)
        assert found.lever.determined.all() == (joints >= 6)


def test_signs_and_frames(phantom):
    wrench = np.zeros((400, 6))
    wrench[:, :3] = 0.5, -0.3, 0.8
    made = pushed(phantom, wrench)
    found = estimate_force(phantom, made, reversal_speed=0.0)
    np.testing.assert_allclose(found.force, wrench[:, :3], atol=1e-9)
    np.testing.assert_array_equal(found.on_hand, -found.force)
    rotation = handle_motion(phantom.model, made.q.T).rotation
    np.testing.assert_allclose(found.in_handle, np.einsum("nij,ni->nj", rotation, wrench[:, :3]), atol=1e-9)
    # Without the model, as if the device had no dynamics: motors alone balance the hand.
    J = handle_motion(phantom.model, made.q.T).row_jacobian[:, :3]
    bare = np.linalg.solve(J.mT, -made.tau[:, :, None])[:, :, 0]
    np.testing.assert_allclose(found.bare[:, :3], bare, atol=1e-9)


def test_the_published_equation_gives_the_same_force(phantom):
    """Eq. (14) of Tahmasebi et al. (2005), mended, with the Jacobian of eq. (15): the device's force on the hand."""
    wrench = np.random.default_rng(2).normal(size=(400, 6))
    made = pushed(phantom, wrench)
    rotation = handle_motion(phantom.model, made.q.T).rotation
    moment = np.einsum("nij,ni->nj", rotation, wrench[:, 3:])
    found = estimate_force(phantom, made, moment=moment, reversal_speed=0.0)
    q, qd, qdd = (np.ascontiguousarray(x.T) for x in (made.q, made.qd, made.qdd))
    residual = made.tau.T - haptid.inverse_dynamics(phantom.model, phantom.beta, q, qd, qdd)
    turn = np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]])  # from the handle's axes to the paper's
    _, q2, q3 = q
    for k in range(0, 400, 40):
        l1, l2, c23, s23 = 0.215, 0.17, np.cos(q2[k] - q3[k]), np.sin(q2[k] - q3[k])
        reach = l1 * np.cos(q2[k]) + l2 * np.sin(q3[k])
        Jp = np.array([[reach, 0, 0], [0, l1 * c23, 0], [0, -l1 * s23, l2]])
        Jo = np.array([[0, 0, -1], [np.cos(q3[k]), 0, 0], [np.sin(q3[k]), 0, 0]])
        on_hand = np.linalg.solve(Jp.T, residual[:, k] - Jo.T @ (turn @ -moment[k]))
        np.testing.assert_allclose(turn @ rotation[k].T @ found.on_hand[k], on_hand, atol=1e-9)


def test_filters_are_those_of_the_prediction(phantom):
    treatment = haptid.Treatment(cutoff_hz=None, decimation=8)
    made = pushed(phantom, np.zeros((2000, 6)), seconds=2.0, treatment=treatment)
    found, seen = estimate_force(phantom, made, reversal_speed=0.0), haptid.predict(phantom, made)
    np.testing.assert_array_equal(found.t, seen.t)
    np.testing.assert_allclose(found.external, seen.predicted - seen.measured, atol=1e-12)


def test_an_unknown_moment_is_taken_for_no_more_force_than_stated(phantom):
    wrench = np.random.default_rng(3).normal(size=(400, 6))
    found = estimate_force(phantom, pushed(phantom, wrench), reversal_speed=0.0)
    error = np.linalg.norm(found.force - wrench[:, :3], axis=1)
    assert (error <= found.lever.leak * np.linalg.norm(wrench[:, 3:], axis=1) * (1 + 1e-9)).all()
    assert error.max() > 0.3 * found.lever.leak
    assert found.moment == "taken as zero"
    assert (found.lever.sure, found.lever.determined.any()) == (1, False)
    assert np.isnan(found.se[:, 3:]).all()
    text = found.summary()
    assert "3 torques do not determine the six components" in text
    assert "1 direction of force at each pose" in text
    # Along the direction that no moment reaches, the force is right: torque of the second motor over its arm.
    handle = handle_motion(phantom.model, pushed(phantom, wrench).q.T)
    way = handle.jacobian[:, :3, 1]
    np.testing.assert_allclose((way * found.force).sum(1), (way * wrench[:, :3]).sum(1), atol=1e-9)


def test_poses_near_singular_ones_are_left_out(phantom):
    """The arm and the forearm in line: eq. (15) is singular where |theta2 - theta3| is a right angle."""
    t = np.arange(1000) * 1e-3
    q = np.array([0 * t, 1.2 * t, -0.9 * t])
    qd = np.array([0 * t, 1.2 + 0 * t, -0.9 + 0 * t])
    made = pushed(phantom, np.ones((1000, 6)) * [1, 1, 1, 0, 0, 0], at=(q, qd, 0 * q))
    found = estimate_force(phantom, made, worst_condition=20.0)
    out = ~found.usable
    assert 0 < out.sum() < 300
    J = handle_motion(phantom.model, q).jacobian[:, :3]
    np.testing.assert_allclose(found.lever.condition, np.linalg.cond(J), rtol=1e-9)
    assert np.isnan(found.force[out]).all()
    np.testing.assert_allclose(found.force[~out], 1.0, atol=1e-9)
    assert f"{out.sum()} of 1000 rows are left out" in found.summary()


def test_fewer_than_three_torques_tell_part_of_the_force():
    mechanism = draw(5, 2, closed=False, chain=True)
    model = as_device(mechanism, ("rotor",))
    found_in = estimated(model, model.base.of(parameters(mechanism, model)))
    made = pushed(found_in, np.ones((50, 6)) * [1, 1, 1, 0, 0, 0], seconds=0.05)
    text = estimate_force(found_in, made).summary()
    assert "determine the force along 2 directions of the handle's own motion" in text


def test_deviations_are_those_of_repeated_estimates():
    """Estimates from logs with other noise scatter as the interval of one of them says."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    exact = estimated(model, truth(model))
    unseen = pushed(exact, np.zeros((200, 6)), seconds=0.2)
    forces = []
    for seed in range(25):
        log = motion(model, exact.beta, seconds=6.0, seed=1, treatment=PLAIN)
        tau = log.tau + 0.1 * log.tau.std(axis=0) * np.random.default_rng(seed).standard_normal(log.tau.shape)
        log = haptid.Motion(1e-3, log.q, tau, PLAIN, rates=(log.qd, log.qdd))
        estimate = haptid.estimate(haptid.observe(model, log), haptid.WLS())
        quiet = tuple(replace(m, residual=0.0) for m in haptid.fit_errors(estimate).motors)
        validation = haptid.Validation(quiet, seen=False)
        forces.append(estimate_force(estimate, unseen, validation=validation, reversal_speed=0.0))
    scatter = np.sqrt(np.var([found.force for found in forces], axis=0).mean())
    said = np.sqrt(np.mean([found.se[:, :3] ** 2 for found in forces]))
    # Components of a force are of one fit: as many independent draws as there are fits.
    assert said == pytest.approx(scatter, rel=of_deviation(len(forces)))
    np.testing.assert_allclose(forces[0].conf_int().mean(axis=2), forces[0].force, atol=1e-12)


def test_noise_comes_from_the_validation(phantom):
    unseen = motion(phantom.model, phantom.beta, seconds=2.0, seed=3, noise=0.2, treatment=PLAIN)
    made = pushed(phantom, np.zeros((400, 6)))
    with_it = estimate_force(phantom, made, validation=haptid.validate(phantom, unseen))
    without = estimate_force(phantom, made)
    assert (with_it.se[:, :3] > 3 * without.se[:, :3]).mean() > 0.5
    assert "No validation was given" in without.summary()
    assert "No validation was given" not in with_it.summary()


def test_dry_friction_is_smoothed_and_doubted_where_a_joint_turns_back(phantom):
    model, speed = phantom.model, 0.01
    soft = smoothed_friction(model, speed)
    assert smoothed_friction(model, 0.0) is model
    assert [t.settings[0] for t in soft.terms if t.kind == "coulomb"] == [speed] * 3
    chi = np.zeros(len(model.device.parameters.raw))
    chi[model.device.parameters.raw.index("FCM2" if "FCM2" in model.device.parameters.raw else "FC2")] = 0.02
    cd = np.array([[0.0, 0.5], [0.0, 0.5], [0.0, 0.5]])
    c = np.zeros_like(cd)
    np.testing.assert_allclose(friction_uncertainty(model, chi, c, cd, speed), [[0, 0], [0.02, 0], [0, 0]], atol=1e-12)
    assert (friction_uncertainty(model, chi, c, cd, 0.0) == 0).all()


def test_settings_that_mean_nothing_are_errors(phantom):
    made = pushed(phantom, np.zeros((400, 6)))
    for setting in ({"reversal_speed": -1.0}, {"reversal_speed": np.nan}, {"worst_condition": 0.5}):
        with pytest.raises(errors.SettingError) as raised:
            estimate_force(phantom, made, **setting)
        assert raised.value.where == next(iter(setting))
    with pytest.raises(errors.ShapeError, match="moment"):
        estimate_force(phantom, made, moment=np.zeros((10, 3)))
    moment = np.zeros((400, 3))
    moment[7, 1] = np.nan
    with pytest.raises(errors.SettingError) as raised:
        estimate_force(phantom, made, moment=moment)
    assert raised.value.where == "moment[7, 1]"


def test_a_device_without_handle_has_no_force():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    estimate = estimated(model, np.array([100.0, 200.0, 20.0, 3.0]))
    with pytest.raises(errors.IncompleteDeviceError) as raised:
        estimate_force(estimate, motion(model, estimate.beta, seconds=0.5))
    assert raised.value.where == model.device.name


def test_without_a_usable_pose_nothing_is_reported_to_be_known(phantom):
    found = estimate_force(phantom, pushed(phantom, np.zeros((400, 6))), worst_condition=1.0001)
    assert not found.usable.any()
    assert found.lever.sure == 0
    assert np.isnan(found.lever.leak)
    assert "No pose is usable" in found.summary()
    assert "whatever the moment" not in found.summary()
