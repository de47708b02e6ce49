"""Rows near reversals count where the sign of dry friction is known but for a moment, not where joints stick."""

from pathlib import Path

import numpy as np
import pytest

import haptid
from haptid.motion.motion import treat
from haptid.treatment_choice import parallel_choice
from haptid.treatment_choice.motion_filters import SLOW, USUAL, MotionFilters
from motions import multisine, truth

CENTRE = np.array([0.0, 0.5, 0.8])
DT, SECONDS, STEP = 1e-3, 20.0, 1e-4


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, noise, still=0.0, speed=1.0, dwells=0, dead=()):
    """A log with white noise of a share of the torque; joints are still below a share of their rms speed.

    Args:
        speed: on the same path, beside that of the others.
        dwells: how many times all joints slow down and rest for a second.
        dead: channels of torque with noise alone.
    """
    q, qd, qdd = multisine(3, SECONDS, speed * DT, 1, 0.2)
    qd, qdd = speed * qd, speed**2 * qdd
    if dwells:
        qd *= moving(q.shape[1], dwells)
        qdd = np.gradient(qd, DT, axis=1)
    slow = still * np.sqrt(np.mean(qd**2, axis=1, keepdims=True))
    qdd = np.where(np.abs(qd) > slow, qdd, 0.0)
    qd = np.sign(qd) * np.maximum(np.abs(qd) - slow, 0.0)
    q = q[:, :1] + DT * np.cumsum(qd, axis=1) + CENTRE[:, None]
    tau = haptid.inverse_dynamics(model, truth(model), q, qd, qdd).T
    noises = noise * tau.std(axis=0) * np.random.default_rng(1).standard_normal(tau.shape)
    tau[:, dead] = 20 * noises[:, dead]  # of all torques' size
    tau = tau + noises
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"),
        time="t",
    )
    gains = [motor.gear_ratio * motor.torque_constant for motor in model.device.motors]
    position = STEP * np.round(q.T / STEP)
    return haptid.Log(Path("made"), f"speed {speed}", DT * np.arange(q.shape[1]), position, tau / gains, channels)


def moving(samples, dwells):
    """Share of the speed: 1, but for dwells of a second, with half a second before and after in which it changes."""
    made, whole, change = np.ones(samples), round(2 / DT), round(0.5 / DT)
    pause = np.zeros(whole)
    pause[:change] = 0.5 + 0.5 * np.cos(np.pi * np.arange(change) / change)
    pause[-change:] = pause[change - 1 :: -1]
    for start in np.linspace(0, samples - whole, dwells + 2)[1:-1].astype(int):
        made[start : start + whole] = pause
    return made


def proposed(model, *logs):
    """The treatment, with the delay as it is."""
    return haptid.propose(model, *logs, torque_delay_s=0.0).treatment


def sticks(model, *logs):
    """Whether rows near reversals are dropped before unseen rows are asked."""
    return not MotionFilters.of(model, logs, {}).near


def test_rows_near_reversals_count_beside_noise(phantom):
    treatment = proposed(phantom, recorded(phantom, noise=0.05))
    assert any(treatment.reversal_speed)
    assert treatment.reversal_guard_s < treatment.reach(DT) * DT


def test_a_torque_without_noise_shows_that_windows_with_a_reversal_are_wrong(phantom):
    assert proposed(phantom, recorded(phantom, noise=0.0)).reversal_guard_s is None


def test_windows_in_which_joints_stick_are_dropped(phantom):
    """As the first test, but for what dry friction does to a joint in a control loop."""
    assert proposed(phantom, recorded(phantom, noise=0.05, still=0.15)).reversal_guard_s is None


def test_two_logs_of_different_speed_stick_no_more_than_each(phantom):
    fast, slow = recorded(phantom, noise=0.05), recorded(phantom, noise=0.05, speed=0.15)
    assert not any(sticks(phantom, *logs) for logs in ((fast,), (slow,), (fast, slow)))
    assert proposed(phantom, fast, slow).reversal_guard_s is not None


def test_a_slow_log_that_sticks_is_seen_beside_a_fast_one_that_does_not(phantom):
    fast, slow = recorded(phantom, noise=0.05), recorded(phantom, noise=0.05, speed=0.5, still=0.3)
    assert sticks(phantom, fast, slow)


def test_joints_that_rest_do_not_stick(phantom):
    assert not sticks(phantom, recorded(phantom, noise=0.05, dwells=4))


def test_the_reversal_speed_is_of_all_samples_of_all_logs(phantom):
    logs = recorded(phantom, noise=0.05, dwells=4), recorded(phantom, noise=0.05, speed=0.5)
    filters = MotionFilters.of(phantom, logs, {})
    motions = [treat(log, filters.at(USUAL, {"reversal_speed": 0.0})) for log in logs]
    qd = np.concatenate([motion.state(*motion.usable)[1] for motion in motions], axis=1)
    rms = np.sqrt(np.mean(qd**2, axis=1))
    assert filters.reversal_speed == tuple(float(f"{SLOW * v:.2g}") for v in rms)


def test_a_joint_sticks_only_where_its_torque_is_recorded(phantom):
    """The second one does; rows of a channel that is noise alone are not used."""
    still = np.array([[0.0], [0.15], [0.0]])
    assert sticks(phantom, recorded(phantom, noise=0.05, still=still))
    assert not sticks(phantom, recorded(phantom, noise=0.05, still=still, dead=[1]))


@pytest.mark.parametrize(("surely", "chosen"), [(1.0, 1), (2.0, 0)])
def test_unseen_rows_are_better_by_so_many_standard_deviations(monkeypatch, phantom, surely, chosen):
    """Of 17 parts a gain whose sum is one and a half standard deviations of such sums."""
    spread = np.random.default_rng(2).standard_normal(parallel_choice.LOG_PARTS)
    spread = (spread - spread.mean()) / spread.std(ddof=1)
    gain = spread + 1.5 / np.sqrt(len(spread))
    assert np.mean(gain > 0) > 0.5
    losses = iter([10 + gain, np.full(len(gain), 10.0)])
    monkeypatch.setattr(parallel_choice, "_losses", lambda *_: next(losses))
    log, tried = recorded(phantom, noise=0.05), haptid.Treatment(12.0, parallel_cutoff_hz=4.0)
    assert parallel_choice.better_cutoff(phantom, [log], [tried, tried], 0, tried, 0.0, surely) == chosen
