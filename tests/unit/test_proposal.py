"""A proposed treatment follows the motion, keeps rows, finds the delay, and states reasons."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import haptid
from haptid.errors import LogMismatchError, TreatmentError
from haptid.log.spectrum import Spectrum, bandwidth, passed, quantum, smoothed
from haptid.motion.streaming import delayed
from haptid.treatment_choice import delay_estimate
from haptid.treatment_choice.delay_estimate import Delays, find_delays
from haptid.treatment_choice.uncertainty import with_delay_uncertainty, with_treatment_uncertainty
from motions import multisine, truth

STEP = 2 * np.pi / 4000 / 12
CENTRE = np.array([0.0, 0.5, 0.8])


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def recorded(model, *, seconds=20.0, late=0.0, step=STEP, noise=0.0, size=0.2, seed=1, slowdown=1.0):
    """A log with torque that is late by so many samples; `slowdown` slows the motion down."""
    q, qd, qdd = multisine(len(model.device.active), seconds / slowdown, 1e-3 / slowdown, seed, size)
    q = q + CENTRE[:, None]
    tau = haptid.inverse_dynamics(model, truth(model), q, qd / slowdown, qdd / slowdown**2).T
    shifts = tuple(-k for k in late) if isinstance(late, tuple) else -late
    tau = np.asarray(delayed(tau, shifts))  # recorded before it acts
    tau = tau + noise * tau.std(axis=0) * np.random.default_rng(seed).standard_normal(tau.shape)
    position = step * np.round(q.T / step) if step else q.T
    channels = haptid.Channels(
        haptid.Signal(("q1", "q2", "q3"), "rad"),
        haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"),
        time="t",
    )
    gains = [motor.gear_ratio * motor.torque_constant for motor in model.device.motors]
    return haptid.Log(Path("made"), str(seed), 1e-3 * np.arange(q.shape[1]), position, tau / gains, channels)


@settings(max_examples=4, deadline=None)
@given(st.sampled_from([0.5, 1.0, 2.0]), st.integers(0, 9))
def test_the_filter_follows_the_speed_of_the_motion(phantom, slowdown, seed):
    made = recorded(phantom, slowdown=slowdown, seed=seed, seconds=20.0 * slowdown)
    assert bandwidth(made) == pytest.approx(2.4 / slowdown, rel=0.35)
    proposal = haptid.propose(phantom, made)
    times = proposal.treatment.parallel_cutoff_hz / bandwidth(made)
    assert min(abs(times - k) for k in (1.5, 3.0, 6.0, 12.0)) < 0.05
    assert proposal.reference.parallel_cutoff_hz == pytest.approx(6 * bandwidth(made), rel=0.01)
    assert proposal.reference.reversal_speed == 0.0
    assert min(proposal.treatment.cutoff_hz) >= 1.19 * bandwidth(made)


def sampled(f, step, rate, seconds, rng, colour=0.0, steps=0.0):
    """Three tones up to f Hz with a radian of amplitude, through an encoder with AR(1) noise of so many steps."""
    t = np.arange(round(rate * seconds)) / rate
    x = sum(np.sin(2 * np.pi * f * k / 3 * t + rng.uniform(0, 6)) / k for k in (1, 2, 3))
    noise = rng.normal(size=len(t))
    for k in range(1, len(t)):
        noise[k] = colour * noise[k - 1] + np.sqrt(1 - colour**2) * noise[k]
    return step * np.round((x + steps * step * noise) / step)


@pytest.mark.parametrize("bits", [11, 13, 16, 20])
@pytest.mark.parametrize(("colour", "steps"), [(0.0, 0.0), (0.0, 1.0), (0.95, 4.0)])
@pytest.mark.parametrize(("f", "rate", "seconds"), [(0.1, 200.0, 60.0), (1.7, 1000.0, 20.0), (5.0, 500.0, 10.0)])
def test_noise_of_an_encoder_is_not_motion(bits, colour, steps, f, rate, seconds):
    """Coarse encoders, white and coloured noise: the bandwidth is that of the motion, not of the noise's remainder."""
    rng = np.random.default_rng(bits)
    found = Spectrum.of(sampled(f, 2 * np.pi / 2**bits, rate, seconds, rng, colour, steps), 1 / rate)
    assert 0.95 * f < found.bandwidth < 1.5 * f + 2 / seconds


def test_the_balanced_cutoff_leaves_the_regression_on_the_acceleration_with_slope_one():
    """What the filter takes of the motion balances what it leaves of the noise, so inertia keeps its size."""
    rng, rate, f = np.random.default_rng(0), 1000.0, 4.0
    t = np.arange(60_000) / rate
    exact = np.sin(2 * np.pi * f * t) + 0.5 * np.sin(2 * np.pi * 1.3 * t)
    measured = exact + 3e-2 * rng.normal(size=len(t))
    spectrum = Spectrum.of(measured, 1 / rate)
    cutoff = spectrum.balanced_cutoff(3 * f, 1.2 * f, 300.0)
    H, B = (gain(np.fft.rfftfreq(len(t), 1 / rate), c) for gain, c in ((passed, cutoff), (smoothed, 3 * f)))
    w = (2 * np.pi * np.fft.rfftfreq(len(t), 1 / rate)) ** 2
    seen, true = (np.fft.rfft(x) * w * B * g for x, g in ((measured, H), (exact, 1.0)))
    slope = np.sum((seen.conj() * true).real) / np.sum(np.abs(seen) ** 2)
    # Half a step of the search for the cut-off, 80 from 4.8 to 300 Hz, moves the slope by less than this.
    assert slope == pytest.approx(1.0, abs=0.02)
    assert cutoff < 60.0


def test_the_resolution_of_an_encoder_is_the_step_of_its_values():
    x = np.sin(np.linspace(0, 20, 5000))
    assert quantum(1e-3 * np.round(x / 1e-3)) == pytest.approx(1e-3)
    assert quantum(x) == 0.0


DELAYS = haptid.Treatment(21.0, parallel_cutoff_hz=7.0, decimation=14)


@settings(max_examples=6, deadline=None)
@given(st.floats(-0.9, 5.0), st.integers(0, 9))
@example(1.25, 8)
def test_the_delay_is_found(phantom, late, seed):
    found = find_delays(phantom, [recorded(phantom, late=late, seed=seed, noise=0.01)], DELAYS)
    assert found.accepted
    np.testing.assert_allclose(found.seconds, 1e-3 * late, atol=5 * found.se.max() + 2e-5)
    assert found.se.max() < 5e-4  # half a sample: a motor with little acceleration has 0.3 in some motions


def test_the_delay_of_each_motor_is_found(phantom):
    late = np.array([0.5, 1.5, 0.7])
    found = find_delays(phantom, [recorded(phantom, late=tuple(late), noise=0.01)], DELAYS)
    np.testing.assert_allclose(found.seconds / 1e-3, late, atol=5 * found.se.max() / 1e-3 + 0.02)
    assert len(found.setting) == 3


def drifting(log, seed):
    """The log with a random walk of a tenth of its torque."""
    walk = np.cumsum(np.random.default_rng(seed).standard_normal(log.torque.shape), axis=0)
    drift = 0.1 * log.torque.std(axis=0) * (walk - walk.mean(axis=0)) / walk.std(axis=0)
    return dataclasses.replace(log, torque=log.torque + drift)


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_of_the_torque_does_not_hide_the_delay(phantom, seed):
    found = find_delays(phantom, [drifting(recorded(phantom, late=3.0, seed=seed), seed)], DELAYS)
    assert found.accepted
    assert found.white
    np.testing.assert_allclose(found.seconds, 3e-3, atol=3 * found.se.max())
    assert found.se.max() < 5e-4


def test_rows_are_whitened_only_under_a_drift(phantom, monkeypatch):
    monkeypatch.setattr(delay_estimate.NuisanceProblem, "whitened", None)
    assert not find_delays(phantom, [recorded(phantom, late=3.0, noise=0.01)], DELAYS).white


def test_what_goes_with_the_second_rate_of_the_torque_is_no_delay_beside_a_drift(phantom):
    """A torque that is recorded as a mean of 41 samples: no delay, however long, makes it."""
    made = recorded(phantom, late=3.0)
    mean = np.stack([np.convolve(u, np.full(41, 1 / 41), "same") for u in made.torque.T], axis=1)
    found = find_delays(phantom, [drifting(dataclasses.replace(made, torque=mean), 1)], DELAYS)
    assert not found.white
    assert found.se.min() > 5e-4


def test_friction_that_the_model_lacks_is_not_compensated_as_a_delay(phantom):
    """Friction with presliding lags the velocity: what looks like a delay of many samples is not one."""
    made = recorded(phantom, noise=0.01)
    rate = np.gradient(made.position, 1e-3, axis=0)
    lag = np.exp(-np.arange(800) / 120.0)
    late = np.stack([np.convolve(np.tanh(v / 0.02), lag / lag.sum())[: len(v)] for v in rate.T], axis=1)
    presliding = haptid.Log(
        made.path, "p", made.t, made.position, made.torque + 2.0 * made.torque.std(axis=0) * late, made.channels
    )
    found = find_delays(phantom, [presliding], DELAYS)
    assert not found.accepted
    np.testing.assert_allclose(found.seconds, 5e-4)
    np.testing.assert_allclose(found.se, 1e-3)
    np.testing.assert_equal(found.dof, [np.inf] * 3)
    np.testing.assert_allclose(np.diff(found.conf_int())[:, 0], 2 * 1.96e-3, rtol=1e-3)
    assert "no delay of a drive" in found.sentence


@pytest.mark.parametrize("late", [2.5, 4.5])
def test_a_delay_that_rows_near_reversals_contradict_leaves_half_of_it_uncertain(phantom, late, monkeypatch):
    """It had a standard error of one sample, whatever was contradicted."""
    monkeypatch.setattr(delay_estimate, "_contradicted", lambda *_: True)
    found = find_delays(phantom, [recorded(phantom, late=late, noise=0.003)], DELAYS)
    assert not found.accepted
    np.testing.assert_allclose(found.seconds, 5e-4)
    np.testing.assert_allclose(found.se, 0.5 * np.abs(found.found - 5e-4).max())
    np.testing.assert_allclose(found.se, 5e-4 * (late - 0.5), rtol=0.1)
    assert f"standard error of {1e3 * found.se[0]:.3g} ms in every interval" in found.sentence


def test_a_long_delay_that_the_rigid_bodies_show_too_is_compensated(phantom):
    found = find_delays(phantom, [recorded(phantom, late=9.0, noise=0.01)], DELAYS)
    assert found.accepted
    np.testing.assert_allclose(found.seconds, 9e-3, atol=5 * found.se.max() + 5e-5)


@pytest.mark.parametrize(("late", "words"), [(0.5, "half a sampling period"), (2.3, "compensated")])
def test_a_delay_is_named(phantom, late, words):
    proposal = haptid.propose(phantom, recorded(phantom, late=late, noise=0.003))
    np.testing.assert_allclose(proposal.treatment.torque_delay_s, 1e-3 * late, atol=4e-5)
    assert words in proposal.reasons[-1]


def test_a_delay_that_is_not_identifiable_keeps_its_prior_and_its_uncertainty(phantom):
    proposal = haptid.propose(phantom, recorded(phantom, late=0.5, noise=20.0))
    delays = proposal.delays
    assert np.abs(delays.seconds - 5e-4).max() < 3 * delays.se.max()
    assert delays.se.min() > 5e-4


def test_the_uncertainty_of_the_delay_is_in_the_covariance(phantom):
    """To first order the parameters move with the delay as the estimate says: tried by a fit with another delay."""
    made = recorded(phantom, late=0.5, noise=0.02)
    proposal = haptid.propose(phantom, made)

    def fit(later):
        treatment = dataclasses.replace(proposal.treatment, torque_delay_s=proposal.delays.seconds[0] + later)
        return haptid.estimate(haptid.observe(phantom, haptid.treat(made, treatment)), haptid.WLS())

    delays = dataclasses.replace(proposal.delays, covariance=(1e-4) ** 2 * np.ones((3, 3)), samples=0)
    shift = with_delay_uncertainty(fit(0.0), delays).nuisances["torque delay"]
    moved = 0.5 * (fit(1e-4).beta - fit(-1e-4).beta)
    largest = shift[np.abs(shift).max(axis=1).argmax()]
    se = fit(0.0).se
    np.testing.assert_allclose(np.abs(largest / se), np.abs(moved / se), atol=0.2 * np.abs(moved / se).max())


def test_known_parameters_come_back_from_encoders_and_a_late_torque(phantom):
    made = recorded(phantom, late=0.5, noise=0.002, seconds=40.0)
    proposal = haptid.propose(phantom, made)
    estimate = haptid.estimate(haptid.observe(phantom, haptid.treat(made, proposal.treatment)), haptid.WLS())
    estimate = with_treatment_uncertainty(estimate, proposal.delays, proposal.effects)
    deviations = (estimate.beta - truth(phantom)) / estimate.se
    assert np.abs(deviations).max() < 4.5
    for name in ("FV1", "FV2", "FV3"):
        assert estimate[name].relative_se < 3


def test_what_is_requested_stays(phantom):
    made = recorded(phantom, late=0.5)
    asked = {"cutoff_hz": 60.0, "decimation": 5, "reversal_speed": 0.2, "torque_delay_s": 1e-3, "order": 2}
    proposal = haptid.propose(phantom, made, **asked)
    for name, value in asked.items():
        assert getattr(proposal.treatment, name) == value
    assert not any("delay" in reason or "are kept" in reason for reason in proposal.reasons)


def test_coarse_positions_are_named(phantom):
    coarse = haptid.propose(phantom, recorded(phantom, step=0.08), torque_delay_s=0.0)
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
    degrees = haptid.Log(made.path, "", made.t, np.rad2deg(made.position), made.torque, made.channels)
    with pytest.raises(LogMismatchError):
        haptid.propose(phantom, degrees)


def test_a_treatment_without_accelerations_is_proposed_too(phantom):
    made = recorded(phantom)
    asked = {"formulation": "momentum", "velocity": haptid.motion.HighPass(30.0)}
    treatment = haptid.propose(phantom, made, **asked).treatment
    assert treatment.cutoff_hz is None
    assert treatment.parallel_cutoff_hz >= 3 * bandwidth(made) * 0.99
    assert haptid.observe(phantom, haptid.treat(made, treatment)).rows > 1000


def test_a_causal_differentiator_is_not_taken_for_a_late_torque(phantom):
    made = recorded(phantom, late=0.5, noise=0.002)
    asked = {"formulation": "momentum", "velocity": haptid.motion.HighPass(30.0)}
    np.testing.assert_allclose(haptid.propose(phantom, made, **asked).treatment.torque_delay_s, 5e-4, atol=4e-5)


def test_the_part_that_moves_is_used(phantom):
    made = recorded(phantom, seconds=30.0)
    rest = np.full((60_000, 3), made.position[-1])
    still = np.zeros((60_000, 3))
    position, torque = np.vstack([made.position, rest]), np.vstack([made.torque, still])
    long = haptid.Log(made.path, "l", 1e-3 * np.arange(len(position)), position, torque, made.channels)
    assert haptid.propose(phantom, long).bandwidth_hz == pytest.approx(bandwidth(made), rel=0.1)


def test_logs_at_different_rates_are_not_searched_for_one_delay(phantom):
    made = recorded(phantom, late=0.5)
    thin = haptid.Log(made.path, "t", made.t[::4], made.position[::4], made.torque[::4], made.channels)
    proposal = haptid.propose(phantom, made, thin)
    assert proposal.treatment.torque_delay_s == 0
    assert "1000 and 250 Hz" in proposal.reasons[-1]


def test_rates_that_stamps_of_one_clock_differ_by_are_one(phantom):
    """A part in a thousand is what the stamps of a recorder drift by; the delay is found from both logs."""
    made = recorded(phantom, late=2.0, noise=0.01)
    other = recorded(phantom, late=2.0, noise=0.01, seed=2)
    drifted = haptid.Log(other.path, "d", 1.001 * other.t, other.position, other.torque, other.channels)
    proposal = haptid.propose(phantom, made, drifted)
    assert proposal.delays is not None
    np.testing.assert_allclose(proposal.delays.seconds, 2e-3, atol=5 * proposal.delays.se.max())


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


def test_a_delay_that_is_none_is_said_to_be_late_or_early():
    """Torque that acts before it is recorded may be of a late sensor: it was said to be a missing term in any case."""
    for found, words, other in (
        (4e-3, "seem late by 4 ms", "it is a delay all the same, give `torque_delay_s`"),
        (-2e-3, "act 2 ms before it is recorded", "the sensor is late, give `torque_delay_s`, below zero"),
    ):
        told = Delays(np.zeros(2), np.zeros((2, 2)), np.full(2, found), False, 1e-3).sentence
        assert words in told
        assert f"If {other}" in told


def test_a_joint_that_only_trembles_does_not_set_the_filters(phantom):
    """Two steps of its encoder at 90 Hz beside motion below 3 Hz: all filters followed the trembling."""
    made = recorded(phantom)
    still, position = np.array(made.position), np.array(made.position)
    still[:, 2] = CENTRE[2]
    position[:, 2] = CENTRE[2] + 2 * STEP * np.sign(np.sin(2 * np.pi * 90 * np.asarray(made.t)))
    alone, with_it = (
        haptid.propose(phantom, dataclasses.replace(made, position=q), torque_delay_s=0.0) for q in (still, position)
    )
    assert with_it.bandwidth_hz == alone.bandwidth_hz < 5
    assert with_it.treatment.parallel_cutoff_hz == alone.treatment.parallel_cutoff_hz
    assert max(with_it.treatment.cutoff_hz[:2]) == pytest.approx(max(alone.treatment.cutoff_hz[:2]), rel=0.1)
    assert any("is trembling while others move" in reason for reason in with_it.reasons)
