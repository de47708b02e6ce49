"""Planned motions behind a treatment and coloured noise: against explicit covariances, and logs of the bench."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from test_sequential import NOISE, campaign, identified  # noqa: F401

import haptid
from haptid.estimation.intervals.model_based import Autoregression, burg
from haptid.experiment import bench
from haptid.experiment.excitation import observed_motion
from haptid.experiment.excitation.treated import TreatedNoise
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk
from haptid.results.information import log_information
from haptid.results.tables import treatment, treatment_of
from small_study import FRICTION, two_links
from true_parameters import true_parameters

# A residual whose next value is 0.8 times the last plus a white one: short beside the motion.
MEMORY = 0.8
RED = Autoregression((np.array([1.0, -MEMORY]),), np.array([1.0]))
VARIANCE = 1 / (1 - MEMORY**2)
DT = 4e-3
FILTERED = haptid.Treatment(decimation=5, reversal_speed=0.1, torque_delay_s=0.01, cutoff_hz=20.0)
KIND = bench.Multisine(8.0, (0.0, 0.5), (0.9, 0.8), speed=(2.0, 2.0))


def planned(dt):
    return bench.plan(KIND, two_links(), dt, np.random.default_rng(3))


def treated_rows(model):
    """Rows of the motion as a log without delay has them, dropped ones zero: W of each motor, (motors, rows, p)."""
    made, plain = planned(DT), replace(FILTERED, cutoff_hz=None, torque_delay_s=0.0)
    motion = haptid.Motion(DT, made.q, np.zeros_like(made.q), plain, rates=(made.qd, made.qdd))
    plan = Plan.of(model, motion)
    return Chunk.of(plan, 0, plan.rows).W


def test_covariance_is_that_of_least_squares_under_the_noise():
    model = two_links()
    W = treated_rows(model)
    assert 0 < np.mean(~W.any(axis=2)) < 0.5  # some rows are dropped
    variances = np.array([VARIANCE, 4 * VARIANCE])
    models = (RED, replace(RED, powers=np.array([4.0])))
    S = toeplitz(VARIANCE * MEMORY ** np.arange(W.shape[1]))
    A = sum(w.T @ w / v for w, v in zip(W, variances, strict=True))
    M = sum(w.T @ (v / VARIANCE * S) @ w / v**2 for w, v in zip(W, variances, strict=True))
    wanted = np.linalg.inv(A) @ M @ np.linalg.inv(A)
    found = TreatedNoise(FILTERED, DT, models, tuple(variances)).information(model, planned)
    np.testing.assert_allclose(np.linalg.inv(found), wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())


def test_without_filter_and_correlation_it_is_that_of_the_rows():
    model, plain = two_links(), haptid.Treatment(cutoff_hz=None)
    made = planned(DT)
    motion = haptid.Motion(DT, made.q, np.zeros_like(made.q), plain, rates=(made.qd, made.qdd))
    R = haptid.observe(model, motion).stack(np.array([2.0, 1.0]))[:-1, :-1]
    white = tuple(Autoregression((np.ones(1),), np.array([v])) for v in (0.25, 1.0))
    found = TreatedNoise(plain, DT, white, (0.25, 1.0)).information(model, planned)
    np.testing.assert_allclose(found, R.T @ R, rtol=1e-8, atol=1e-9 * np.abs(found).max())


def test_a_motion_shorter_than_the_filter_has_no_information():
    model, slow = two_links(), haptid.Treatment(decimation=1500, cutoff_hz=None)
    found = TreatedNoise(slow, DT, (RED, RED), (VARIANCE, VARIANCE)).information(model, planned)
    assert found.shape == (len(model.base),) * 2
    assert not found.any()


@pytest.mark.parametrize(
    "settings",
    [
        haptid.Treatment(cutoff_hz=None, decimation=3, parallel_shape=haptid.motion.filters.WindowedSinc()),
        haptid.Treatment((20.0, 30.0), reversal_speed=(0.1, 0.2), torque_delay_s=(1e-3, 2e-3), rest_speed=0.01),
        haptid.Treatment(
            cutoff_hz=None,
            formulation="momentum",
            velocity=haptid.motion.filters.HighPass(30.0),
            parallel_shape=haptid.motion.filters.Causal(2),
            parallel_cutoff_hz=5.0,
        ),
    ],
)
def test_a_treatment_comes_back_from_its_settings(settings):
    assert treatment_of(treatment(settings)) == settings


def test_a_result_has_the_serial_correlation_of_its_residuals(campaign):  # noqa: F811
    _, first = campaign
    found = log_information(first).treated
    assert found.treatment.decimation == 5
    assert found.dt == pytest.approx(DT)
    for model, variance, table in zip(found.models, found.variances, first.residuals, strict=True):
        fit = next(m for m in first.fit_errors[0].motors if m.motor == table.motor)
        assert np.sqrt(variance) == pytest.approx(fit.residual / np.sqrt(fit.rows), rel=0.05)
        whole = model.spectrum(1 << 14)
        assert np.mean(whole) == pytest.approx(variance, rel=0.02)  # the model has the residual's power


def test_a_result_of_an_earlier_version_has_none(campaign):  # noqa: F811
    _, first = campaign
    assert log_information(first.model_copy(update={"residuals": []}, deep=False)).treated is None


def test_burg_finds_the_correlation_that_a_result_would_have():
    rng = np.random.default_rng(0)
    e = np.zeros(20_000)
    for k in range(1, len(e)):
        e[k] = MEMORY * e[k - 1] + rng.normal()
    found = burg([e], 20)
    assert found.filters[-1][1] == pytest.approx(-MEMORY, abs=0.03)


def noisy(kind, seed):
    """Times, positions and torques of the true parameters with red noise, as a recorder without flaws has them."""
    model = two_links()
    made = bench.plan(kind, model, DT, np.random.default_rng(3))
    rng, chi = np.random.default_rng(seed), true_parameters(model, **FRICTION)
    e = lfilter([1.0], [1.0, -MEMORY], NOISE * rng.normal(size=(len(made) + 100, 2)), axis=0)[100:]
    tau = haptid.inverse_dynamics(model, model.base.of(chi), made.q.T, made.qd.T, made.qdd.T).T
    return made.t, made.q, tau + e


def test_standard_errors_are_those_found_and_of_white_noise_are_not(tmp_path):
    """Of a motion after a first log, against the errors along it in eighty draws of red noise."""
    t, q, tau = noisy(KIND, 0)
    columns = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]}
    pyarrow.csv.write_csv(pa.table(columns), tmp_path / "first.csv")
    known = log_information(identified(tmp_path, "first.csv"))
    model, other = known.model, replace(KIND, centre=(0.3, 0.2), seconds=12.0, speed=(0.9, 1.6))
    errors = []
    for seed in range(1, 81):
        t, q, tau = noisy(other, seed)
        channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), haptid.Signal(("a", "b"), "N m"), time="t")
        log = haptid.Log(Path("made"), "", t, q, tau, channels)
        found = haptid.estimate(haptid.observe(model, haptid.treat(log, known.treated.treatment)), haptid.WLS())
        errors.append(found.beta - model.base.of(true_parameters(model, **FRICTION)))
    scatter = np.std(errors, axis=0)
    own = known.treated.information(model, lambda dt: bench.plan(other, model, dt, np.random.default_rng(3)))
    treated = np.log(np.sqrt(np.diag(np.linalg.inv(own))) / scatter)
    made = bench.plan(other, model, 0.04, np.random.default_rng(3))
    R = observed_motion(model, made).stack(1 / (known.noise * np.sqrt(1 / 0.04)))[:-1, :-1]
    white = np.log(known.factor * np.sqrt(np.diag(np.linalg.inv(R.T @ R))) / scatter)
    assert np.abs(treated).max() < 0.4
    assert np.sqrt(np.mean(treated**2)) < 0.6 * np.sqrt(np.mean(white**2))
