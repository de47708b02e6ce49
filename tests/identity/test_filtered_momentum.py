"""Rows without accelerations are the filtered rows with them, on smooth motion, throughout the pipeline."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import haptid
from haptid.motion.filters import Causal, HighPass
from haptid.observation import plan as planning
from haptid.validation.prediction import predict
from mechanisms import mechanisms
from motions import motion, multisine, truth

DT = 1e-3
PLAIN = {"cutoff_hz": None, "formulation": "momentum"}
MOMENTUM = [
    haptid.Treatment(decimation=10, **PLAIN),
    haptid.Treatment(parallel_cutoff_hz=10.0, parallel_shape=Causal(), **PLAIN),
    haptid.Treatment(parallel_cutoff_hz=15.0, parallel_shape=Causal(3), decimation=5, **PLAIN),
]


def windows(signals, taps, step):
    return np.lib.stride_tricks.sliding_window_view(signals, len(taps), axis=-1)[..., ::step, :] @ taps


@settings(max_examples=25, deadline=None)
@given(mechanisms(most=6), st.sampled_from(MOMENTUM))
def test_filtered_rows_are_the_same_with_and_without_accelerations(mechanism, treatment):
    """To what Tustin's rule leaves out, (omega dt)^2 / 12, or differences of order eight and a filter's ripple."""
    q, qd, qdd = multisine(mechanism.coordinates, 1.0, DT, seed=2, size=0.4)
    core, none = mechanism.core(), np.zeros((0, q.shape[1]))
    columns, shared = list(range(10 * len(mechanism.parent))), treatment.parallel_filter(DT)
    wanted = windows(core.regressor(q, qd, qdd, none, columns), shared.taps, 10)
    momentum, rest = core.momentum_regressor(q, qd, none, columns)
    made = windows(momentum, shared.slope, 10) + windows(rest, shared.taps, 10)
    sizes = np.maximum(np.abs(wanted).max(axis=(0, 2)), 1e-3 * np.abs(wanted).max() + 1e-12)
    tolerance = 1e-9 if not isinstance(treatment.parallel_shape, Causal) else 2e-3
    np.testing.assert_allclose(made / sizes[:, None], wanted / sizes[:, None], rtol=0, atol=tolerance)


@pytest.mark.parametrize("treatment", MOMENTUM)
@pytest.mark.parametrize("name", ["phantom_premium_15", "cea_medical_branch", "staubli_tx40", "emps"])
def test_known_parameters_come_back_without_accelerations(name, treatment):
    """Closed chains, rotors, coupled motors, friction: exact rates, exact torque."""
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = np.random.default_rng(0).uniform(0.5, 1.5, len(model.base))
    made = motion(model, beta, seconds=12.0, dt=DT, treatment=treatment)
    found = haptid.estimate(haptid.observe(model, made), haptid.OLS())
    exact = not isinstance(treatment.parallel_shape, Causal)  # Tustin's rule is not, by (omega dt)^2 / 12
    np.testing.assert_allclose(found.beta, beta, rtol=1e-10 if exact else 1e-2)
    assert haptid.fit_errors(found).relative < (1e-10 if exact else 5e-3)


RAW = haptid.Treatment(
    velocity=HighPass(40.0),
    parallel_cutoff_hz=10.0,
    parallel_shape=Causal(),
    decimation=5,
    reversal_speed=0.05,
    **PLAIN,
)


@pytest.mark.parametrize("treatment", [*MOMENTUM, RAW])
def test_segments_give_what_the_whole_gives(treatment, monkeypatch):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    beta = truth(model)
    made = replace(motion(model, beta, treatment=treatment, noise=0.05), rates=None)
    whole = haptid.observe(model, made)
    prediction = predict(haptid.estimate(whole, haptid.OLS()), made)
    monkeypatch.setattr(planning, "SEGMENT", 700)
    cut = haptid.observe(model, made)
    for a, b in zip(whole.motors, cut.motors, strict=True):
        np.testing.assert_allclose(a.r_factors, b.r_factors, rtol=0, atol=1e-12 * np.abs(a.r_factors).max())
        np.testing.assert_array_equal(a.rows, b.rows)
    again = predict(haptid.estimate(whole, haptid.OLS()), made)
    np.testing.assert_allclose(again.predicted, prediction.predicted, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(again.used, prediction.used)


@pytest.mark.parametrize("treatment", [*MOMENTUM, RAW])
def test_prediction_is_the_rows_times_the_parameters(treatment):
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    made = replace(motion(model, truth(model), treatment=treatment, noise=0.05), rates=None)
    seen = haptid.observe(model, made)
    found = haptid.estimate(seen, haptid.OLS())
    prediction = predict(found, made)
    for k, motor in enumerate(seen.motors):
        counts = prediction.used[k]
        assert counts.sum() == motor.rows.sum()
        error = (prediction.measured - prediction.predicted)[k][counts]
        assert np.linalg.norm(error) == pytest.approx(motor.residual(found.beta), rel=1e-9)
    low, high = made.usable
    shared = treatment.parallel_filter(DT)
    assert prediction.t[0] == pytest.approx(DT * (low + shared.before))
    assert prediction.t[-1] <= DT * (high - 1 - shared.after) + 1e-12


def test_rows_near_slow_motion_are_those_behind_it_where_the_filter_is_causal():
    """A joint that stands still for a while: only rows whose main part reaches back to it are dropped."""
    model = haptid.DynamicModel(haptid.read_device("emps"))
    t = DT * np.arange(6000)
    still = (t > 2.0) & (t < 2.5)
    q = np.cumsum(np.where(still, 0.0, 0.3)) * DT
    treatment = haptid.Treatment(
        cutoff_hz=None,
        reversal_speed=0.05,
        formulation="momentum",
        parallel_cutoff_hz=10.0,
        parallel_shape=Causal(),
        decimation=5,
    )
    made = haptid.Motion(DT, q[:, None], np.ones((6000, 1)), treatment)
    plan = planning.Plan.of(model, made)
    weights = plan.weights(0, plan.rows)[0]
    dropped = DT * (plan.first + 5 * np.flatnonzero(weights == 0))
    assert 1.99 < dropped.min() < 2.02
    assert 2.5 + 5 / (2 * np.pi * 10) < dropped.max() < 2.5 + 10 / (2 * np.pi * 10)
