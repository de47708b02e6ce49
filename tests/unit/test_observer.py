"""The momentum observer follows the hand's torque through gain / (s + gain), sample by sample, on any mechanism."""

import numpy as np
import pytest
from hypothesis import given, settings

import haptid
from haptid import errors
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.force import estimate_force
from haptid.end_effector.momentum_observer import MomentumObserver, observe_force
from haptid.motion.filters import HighPass
from mechanisms import mechanisms
from motions import motion, multisine, truth
from random_devices import as_device, parameters

PLAIN = haptid.Treatment(cutoff_hz=None)
FREQUENCIES = 2 * np.pi * np.array([0.5, 2.0, 5.0])


def pushed(model, beta, dt, seconds=1.0):
    """States, the motors' torque on the rows, and the hand's torque on them, each (rows, samples): sines of 1 N m."""
    q, qd, qdd = multisine(len(model.device.active), seconds, dt, 4)
    t = dt * np.arange(q.shape[1])
    hand = np.array([np.sin(FREQUENCIES * time).sum() for time in t]) * np.linspace(1, 2, len(q))[:, None]
    return q, qd, haptid.inverse_dynamics(model, beta, q, qd, qdd) - hand, hand


def followed(gain, dt, samples):
    """gain / (s + gain) of those sines from rest, in closed form, (samples,)."""
    t = dt * np.arange(samples)[:, None]
    wave = gain * np.sin(FREQUENCIES * t) - FREQUENCIES * np.cos(FREQUENCIES * t) + FREQUENCIES * np.exp(-gain * t)
    return (gain * wave / (gain**2 + FREQUENCIES**2)).sum(axis=1)


@settings(max_examples=20, deadline=None)
@given(mechanisms(most=5))
def test_residual_is_the_low_pass_of_the_hands_torque(mechanism):
    """With an error of the order of the step squared, on exact states of trees and closed chains."""
    model = as_device(mechanism, ("rotor", "viscous", "spring"))
    beta, gain, off = model.base.of(parameters(mechanism, model)), 30.0, []
    for dt in (2e-3, 1e-3):
        q, qd, tau, hand = pushed(model, beta, dt, seconds=0.5)
        seen = MomentumObserver(gain, 0.0).follow(model, beta, dt, q, qd, tau).torque
        wanted = followed(gain, dt, q.shape[1]) * np.linspace(1, 2, len(q))[:, None]
        off.append(np.abs(seen - wanted).max())
        size = np.abs(tau).max() + np.abs(hand).max()
    assert off[1] < 1e-3 * size
    assert off[1] < 0.3 * off[0] + 1e-9 * size


def test_a_steady_push_is_seen_in_full_and_late_by_the_delay():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta, observer = truth(model), MomentumObserver(25.0, 0.0)
    q = np.repeat([[0.1], [0.3], [0.4]], 1000, axis=1)
    hold = haptid.inverse_dynamics(model, beta, q, 0 * q, 0 * q)
    step = observer.follow(model, beta, 1e-3, q, 0 * q, hold - 0.2).torque
    np.testing.assert_allclose(step[:, -1], 0.2, rtol=1e-8)
    np.testing.assert_allclose(step[:, round(1000 * observer.delay)], 0.2 * (1 - np.exp(-1)), rtol=1e-9)
    ramp = observer.follow(model, beta, 1e-3, q, 0 * q, hold - np.arange(1000) * 1e-3).torque
    # Late by the delay and, for the mean over a step, by less than one sample more.
    late = 0.999 - ramp[:, -1]
    np.testing.assert_allclose(late, observer.delay, atol=1e-3)
    assert observer.bandwidth_hz == pytest.approx(25.0 / (2 * np.pi))
    omega = observer.gain
    wave = np.sin(omega * 1e-4 * np.arange(20000))
    smooth = observer.smooth(wave[None], 1e-4)[0, 10000:]
    assert np.sqrt(2 * np.mean(smooth**2)) == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_samples_may_come_one_by_one(monkeypatch):
    model = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    beta, observer = truth(model), MomentumObserver()
    q, qd, tau, _ = pushed(model, beta, 1e-3, seconds=0.2)
    whole = observer.follow(model, beta, 1e-3, q, qd, tau)
    monkeypatch.setattr("haptid.end_effector.momentum_observer._CHUNK", 64)
    pieces, before = [], None
    for low, high in ((0, 1), (1, 2), (2, 50), (50, 51), (51, 200)):
        before = observer.follow(model, beta, 1e-3, *(x[:, low:high] for x in (q, qd, tau)), before)
        pieces.append(before.torque)
    np.testing.assert_allclose(np.concatenate(pieces, axis=1), whole.torque, atol=1e-12)
    np.testing.assert_allclose(before.p, whole.p, atol=1e-15)


def test_along_a_motion_it_is_the_force_estimate_through_the_low_pass():
    """Without doubt about friction or filters, both see the same hand; the observer as late as its gain says."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    estimate = haptid.estimate(
        haptid.observe(model, motion(model, truth(model), noise=0.01, treatment=PLAIN)), haptid.WLS()
    )
    q, qd, qdd = multisine(3, 2.0, 1e-3, 9)
    force = np.array([np.sin(9 * np.arange(2000) * 1e-3), 0.5 + 0 * q[0], -0.3 + 0 * q[0]]).T
    load = np.einsum("nij,ni->jn", handle_motion(model, q).row_jacobian[:, :3], force)
    tau = haptid.inverse_dynamics(model, estimate.beta, q, qd, qdd) - load
    made = haptid.Motion(1e-3, q.T, tau.T, PLAIN, rates=(qd.T, qdd.T))
    observer = MomentumObserver(100.0, 0.0)
    now, late = estimate_force(estimate, made, reversal_speed=0.0), observe_force(estimate, made, observer)
    settled = slice(200, None)
    np.testing.assert_allclose(now.force[settled], force[settled], atol=1e-8)
    means = 0.5 * (force + np.roll(force, 1, axis=0))  # over each step
    wanted = observer.smooth(means.T, 1e-3).T
    np.testing.assert_allclose(late.force[settled], wanted[settled], atol=1e-4)
    np.testing.assert_array_equal(late.t, now.t)
    assert (late.se[settled, :3] <= 1.1 * now.se[settled, :3]).mean() > 0.5
    assert late.moment == "taken as zero"


def test_what_a_singular_pose_left_is_waited_for():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    estimate = haptid.estimate(
        haptid.observe(model, motion(model, truth(model), noise=0.01, treatment=PLAIN)), haptid.WLS()
    )
    t = np.arange(2000) * 1e-3
    turn = np.radians(100) * np.sin(np.pi * t)  # theta2 - theta3 passes a right angle and comes back
    rate, second = (np.radians(100) * np.pi**k * wave for k, wave in ((1, np.cos(np.pi * t)), (2, -np.sin(np.pi * t))))
    q, qd, qdd = (np.array([0 * t, 0.5 * x, -0.5 * x]) for x in (turn, rate, second))
    force = np.array([0.4, -0.2, 0.3])
    load = np.einsum("nij,i->jn", handle_motion(model, q).row_jacobian[:, :3], force)
    tau = haptid.inverse_dynamics(model, estimate.beta, q, qd, qdd) - load
    made = haptid.Motion(1e-3, q.T, tau.T, PLAIN, rates=(qd.T, qdd.T))
    observer = MomentumObserver(40.0, 0.0)
    seen = observe_force(estimate, made, observer)
    near = ~seen.lever.usable
    assert near.sum() > 100
    assert (~seen.usable).sum() > near.sum() + 4 * observer.delay / 1e-3
    assert np.isnan(seen.force[~seen.usable]).all()
    settled = seen.usable & (seen.t > 0.3)
    np.testing.assert_allclose(seen.force[settled], force + 0 * seen.force[settled], atol=0.01)


def test_settings_that_mean_nothing_are_errors():
    for gain in (0.0, -1.0, np.inf):
        with pytest.raises(errors.SettingError) as raised:
            MomentumObserver(gain)
        assert raised.value.where == "gain"
    with pytest.raises(errors.SettingError) as raised:
        MomentumObserver(10.0, -1.0)
    assert raised.value.where == "reversal_speed"
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    still = np.zeros((3, 4))
    with pytest.raises(errors.SettingError) as raised:
        MomentumObserver().follow(model, truth(model), 0.0, still, still, still)
    assert raised.value.where == "dt"
    with pytest.raises(errors.SettingError) as raised:
        MomentumObserver().follow(model, truth(model), 1e-3, still[:, :0], still[:, :0], still[:, :0])
    assert raised.value.where == "number of samples"
    with pytest.raises(errors.ShapeError, match="tau"):
        MomentumObserver().follow(model, truth(model), 1e-3, still, still, np.zeros((2, 4)))


def test_a_device_without_handle_has_no_force():
    model = haptid.DynamicModel(haptid.read_device("emps"))
    made = motion(model, np.array([100.0, 200.0, 20.0, 3.0]), seconds=4.0, noise=0.01, treatment=PLAIN)
    estimate = haptid.estimate(haptid.observe(model, made), haptid.WLS())
    with pytest.raises(errors.IncompleteDeviceError):
        observe_force(estimate, made)


JERKY = """
schema = 1
name = "a pendulum with a column of its own"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
[[terms]]
kind = "custom"
name = "JERKY"
unit = "N m"
joints = ["1"]
expression = "abs(a_1)"
"""


def test_a_column_made_of_accelerations_is_rejected(tmp_path):
    (tmp_path / "jerky.toml").write_text(JERKY)
    model = haptid.DynamicModel(haptid.read_device(tmp_path / "jerky.toml"))
    some = np.ones((1, 4))
    with pytest.raises(errors.MissingAccelerationError) as raised:
        MomentumObserver().follow(model, np.ones(len(model.base)), 1e-3, some, some, some)
    assert raised.value.where == "JERKY"


def test_velocity_may_come_from_a_causal_differentiator():
    """Then there are no accelerations, and the observer needs none."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    estimate = haptid.estimate(
        haptid.observe(model, motion(model, truth(model), noise=0.01, treatment=PLAIN)), haptid.WLS()
    )
    q, qd, qdd = multisine(3, 2.0, 1e-3, 9)
    force = np.array([0.4, -0.2, 0.3])
    load = np.einsum("nij,i->jn", handle_motion(model, q).row_jacobian[:, :3], force)
    tau = haptid.inverse_dynamics(model, estimate.beta, q, qd, qdd) - load
    causal = haptid.Treatment(cutoff_hz=None, velocity=HighPass(400.0), formulation="momentum")
    seen = observe_force(estimate, haptid.Motion(1e-3, q.T, tau.T, causal))
    settled = seen.t > 0.5
    np.testing.assert_allclose(seen.force[settled], force + 0 * seen.force[settled], atol=0.05)


def test_what_is_no_number_is_an_error():
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    still, beta = np.zeros((3, 4)), truth(model)
    bad = still.copy()
    bad[1, 2] = np.nan
    for k, name in enumerate(("qa", "qda", "tau")):
        given = [bad if k == j else still for j in range(3)]
        with pytest.raises(errors.SettingError) as raised:
            MomentumObserver().follow(model, beta, 1e-3, *given)
        assert raised.value.where == f"{name}[1, 2]"
    with pytest.raises(errors.SettingError):
        MomentumObserver().follow(model, np.full_like(beta, np.nan), 1e-3, still, still, still)
