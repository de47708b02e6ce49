"""Bias by the position filter: subtracted where a device has springs, uncertain where it is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import haptid
from elastic_motors import TRUTH, K, axis, recorded
from haptid.treatment_choice import with_treatment_uncertainty
from haptid.treatment_choice.noise_effect import without_bias


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


def test_of_an_estimate_with_inequalities_all_of_the_bias_is_uncertain(narrow):
    plain, proposal = narrow
    less, uncertain = without_bias(plain, proposal.effects)
    held = replace(plain, constrained_fit=object())
    same, whole = without_bias(held, proposal.effects)
    assert same is held
    np.testing.assert_allclose(plain.beta - less.beta, whole["position filter"][0])
    np.testing.assert_allclose(uncertain["position filter"], 0.5 * whole["position filter"])
    assert uncertain["encoder noise"] is whole["encoder noise"]


def test_a_device_without_springs_keeps_its_estimate(narrow):
    _, proposal = narrow
    terms = [{"kind": kind, "joints": "all"} for kind in ("rotor-inertia", "viscous")]
    rigid, log = axis(terms=terms), recorded(seconds=12.0)
    channels = haptid.Channels(haptid.Signal(("theta",), "rad"), log.channels.torque, "t")
    motor = replace(log, position=np.ascontiguousarray(log.position[:, 1:]), channels=channels)
    found = haptid.estimate(haptid.observe(rigid, haptid.treat(motor, proposal.treatment)), haptid.WLS())
    effects = {"position filter": np.ones((1, len(found.beta)))}
    assert without_bias(found, effects)[0] is found
