"""Rows near reversals count where the sign of dry friction is known but for a moment, not where joints stick."""

from pathlib import Path

import numpy as np
import pytest

import haptid
from motions import multisine, truth

CENTRE = np.array([0.0, 0.5, 0.8])
DT, SECONDS, STEP = 1e-3, 20.0, 1e-4


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, noise, still=0.0):
    """A log with white noise of a share of the torque; joints are still below a share of their rms speed."""
    q, qd, qdd = multisine(3, SECONDS, DT, 1, 0.2)
    slow = still * np.sqrt(np.mean(qd**2, axis=1, keepdims=True))
    qdd = np.where(np.abs(qd) > slow, qdd, 0.0)
    qd = np.sign(qd) * np.maximum(np.abs(qd) - slow, 0.0)
    q = q[:, :1] + DT * np.cumsum(qd, axis=1) + CENTRE[:, None]
    tau = haptid.inverse_dynamics(model, truth(model), q, qd, qdd).T
    tau = tau + noise * tau.std(axis=0) * np.random.default_rng(1).standard_normal(tau.shape)
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"),
        time="t",
    )
    gains = [motor.gear_ratio * motor.torque_constant for motor in model.device.motors]
    position = STEP * np.round(q.T / STEP)
    return haptid.Log(Path("made"), "", DT * np.arange(q.shape[1]), position, tau / gains, channels)


def proposed(model, log):
    """The treatment, with the delay as it is."""
    return haptid.propose(model, log, torque_delay_s=0.0).treatment


def test_rows_near_reversals_count_beside_noise(phantom):
    treatment = proposed(phantom, recorded(phantom, noise=0.05))
    assert any(treatment.reversal_speed)
    assert treatment.reversal_guard_s < treatment.reach(DT) * DT


def test_a_torque_without_noise_shows_that_windows_with_a_reversal_are_wrong(phantom):
    assert proposed(phantom, recorded(phantom, noise=0.0)).reversal_guard_s is None


def test_windows_in_which_joints_stick_are_dropped(phantom):
    """As the first test, but for what dry friction does to a joint in a control loop."""
    assert proposed(phantom, recorded(phantom, noise=0.05, still=0.15)).reversal_guard_s is None
