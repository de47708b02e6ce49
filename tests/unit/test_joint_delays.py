"""Delays that are estimated from the rows of an estimate: its covariance is that of both together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import haptid
from elastic_motors import axis, recorded
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.intervals.clusters import Clusters
from haptid.estimation.intervals.covariance import with_prior_variance
from haptid.treatment_choice.delay_estimate import delay_prior, delay_problem, find_delays
from haptid.treatment_choice.uncertainty import with_delay_uncertainty

SETTINGS = haptid.Treatment(cutoff_hz=80.0, decimation=10, parallel_cutoff_hz=16.0)


@pytest.fixture(scope="module")
def found():
    """The elastic axis: the delay of its log, and the estimate that it is compensated in."""
    log = recorded(seed=2, seconds=20.0)
    delays = find_delays(axis(), [log], SETTINGS)
    treated = haptid.treat(log, replace(SETTINGS, torque_delay_s=delays.setting))
    return haptid.estimate(haptid.observe(axis(), treated), haptid.WLS()), delays


def test_standard_errors_are_those_of_a_fit_with_the_delay_as_a_parameter(found):
    estimate, delays = found
    problem = delay_problem(estimate.model, estimate.observation.motions, estimate.free)
    p = len(estimate.beta)
    both = clustered(problem.rows, problem.weights, problem._solution(np.zeros(1), delay_prior(1, delays.dt)))
    made = with_delay_uncertainty(estimate, delays)
    np.testing.assert_allclose(made.se, np.sqrt(np.diag(both.covariance))[:p], rtol=0.03)
    np.testing.assert_allclose(np.sqrt(np.diag(made.spread(np.eye(p)).covariance)), made.se)


def test_the_damping_counts_the_delay_once(found):
    """Errors of these rows move damping and delay so that both parts of the damping's error nearly cancel."""
    estimate, delays = found
    k = estimate.names.index("DE1")
    alone, together = (with_delay_uncertainty(estimate, replace(delays, samples=n)).se[k] for n in (0, delays.samples))
    assert together < 0.9 * alone


def test_another_estimate_takes_over_what_the_delay_moves(found):
    """Of the same rows the scores, of other rows the size."""
    estimate, delays = found
    made = with_delay_uncertainty(estimate, delays)
    np.testing.assert_allclose(estimate.with_nuisances_of(made).se, made.se)
    log = recorded(seed=3, seconds=20.0)
    other = haptid.estimate(haptid.observe(axis(), haptid.treat(log, SETTINGS)), haptid.WLS())
    moved = made.fit.moved
    expected, _ = with_prior_variance(other.covariance, other.dof, np.eye(len(other.beta)), moved)
    expected = expected + made.shifts.T @ made.shifts
    np.testing.assert_allclose(other.with_nuisances_of(made).covariance, expected, rtol=1e-9, atol=1e-12)


def test_errors_of_the_model_are_told_from_the_residual_alone(found, tmp_path):
    """The part of the delay has one direction, in which groups of like blocks differed more than blocks."""
    estimate, delays = found
    made = with_delay_uncertainty(estimate, delays)
    assert made.clusters.misfit == pytest.approx(estimate.clusters.misfit)
    assert np.abs(made.clusters.s - estimate.clusters.s).max() > 0.1
    made.clusters.save(tmp_path / "clusters.npz")
    assert Clusters.load(tmp_path / "clusters.npz").misfit == pytest.approx(made.clusters.misfit)
