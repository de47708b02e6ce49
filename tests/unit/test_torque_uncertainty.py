"""Standard error of an estimate's torque in other motion, and the status by it."""

import dataclasses
import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, stats
from test_proposal import recorded

import haptid
from haptid.estimation.estimate import Estimate, judged
from haptid.estimation.torque_uncertainty import other_motion, torque_uncertainty
from haptid.treatment_choice.delay_estimate import COMMON, HOLD, OWN, likely_delays

TREATMENT = haptid.Treatment(
    cutoff_hz=20.0, parallel_cutoff_hz=8.0, decimation=15, reversal_speed=0.05, reversal_guard_s=0.01
)


@pytest.fixture(scope="module")
def phantom():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def fitted(model, log):
    return haptid.estimate(haptid.observe(model, haptid.treat(log, TREATMENT)), haptid.WLS())


def test_it_is_the_size_of_the_torque_s_error_in_the_other_motion(phantom):
    """Over noise in the torque, by which alone these logs differ."""
    clean = recorded(phantom, step=0.0)
    exact = fitted(phantom, clean).beta
    rng, squares, said = np.random.default_rng(5), [], []
    for _ in range(12):
        noise = 0.05 * clean.torque.std(axis=0) * rng.standard_normal(clean.torque.shape)
        made = fitted(phantom, dataclasses.replace(clean, torque=clean.torque + noise))
        W = other_motion(made.observation)
        squares.append(1e4 * np.sum((W @ (made.beta - exact)) ** 2) / len(made.observation.motors))
        said.append(made.torque_uncertainty**2)
    spread = np.std(squares, ddof=1) / np.sqrt(len(squares))
    assert abs(np.mean(squares) - np.mean(said)) < 4 * spread


def test_it_does_not_depend_on_the_unit_of_a_parameter(phantom):
    made = fitted(phantom, recorded(phantom, noise=0.02))
    W, C = other_motion(made.observation), made.covariance
    D = np.diag(np.geomspace(1e-3, 1e3, len(C)))
    again = torque_uncertainty(made.observation, D @ C @ D, W @ np.linalg.inv(D))
    assert again == pytest.approx(made.torque_uncertainty, rel=1e-9)


def test_the_status_follows_the_torque_and_not_the_condition_number(phantom, monkeypatch):
    told = fitted(phantom, recorded(phantom, noise=0.01))
    assert told.status == "ok"
    assert told.torque_uncertainty < 3
    loud = fitted(phantom, recorded(phantom, noise=3.0, seconds=8.0))
    assert loud.observation.condition[1] < 2 * told.observation.condition[1]
    assert loud.status == "uncertain"
    assert loud.torque_uncertainty > 3
    assert any("torque of other motion" in note for note in loud.notes)
    monkeypatch.setattr(Estimate, "torque_uncertainty", 9331.2)
    assert any("error is 9331 % of the measured torque" in note for note in judged(replace(loud)).notes)


@pytest.mark.parametrize(("off", "se"), [(0.4, 0.3), (2.0, 0.8), (-0.8, 1.5), (3.0, 0.1)])
def test_delays_are_those_of_the_mixture_of_priors(off, se):
    """One channel against quadrature of the posterior; `off` and `se` are those under the wide prior alone."""
    dt, wide = 1e-3, COMMON**2 + OWN**2
    precision = 1 / se**2 - 1 / wide
    likelihood = stats.norm(off / se**2 / precision, precision**-0.5)

    def posterior(x):
        close = stats.norm(0, np.hypot(0.5, OWN)).pdf(x)
        return likelihood.pdf(x) * (2 / 3 * close + 1 / 3 * stats.norm(0, wide**0.5).pdf(x))

    mass, first, second = (
        integrate.quad(lambda x, k=k: x**k * posterior(x), -20, 20, points=[0, likelihood.mean()], limit=200)[0]
        for k in range(3)
    )
    mean, covariance = likely_delays(dt * np.array([off]), (dt * se) ** 2 * np.eye(1), dt)
    assert mean[0] / dt == pytest.approx(first / mass, abs=1e-6)
    assert covariance[0, 0] / dt**2 == pytest.approx(second / mass - (first / mass) ** 2, rel=1e-5)


def test_a_delay_that_the_log_tells_is_hardly_moved():
    off = np.array([2.5, 2.6])
    mean, covariance = likely_delays(1e-3 * off, 1e-6 * 0.02**2 * np.eye(2), 1e-3)
    assert np.abs(mean / 1e-3 - off).max() < 0.02 * 0.2
    assert HOLD == 0.5
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 2e-5, rtol=0.02)


def test_a_channel_that_hardly_moves_does_not_decide_the_status(phantom):
    """It made 37 of 5 % on a public log: any uncertainty is a large share of no torque."""
    log = recorded(phantom, noise=0.01)
    alive = fitted(phantom, log)
    torque = log.torque.copy()
    torque[:, 2] = 1e-4 * torque[:, 2].std() * np.random.default_rng(0).standard_normal(len(torque))
    dead = fitted(phantom, dataclasses.replace(log, torque=torque))
    W = other_motion(dead.observation)
    assert torque_uncertainty(dead.observation, dead.covariance, W) > 10 * dead.torque_uncertainty
    own = W.reshape(3, -1, W.shape[1])[:2].reshape(-1, W.shape[1])
    square = np.einsum("ij,jk,ik->", own, dead.covariance, own) / 2
    assert dead.torque_uncertainty == pytest.approx(100 * np.sqrt(square))
    every = torque_uncertainty(alive.observation, alive.covariance, other_motion(alive.observation))
    assert alive.torque_uncertainty == pytest.approx(every)


def test_a_gap_has_no_acceleration(phantom):
    """Velocities on both sides of a gap are not a sample apart."""
    log, many = recorded(phantom, noise=0.02), 20
    ends = np.linspace(0, len(log.t), many + 1).astype(int)
    kept = [np.arange(a, b - 400) for a, b in itertools.pairwise(ends)]
    edges = np.cumsum([0, *map(len, kept)])
    rows = np.concatenate(kept)
    gone = dataclasses.replace(
        log,
        t=log.t[rows],
        position=log.position[rows],
        torque=log.torque[rows],
        segments=tuple(itertools.pairwise(edges.tolist())),
    )
    known = [np.linalg.norm(other_motion(fitted(phantom, own).observation), axis=0) for own in (log, gone)]
    assert (known[1] < 2 * known[0]).all()
