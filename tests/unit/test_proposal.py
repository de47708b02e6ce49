"""A proposed treatment follows the motion, keeps rows, finds the delay, and says why."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid.errors import LogMismatchError, TreatmentError
from haptid.motion.streaming import delayed
from haptid.treatment_choice.propose import bandwidth
from motions import multisine, truth

STEP = 2 * np.pi / 4000 / 12
CENTRE = np.array([0.0, 0.5, 0.8])


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, *, seconds=20.0, late=0.0, step=STEP, noise=0.0, size=0.2, seed=1, stretch=1.0):
    """A log with torque that is late by so many samples; `stretch` slows the motion down."""
    q, qd, qdd = multisine(len(model.device.active), seconds / stretch, 1e-3 / stretch, seed, size)
    q = q + CENTRE[:, None]
    tau = haptid.inverse_dynamics(model, truth(model), q, qd / stretch, qdd / stretch**2).T
    tau = np.asarray(delayed(tau, -late))  # recorded before it acts
    tau = tau + noise * tau.std(axis=0) * np.random.default_rng(seed).standard_normal(tau.shape)
    position = step * np.round(q.T / step) if step else q.T
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"),
        time="t",
    )
    gains = [motor.gear * motor.gain for motor in model.device.motors]
    return haptid.Log(Path("made"), str(seed), 1e-3 * np.arange(q.shape[1]), position, tau / gains, channels)


@settings(max_examples=5, deadline=None)
@given(st.sampled_from([0.5, 1.0, 2.0, 3.0]), st.integers(0, 9))
def test_the_filter_follows_the_speed_of_the_motion(phantom, stretch, seed):
    made = recorded(phantom, stretch=stretch, seed=seed, seconds=20.0 * stretch)
    assert bandwidth(made) == pytest.approx(2.4 / stretch, rel=0.35)
    treatment = haptid.propose(phantom, made).treatment
    assert treatment.parallel_cutoff_hz == pytest.approx(3 * bandwidth(made), rel=0.01)
    assert treatment.cutoff_hz == pytest.approx(3 * treatment.parallel_cutoff_hz)
    assert treatment.decimation == pytest.approx(100 / treatment.parallel_cutoff_hz, abs=1)


@settings(max_examples=5, deadline=None)
@given(st.floats(-0.9, 12.0), st.integers(0, 9))
def test_the_delay_is_found(phantom, late, seed):
    made = recorded(phantom, late=late, seed=seed, noise=0.01)
    delay = haptid.find_delay(phantom, [made], haptid.Treatment(21.0, parallel_cutoff_hz=7.0, decimation=14))
    assert delay.seconds == pytest.approx(1e-3 * late, abs=5 * delay.se + 2e-5)
    assert delay.se < 5e-5


@pytest.mark.parametrize(
    ("late", "taken", "words"),
    [(0.0, 0.0, "zero within"), (0.5, 5e-4, "half a sampling period"), (2.3, 2.3e-3, "compensated")],
)
def test_a_delay_is_named(phantom, late, taken, words):
    proposal = haptid.propose(phantom, recorded(phantom, late=late, noise=0.003))
    assert proposal.treatment.torque_delay_s == pytest.approx(taken, abs=2e-5)
    assert words in proposal.reasons[-1]


def test_a_log_that_does_not_tell_the_delay_is_taken_as_it_is(phantom):
    proposal = haptid.propose(phantom, recorded(phantom, late=3.0, noise=20.0))
    assert proposal.treatment.torque_delay_s == 0
    assert "not identifiable from the logs" in proposal.reasons[-1]


def test_known_parameters_come_back_from_encoders_and_a_late_torque(phantom):
    made = recorded(phantom, late=0.5, noise=0.002, seconds=40.0)
    treatment = haptid.propose(phantom, made).treatment
    estimate = haptid.estimate(haptid.observe(phantom, haptid.treat(made, treatment)), haptid.WLS())
    deviations = (estimate.beta - truth(phantom)) / estimate.se
    assert np.abs(deviations).max() < 4.5
    for name in ("FV1", "FV2", "FV3"):
        assert estimate[name].relative_se < 2


def test_what_is_asked_for_stays(phantom):
    made = recorded(phantom, late=0.5)
    asked = {"cutoff_hz": 60.0, "decimation": 5, "reversal_speed": 0.2, "torque_delay_s": 1e-3, "order": 2}
    proposal = haptid.propose(phantom, made, **asked)
    for name, value in asked.items():
        assert getattr(proposal.treatment, name) == value
    assert proposal.treatment.parallel_cutoff_hz == pytest.approx(20.0)
    assert not any("late" in reason or "kept of" in reason for reason in proposal.reasons)


def test_the_filter_is_widened_where_it_leaves_too_few_rows(phantom):
    made = recorded(phantom)
    proposal = haptid.propose(phantom, made, torque_delay_s=0.0, reversal_speed=0.6)
    assert proposal.treatment.parallel_cutoff_hz > 1.2 * 3 * bandwidth(made)
    assert any("widened" in reason for reason in proposal.reasons)


def test_coarse_positions_are_named(phantom):
    coarse = haptid.propose(phantom, recorded(phantom, step=0.02), torque_delay_s=0.0)
    assert any("with a finer encoder" in reason for reason in coarse.reasons)
    fine = haptid.propose(phantom, recorded(phantom), torque_delay_s=0.0)
    assert not any("with a finer encoder" in reason for reason in fine.reasons)


def test_a_device_without_dry_friction_loses_no_rows():
    model = haptid.DynamicModel(haptid.read_device("rx90"))
    q, qd, qdd = multisine(6, 10.0, 1e-3, 1)
    tau = haptid.inverse_dynamics(model, np.linspace(0.1, 1.0, len(model.base)), q, qd, qdd)
    names = tuple("abcdef")
    channels = haptid.Channels(
        haptid.Signal(names, "rad"), haptid.Signal(tuple(f"u{n}" for n in names), "N m"), time="t"
    )
    made = haptid.Log(Path("made"), "", 1e-3 * np.arange(q.shape[1]), q.T, tau.T, channels)
    assert haptid.propose(model, made).treatment.reversal_speed == 0


def test_a_log_of_another_device_and_impossible_settings_are_errors(phantom):
    made = recorded(phantom)
    with pytest.raises(TreatmentError) as raised:
        haptid.propose(phantom, made, decimation=0)
    assert raised.value.where == "decimation"
    swapped = haptid.Log(made.path, "", made.t, made.position[:, ::-1] + [0.0, 0.0, -0.5], made.torque, made.channels)
    with pytest.raises(LogMismatchError):
        haptid.propose(phantom, swapped)


def test_a_treatment_without_accelerations_is_proposed_too(phantom):
    made = recorded(phantom)
    asked = {"accelerations": "momentum", "velocity": haptid.HighPass(30.0)}
    treatment = haptid.propose(phantom, made, **asked).treatment
    assert treatment.cutoff_hz is None
    assert treatment.parallel_cutoff_hz == pytest.approx(3 * bandwidth(made), rel=0.01)
    assert haptid.observe(phantom, haptid.treat(made, treatment)).rows > 1000


def test_a_causal_differentiator_is_not_taken_for_a_late_torque(phantom):
    made = recorded(phantom, late=0.5, noise=0.002)
    asked = {"accelerations": "momentum", "velocity": haptid.HighPass(30.0)}
    assert haptid.propose(phantom, made, **asked).treatment.torque_delay_s == pytest.approx(5e-4, abs=2e-5)


def test_the_stretch_that_moves_is_looked_at(phantom):
    made = recorded(phantom, seconds=30.0)
    rest = np.full((150_000, 3), made.position[-1])
    still = np.zeros((150_000, 3))
    position, torque = np.vstack([made.position, rest]), np.vstack([made.torque, still])
    long = haptid.Log(made.path, "l", 1e-3 * np.arange(len(position)), position, torque, made.channels)
    assert haptid.propose(phantom, long).treatment.parallel_cutoff_hz == pytest.approx(3 * bandwidth(made), rel=0.1)


def test_logs_at_different_rates_are_not_asked_for_one_delay(phantom):
    made = recorded(phantom, late=0.5)
    thin = haptid.Log(made.path, "t", made.t[::4], made.position[::4], made.torque[::4], made.channels)
    proposal = haptid.propose(phantom, made, thin)
    assert proposal.treatment.torque_delay_s == 0
    assert "1000 and 250 Hz" in proposal.reasons[-1]


def test_a_rate_too_low_for_the_motion_is_named(phantom):
    made = recorded(phantom)
    slow = haptid.Log(made.path, "s", made.t[::100], made.position[::100], made.torque[::100], made.channels)
    proposal = haptid.propose(phantom, slow, torque_delay_s=0.0)
    assert "Record at a higher rate" in proposal.reasons[0]


def test_times_in_the_wrong_unit_do_not_stop_the_program(phantom):
    made = recorded(phantom)
    micro = haptid.Log(made.path, "m", 1e6 * made.t, made.position, made.torque, made.channels)
    assert haptid.propose(phantom, micro, torque_delay_s=0.0).treatment.parallel_cutoff_hz < 1e-3


def test_settings_that_are_none_and_no_logs_at_all_are_errors(phantom):
    with pytest.raises(TreatmentError) as raised:
        haptid.propose(phantom, recorded(phantom), bogus=3)
    assert raised.value.found == "bogus"
    with pytest.raises(TreatmentError) as raised:
        haptid.propose(phantom)
    assert raised.value.where == "logs"
