"""Errors in W asked with instruments of the simulated closed loop: who gives the controller, size and power."""

from dataclasses import replace
from functools import cache

import numpy as np

import haptid
from haptid import estimation
from haptid.inference.diagnosis import diagnose
from haptid.inference.diagnosis.exogeneity import controller_of, instruments
from haptid.inference.diagnosis.finding import SIGNIFICANCE
from haptid.simulation import PID
from small_study import KD, KP, between, driven, log_of, two_links

DT, RUNS = 4e-3, 6
CALM, POOR = (
    haptid.Treatment(cutoff_hz=15, decimation=10, torque_delay_s=DT / 2, reversal_speed=0.1),
    haptid.Treatment(cutoff_hz=50, torque_delay_s=DT / 2, reversal_speed=0.1),
)


@cache
def recorded():
    """Exact positions, what was planned, and commands."""
    return driven(3, 8.0, noise=0.0)


def estimated(seed, counts, treatment, method=None):
    """From a reading with its own noise of the torque, and encoders of so many counts a turn."""
    exact, rng = log_of(recorded()), np.random.default_rng(seed)
    step = 2 * np.pi / counts
    zero = rng.uniform(0, 1, 2)
    position = step * (np.round(exact.position / step + zero) - zero)
    log = replace(exact, position=position, torque=exact.torque + 0.02 * rng.standard_normal(position.shape))
    return haptid.estimate(haptid.observe(two_links(), haptid.treat(log, treatment)), method or haptid.WLS())


@cache
def law():
    made = recorded()
    return PID(KP, KD, reference=(made.target[between(made)],), velocity_cutoff_hz=50)


def test_without_errors_in_the_columns_it_reports_nothing():
    """Size: chance alone speaks up once in a hundred logs."""
    p = [diagnose(estimated(k, 1e7, CALM), controller=law())["errors in W"].figures["p"] for k in range(RUNS)]
    assert sum(x < SIGNIFICANCE for x in p) <= 1
    assert max(p) > 0.2


def test_coarse_encoders_are_seen():
    """Power: 2000 counts, differentiated up to 50 Hz without a filter for torque and columns."""
    found = [diagnose(estimated(k, 2000, POOR), controller=law())["errors in W"] for k in range(2)]
    assert all(finding.status != "ok" for finding in found)
    assert all("simulated closed loop" in finding.sentence for finding in found)


def test_an_instrumental_estimate_brings_its_own():
    method = haptid.PhysicallyConsistent(estimation.IV(law()))
    assert controller_of(method) is law()
    assert controller_of(haptid.WLS()) is None
    found = diagnose(estimated(1, 1e7, CALM, method))["errors in W"]
    assert found.status == "ok"
    assert "simulated closed loop" in found.sentence
    assert "narrower filter" in diagnose(estimated(1, 1e7, CALM))["errors in W"].sentence


def test_a_model_that_runs_away_leaves_the_filter():
    made = estimated(1, 1e7, CALM)
    wild = PID((-6e5, -3e5), KD, reference=law().reference)
    assert "filter" in instruments(made, wild).left
    assert "filter" in instruments(made, PID((1.0, 2.0, 3.0), 1.0)).left
