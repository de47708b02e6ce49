"""The treatment does to signals what it says, in hertz."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import haptid
from haptid.errors import MotionTooShortError, TreatmentError
from haptid.motion import WindowedSinc
from haptid.motion.motion import with_positions
from haptid.motion.streaming import delayed, lost


def gain(filtered, t, frequency):
    """Amplitude of a unit sine after a filter, by projection on sine and cosine."""
    basis = np.column_stack([np.sin(2 * np.pi * frequency * t), np.cos(2 * np.pi * frequency * t)])
    inner = slice(len(t) // 4, 3 * len(t) // 4)
    found = np.linalg.lstsq(basis[inner], filtered[inner], rcond=None)[0]
    return np.hypot(*found), np.arctan2(found[1], found[0])


@settings(max_examples=40, deadline=None)
@given(st.floats(0.004, 0.4), st.integers(1, 8), st.floats(50.0, 5000.0))
def test_position_filter_is_3_db_down_at_its_cutoff_and_has_no_delay(share, order, rate):
    cutoff = share * rate / 2
    sections = haptid.Treatment(cutoff_hz=cutoff, order=order).position_filter(1 / rate)[0]
    t = np.arange(0, 60 / cutoff, 1 / rate)
    size, phase = gain(signal.sosfiltfilt(sections, np.sin(2 * np.pi * cutoff * t)), t, cutoff)
    assert size == pytest.approx(np.sqrt(0.5), rel=1e-6)
    assert abs(phase) < 1e-6


@settings(max_examples=30, deadline=None)
@given(
    st.integers(2, 60),
    st.floats(0.1, 0.9),
    st.floats(100.0, 5000.0),
    st.sampled_from([haptid.motion.KaiserSmoother(), WindowedSinc()]),
)
def test_parallel_filter_is_3_db_down_at_its_cutoff_and_has_no_delay(decimation, share, rate, shape):
    cutoff = share * 0.5 * rate / decimation
    treatment = haptid.Treatment(decimation=decimation, parallel_cutoff_hz=cutoff, parallel_shape=shape)
    taps = treatment.taps(1 / rate)
    assert len(taps) % 2 == 1
    np.testing.assert_allclose(taps, taps[::-1], rtol=0, atol=1e-15)
    assert taps.sum() == pytest.approx(1.0)
    _, response = signal.freqz(taps, worN=[cutoff], fs=rate)
    # A bell's length is not whole: two samples that come in at its ends weigh 1/427 of the middle each. What they add
    # and what they take from the others are two steps each of that size at most.
    assert abs(response[0]) == pytest.approx(
        np.sqrt(0.5), abs=1e-6 if shape == WindowedSinc() else 4 * taps.max() / 427
    )


def test_sharp_filter_stops_what_would_alias():
    taps = haptid.Treatment(decimation=10, parallel_shape=WindowedSinc()).taps(1e-3)
    _, response = signal.freqz(taps, worN=[10.0, 30.0, 40.0, 50.0, 60.0], fs=1000.0)
    passed, still, cut, folding, stopped = abs(response)
    assert passed == pytest.approx(1.0, abs=5e-3)
    assert still > 0.99
    assert cut == pytest.approx(np.sqrt(0.5), abs=1e-6)
    assert folding < 0.2
    assert stopped < 3e-3  # what would alias below 40 Hz
    assert np.array_equal(haptid.Treatment(decimation=1).taps(1e-3), [1.0])


def test_bell_rings_nowhere_and_reaches_a_third_as_far_as_a_sharp_filter_of_the_same_noise():
    """Noise of positions grows with the square of frequency in accelerations: their share that each lets through."""
    bell = haptid.Treatment(decimation=10, parallel_cutoff_hz=20.0).taps(1e-3)
    assert (bell > 0).all()
    sharp = haptid.Treatment(decimation=10, parallel_cutoff_hz=27.5, parallel_shape=WindowedSinc()).taps(1e-3)
    f = np.linspace(0, 500, 2000)
    through = [np.sum(f**4 * np.abs(signal.freqz(taps, worN=f, fs=1000.0)[1]) ** 2) for taps in (bell, sharp)]
    assert through[0] == pytest.approx(through[1], rel=0.15)
    assert len(bell) < 0.4 * len(sharp)


@settings(max_examples=30, deadline=None)
@given(st.floats(-5, 5))
def test_a_delayed_sine_is_late_by_so_many_samples(samples):
    t = 1e-3 * np.arange(400)
    channels = np.column_stack([np.sin(2 * np.pi * 5 * t), np.cos(2 * np.pi * 3 * t)])
    found, late = delayed(channels, samples), t - 1e-3 * samples
    inner = slice(lost(samples), len(t) - lost(samples))
    expected = np.column_stack([np.sin(2 * np.pi * 5 * late), np.cos(2 * np.pi * 3 * late)])
    np.testing.assert_allclose(found[inner], expected[inner], atol=1e-7)


def test_rates_of_a_parabola_are_exact():
    t = 0.01 * np.arange(200)
    q = np.column_stack([1 + 2 * t + 3 * t**2, -4 * t])
    motion = haptid.Motion(0.01, q, np.zeros((200, 1)), haptid.Treatment(cutoff_hz=None))
    assert motion.usable == (4, 196)
    np.testing.assert_allclose(motion.qd[4:-4], np.column_stack([2 + 6 * t, 0 * t - 4])[4:-4], atol=1e-10)
    np.testing.assert_allclose(motion.qdd[4:-4], np.column_stack([0 * t + 6, 0 * t])[4:-4], atol=1e-8)


def test_rates_at_a_tenth_of_the_sampling_rate_are_exact_to_a_thousandth():
    t = 0.01 * np.arange(400)
    q = np.column_stack([np.sin(2 * np.pi * 10 * t)])
    motion = haptid.Motion(0.01, q, np.zeros((400, 1)), haptid.Treatment(cutoff_hz=None))
    _, qd, qdd = motion.kinematics(4, 396)
    np.testing.assert_allclose(qd[0], 2 * np.pi * 10 * np.cos(2 * np.pi * 10 * t)[4:-4], atol=1e-3 * 63)
    np.testing.assert_allclose(qdd[0], -((2 * np.pi * 10) ** 2) * q[4:-4, 0], atol=1e-3 * 3948)


def test_what_stands_still_is_exactly_still_behind_the_filter():
    channels = haptid.Channels(
        haptid.Signal(("a",), "rad", constant_ok=True), haptid.Signal(("u",), "N m"), rate_hz=1000.0
    )
    torque = np.random.default_rng(0).normal(size=(3000, 1))
    log = haptid.Log("made", "", 1e-3 * np.arange(3000), np.full((3000, 1), 0.3), torque, channels)
    motion = haptid.treat(log, haptid.Treatment(40.0))
    assert (motion.qd == 0).all()


def test_motions_of_one_log_share_their_differences_and_nothing_else():
    channels = haptid.Channels(haptid.Signal(("a",), "rad"), haptid.Signal(("u",), "N m"), rate_hz=1000.0)
    walk = np.cumsum(np.random.default_rng(0).normal(size=(2, 3000)), axis=1)
    log = haptid.Log("made", "", 1e-3 * np.arange(3000), walk[:1].T, walk[1:].T, channels)
    first, again, other = (haptid.treat(log, haptid.Treatment(cutoff)) for cutoff in (40.0, 40.0, 60.0))
    assert again.q is first.q
    assert (again.qd == first.qd).all()
    assert not np.allclose(other.qd, first.qd)
    doubled = replace(first, q=2 * first.q)  # shares what first has kept, which is of other positions
    assert np.allclose(doubled.qd, 2 * first.qd, rtol=1e-12)
    assert np.allclose(doubled.qdd, 2 * first.qdd, rtol=1e-12)
    assert (pickle.loads(pickle.dumps(first)).qdd == first.qdd).all()
    alone = haptid.Motion(1e-3, first.q, first.tau, first.treatment)
    part, whole = alone.kinematics(100, 200), first.kinematics(4, 2996)
    for piece, all_samples in zip(part, whole, strict=True):
        assert (piece == all_samples[:, 96:196]).all()


def walks(rng):
    """A log of two joints that wander, at 1 kHz."""
    channels = haptid.Channels(haptid.Signal(("a", "b"), "rad"), haptid.Signal(("u", "v"), "N m"), rate_hz=1000.0)
    q, tau = np.cumsum(rng.normal(size=(2, 3000, 2)), axis=1)
    return haptid.Log("made", "", 1e-3 * np.arange(3000), q, tau, channels)


def test_motions_with_one_delay_share_their_positions_and_those_with_another_do_not():
    log = walks(np.random.default_rng(1))
    late = haptid.Treatment(40.0, torque_delay_s=1.4e-3)
    first, again = haptid.treat(log, late), haptid.treat(log, late)
    assert again.q is first.q
    assert (again.qd == first.qd).all()
    other = haptid.treat(log, replace(late, torque_delay_s=0.3e-3))
    for motion in (other, haptid.treat(log, late)):  # the other one has taken the place of what was kept
        alone = haptid.Motion(1e-3, motion.q, motion.tau, motion.treatment)
        assert (motion.qdd == alone.qdd).all()
    assert not np.allclose(other.q, first.q)


def test_a_motion_with_other_positions_is_that_of_a_log_with_them():
    rng = np.random.default_rng(2)
    log, moved = walks(rng), np.cumsum(rng.normal(size=(3000, 2)), axis=0)
    late = haptid.Treatment((40.0, 70.0), torque_delay_s=(1.4e-3, 0.3e-3))
    made, wanted = with_positions(haptid.treat(log, late), moved), haptid.treat(replace(log, position=moved), late)
    for name in ("q", "qd", "qdd", "tau"):
        assert (getattr(made, name) == getattr(wanted, name)).all()
    assert (made.log.position == moved).all()


def test_a_motion_keeps_what_it_was_given_and_nobody_can_write_to_it():
    q = np.zeros((100, 1))
    motion = haptid.Motion(0.01, q, q, haptid.Treatment(cutoff_hz=None))
    q[0] = 1.0
    assert motion.q[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        motion.q[0] = 1.0


@pytest.mark.parametrize(
    "settings_",
    [
        {"cutoff_hz": -1.0},
        {"cutoff_hz": float("nan")},
        {"order": 0},
        {"order": 2.5},
        {"decimation": 0},
        {"reversal_speed": -0.1},
        {"reversal_speed": (0.1, float("inf"))},
        {"cutoff_hz": "40"},
        {"decimation": True},
        {"reversal_speed": ()},
        {"block_s": 0.0},
        {"reversal_guard_s": -0.1},
        {"parallel_cutoff_hz": 0.0},
    ],
)
def test_settings_out_of_range_are_rejected(settings_):
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(**settings_)
    assert raised.value.where == next(iter(settings_))


def test_a_cutoff_the_rate_cannot_carry_is_rejected():
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(cutoff_hz=600.0).position_filter(1e-3)
    assert (raised.value.where, raised.value.found, raised.value.limit) == ("cutoff_hz", 600, 500)
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(decimation=10, parallel_cutoff_hz=60.0).taps(1e-3)
    assert (raised.value.where, raised.value.limit) == ("parallel_cutoff_hz", 50)


def test_a_motion_shorter_than_its_filter_is_rejected():
    motion = haptid.Motion(1e-3, np.zeros((100, 1)), np.zeros((100, 1)), haptid.Treatment(cutoff_hz=1.0))
    with pytest.raises(MotionTooShortError) as raised:
        motion.usable  # noqa: B018
    assert raised.value.found == pytest.approx(0.1)
    assert raised.value.found < raised.value.limit


def test_a_cutoff_that_is_below_rounding_is_rejected():
    with pytest.raises(TreatmentError) as raised:
        haptid.Treatment(cutoff_hz=1e-6, order=12).position_filter(1e-3)
    assert raised.value.where == "cutoff_hz"
    assert raised.value.found == 1e-6


def test_whole_numbers_of_numpy_are_whole_numbers():
    assert haptid.Treatment(decimation=np.int64(10), cutoff_hz=40).decimation == 10


def test_a_motion_of_formulas_must_be_finite():
    q = np.zeros((100, 2))
    q[7, 1] = np.nan
    with pytest.raises(TreatmentError) as raised:
        haptid.Motion(0.01, q, np.zeros((100, 2)), haptid.Treatment())
    assert raised.value.where == ("q", 7)
