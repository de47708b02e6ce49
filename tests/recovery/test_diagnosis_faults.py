"""Each fault is found by the look that is for it, on encoder logs treated as proposed; clean logs raise few doubts.

Small versions of benchmarks/diagnosis.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import haptid
from diagnosed import coulomb, estimated, log, phantom
from haptid.inference.diagnosis import diagnose
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from motions import multisine, truth

RUNS = 5


@pytest.mark.parametrize("phi", [0.0, 0.95])
def test_clean_logs_raise_few_doubts(phi):
    """Some 17 looks at one per cent each: about two doubts in twelve logs, and hardly ever worse."""
    found = [diagnose(estimated(log(seed, phi=phi))) for seed in range(100, 104)]
    tests = [f for each in found for f in each.findings if "p" in f.figures]
    assert sum(f.status != "ok" for f in tests) <= 0.06 * len(tests)
    severe = [f for f in tests if f.status == "bad" and f.name != "time delay"]
    assert len(severe) <= stats.binom.ppf(0.999, len(tests), SIGNIFICANCE)


def test_stribeck_friction_that_the_model_lacks_is_found():
    found = [diagnose(estimated(log(seed, stribeck=0.25))) for seed in range(RUNS)]
    hits = [each["friction near standstill"].status == "bad" for each in found]
    # Clusters of independent length leave fewer degrees of freedom: in 5 logs a power of 0.9 may miss two.
    assert sum(hits) >= stats.binom.ppf(0.01, RUNS, 0.9)
    assert "Stribeck" in found[0]["friction near standstill"].sentence
    assert "near standstill" not in found[0].verdict.sentences[0]


@pytest.mark.parametrize("seed", [1, 2])
def test_half_a_sample_of_delay_is_found_and_measured(seed):
    made = log(seed, late=0.5)
    finding = diagnose(estimated(made))["time delay"]
    assert finding.status == "bad"
    for k in (1, 2, 3):
        half = finding.figures[f"half_width motor {k}"]
        assert finding.figures[f"delay motor {k}"] == pytest.approx(5e-4, abs=2 * half + 2e-5)
    treatment = haptid.propose(phantom(), made, torque_delay_s=0.0).treatment
    other = haptid.treatment_choice.find_delays(phantom(), [made], treatment)
    assert finding.figures["delay motor 1"] == pytest.approx(other.found[0], abs=6e-5 + 3 * other.se[0])


@pytest.mark.parametrize("seed", [1, 2])
def test_friction_that_differs_by_direction_is_found_and_measured(seed):
    finding = diagnose(estimated(log(seed, offset=0.05)))["friction by direction"]
    assert finding.status == "bad"
    seen = [k for k in (1, 2, 3) if finding.figures[f"p motor {k}"] < SIGNIFICANCE]
    assert seen
    sizes = [finding.figures[f"size motor {k}"] / coulomb()[k - 1] for k in seen]
    # Only significant ones are looked at, which are the larger ones.
    np.testing.assert_allclose(sizes, 0.05, rtol=0.5)


def test_a_wrong_gear_and_a_wrong_sign_are_named():
    wrong = diagnose(estimated(log(1, gains=(1.0, 2.73, 1.0))))["units and signs"]
    assert wrong.status == "bad"
    # As near as causes are told apart; a rotor's inertia is estimated jointly.
    assert wrong.figures["factor motor 2"] == pytest.approx(2.73, rel=0.15)
    assert "gear ratio" in wrong.sentence
    turned = diagnose(estimated(log(1, gains=(1.0, 1.0, -1.0))))["units and signs"]
    assert "a sign is wrong" in turned.sentence
    assert "motor 3" in turned.sentence


def test_parameters_that_the_motion_leaves_dark_are_named_with_what_would_show_them():
    model = phantom()
    q, qd, qdd = multisine(3, 20.0, 1e-3, 1)
    q[0], qd[0], qdd[0] = 1e-3 * q[0], 1e-3 * qd[0], 1e-3 * qdd[0]
    tau = haptid.inverse_dynamics(model, truth(model), q, qd, qdd)
    tau = (tau + 0.01 * tau.std(axis=1, keepdims=True) * np.random.default_rng(0).standard_normal(tau.shape)).T
    made = haptid.Motion(1e-3, q.T, tau, haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
    finding = diagnose(haptid.estimate(haptid.observe(model, made), haptid.WLS()))["excitation"]
    assert finding.status != "ok"
    assert "FV1" in finding.sentence
    assert "motor 1" in finding.sentence


def test_positions_without_a_filter_are_errors_in_w():
    made = log(3)
    motion = haptid.treat(made, haptid.Treatment(cutoff_hz=100.0))
    finding = diagnose(haptid.estimate(haptid.observe(phantom(), motion), haptid.WLS()))["errors in W"]
    assert finding.status == "bad"
    assert finding.figures["bias"] > 1


def test_a_touch_is_found_at_its_second():
    made = log(3)
    torque = made.torque.copy()
    torque[9000:9500] += torque.std(axis=0)
    finding = diagnose(estimated(replace(made, torque=torque)))["influence"]
    assert finding.status == "bad"
    assert finding.figures["start"] < 9.5 < finding.figures["stop"] + 0.5


def test_friction_that_goes_as_the_device_warms_is_a_drift():
    finding = diagnose(estimated(log(3, seconds=36.0, warming=0.4)))["drift"]
    assert finding.status == "doubt"
    assert "FC1" in finding.sentence
