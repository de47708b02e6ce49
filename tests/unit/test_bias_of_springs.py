"""Bias by noise and position filter: subtracted where a device has springs, uncertain where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import haptid
from elastic_motors import STEP, TRUTH, K, axis, recorded
from haptid.estimation import Bounds, EqualityConstraints, FixedAtZero, PhysicallyConsistent
from haptid.estimation.intervals.profile import Profile
from haptid.inference.elimination import refit_without
from haptid.log.spectrum import Spectrum
from haptid.treatment_choice import with_treatment_uncertainty
from haptid.treatment_choice.noise_effect import without_bias
from haptid.validation.model_for_use import model_for_use

STEP_12_BITS = 2 * np.pi / 4096


@pytest.fixture(scope="module")
def narrow():
    """The elastic axis, moved up to 11 Hz, behind a position filter of 17 Hz: estimate and proposal."""
    log = recorded(seconds=12.0)
    proposal = haptid.propose(axis(), log, cutoff_hz=17.0, torque_delay_s=0.0)
    return haptid.estimate(haptid.observe(axis(), haptid.treat(log, proposal.treatment)), haptid.WLS()), proposal


def test_a_narrow_position_filter_leaves_the_stiffness_right(narrow):
    plain, proposal = narrow
    made = with_treatment_uncertainty(plain, proposal.delays, proposal.effects, proposal.rounding)
    assert plain["KE1"].value > 1.01 * K
    assert made["KE1"].value == pytest.approx(K, rel=1e-3)
    assert all(low < TRUTH[name] < high for name, (low, high) in zip(made.names, made.conf_int(), strict=True))


def test_where_intervals_are_of_a_profile_all_of_the_bias_is_uncertain(narrow):
    plain, proposal = narrow
    less, uncertain = without_bias(plain, proposal.effects)
    held = haptid.estimate(plain.observation, PhysicallyConsistent(), Profile())
    same, whole = without_bias(held, proposal.effects)
    assert same is held
    np.testing.assert_allclose(plain.beta - less.beta, sum(whole.values())[0])
    assert all((np.abs(whole[name]) >= np.abs(shift)).all() for name, shift in uncertain.items())


@pytest.mark.parametrize("method", [EqualityConstraints({"KE1": K}), FixedAtZero(("FV1",))])
def test_what_is_known_stays_as_it_is(narrow, method):
    """With the true stiffness given, the link is 0.5 % too heavy by the filter, and right less its bias."""
    plain, proposal = narrow
    found = haptid.estimate(plain.observation, method)
    made = with_treatment_uncertainty(found, proposal.delays, proposal.effects, proposal.rounding)
    known = "KE1" if "KE1" in getattr(method, "relations", ()) else "FV1"
    assert made[known].value == pytest.approx(found[known].value, rel=1e-12, abs=1e-12)
    assert made[known].se == pytest.approx(0.0, abs=1e-12)
    assert abs(made["ZZ1"].value / TRUTH["ZZ1"] - 1) < 0.3 * abs(found["ZZ1"].value / TRUTH["ZZ1"] - 1)


def test_the_estimate_after_elimination_is_less_the_bias_too(narrow):
    """As if the smaller model had been identified from the log: without it the stiffness was 1.2 % too large."""
    plain, proposal = narrow
    full = with_treatment_uncertainty(plain, proposal.delays, proposal.effects, proposal.rounding)
    left = refit_without(full, ("FV1",))
    smaller = haptid.estimate(plain.observation, FixedAtZero(("FV1",)))
    own = with_treatment_uncertainty(smaller, proposal.delays, proposal.effects, proposal.rounding)
    np.testing.assert_allclose(left.beta, own.beta, rtol=1e-9)
    np.testing.assert_allclose(left.conf_int(), own.conf_int(), rtol=1e-6)
    assert smaller["KE1"].value > 1.01 * K
    assert left["KE1"].value == pytest.approx(K, rel=2e-3)
    assert (left.se > 1.1 * smaller.se)[left.names.index("KE1")]


def test_delays_are_in_the_intervals_after_elimination():
    log = recorded(seconds=12.0)
    proposal = haptid.propose(axis(), log)
    plain = haptid.estimate(haptid.observe(axis(), haptid.treat(log, proposal.treatment)), haptid.WLS())
    full = with_treatment_uncertainty(plain, proposal.delays, proposal.effects, proposal.rounding)
    assert full["DE1"].se < 0.5 * plain["DE1"].se  # the delay is of the same rows, and their errors are in both
    np.testing.assert_allclose(refit_without(full, ()).conf_int(), full.conf_int(), rtol=1e-6)


def test_bounds_hold_for_what_is_less_its_bias(narrow):
    """Below 608 N m/rad the fit is at its bound; less the bias it is not, and no note says that it is."""
    plain, proposal = narrow
    found = haptid.estimate(plain.observation, Bounds({"KE1": (None, 608.0), "FV1": (None, 0.048)}))
    assert found["KE1"].value == 608.0
    assert any("KE1 is at its bound" in note for note in found.notes)
    made = with_treatment_uncertainty(found, proposal.delays, proposal.effects, proposal.rounding)
    assert made.free == pytest.approx(without_bias(plain, proposal.effects)[0].beta)
    assert made["FV1"].value == 0.048
    assert made["KE1"].value < 607.0
    assert not any("KE1 is at its bound" in note for note in made.notes)
    assert any("FV1 is at its bound" in note for note in made.notes)


@pytest.mark.parametrize("wanted", ["auto", "consistent", "free"])
def test_the_model_for_use_is_less_the_bias_too(narrow, wanted):
    plain, proposal = narrow
    made = with_treatment_uncertainty(plain, proposal.delays, proposal.effects, proposal.rounding)
    used = model_for_use(made, wanted=wanted).estimate
    np.testing.assert_allclose(used.beta, made.beta, rtol=1e-9)
    np.testing.assert_allclose(used.conf_int(), made.conf_int(), rtol=1e-6)


def test_a_device_without_springs_keeps_its_estimate(narrow):
    _, proposal = narrow
    terms = [{"kind": kind, "joints": "all"} for kind in ("rotor-inertia", "viscous")]
    rigid, log = axis(terms=terms), recorded(seconds=12.0)
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), log.channels.torque, "t")
    motor = replace(log, position=np.ascontiguousarray(log.position[:, 1:]), channels=channels)
    found = haptid.estimate(haptid.observe(rigid, haptid.treat(motor, proposal.treatment)), haptid.WLS())
    effects = {"position filter": np.ones((1, len(found.beta)))}
    assert without_bias(found, effects)[0] is found


def test_what_rounding_moves_the_stiffness_by_is_subtracted():
    """Steps 200 times as coarse, of 6 mrad: noise divides inertia between rotor and link."""
    log, step = recorded(seconds=12.0), 200 * STEP
    coarse = replace(log, position=step * np.round(log.position / step))
    proposal = haptid.propose(axis(), coarse, cutoff_hz=60.0, parallel_cutoff_hz=25.0, torque_delay_s=0.0)
    plain = haptid.estimate(haptid.observe(axis(), haptid.treat(coarse, proposal.treatment)), haptid.WLS())
    made = with_treatment_uncertainty(plain, proposal.delays, proposal.effects, proposal.rounding)
    for name in ("KE1", "IAM1"):
        before, after = (abs(found[name].value / TRUTH[name] - 1) for found in (plain, made))
        assert before > 0.008
        assert after < 0.4 * before


@pytest.mark.parametrize(("speed", "above"), [(3.0, 1.0), (0.1, 500 / (0.1 / STEP_12_BITS))])
def test_noise_in_the_band_of_the_motion_is_that_of_rounding(speed, above):
    """Just above, the motion's spectrum goes on; rounding of slow motion is in fewer frequencies."""
    f = np.arange(0.5, 500.0, 0.5)
    level = STEP_12_BITS**2 / 12 / 500
    motion = np.where(f < 8.0, (f < 8.0) * speed**2 / (2 * np.pi * f) ** 2 / 0.5 / np.sum(f < 8.0), 0.0)
    noise = np.where(f < 40.0, 50.0, 1.0) * level
    made = Spectrum(f, motion, noise, STEP_12_BITS, 8.0).of_rounding()
    assert made.noise.max() == pytest.approx(above * level, rel=0.01)
    np.testing.assert_array_equal(made.noise[f >= 40.0], noise[f >= 40.0])
    unknown = Spectrum(f, motion, noise, 0.0, 8.0)
    assert unknown.of_rounding() is unknown
