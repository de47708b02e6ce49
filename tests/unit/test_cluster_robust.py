"""The default intervals: time blocks of all motors as clusters, against the same from whole rows in memory."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

import haptid
from haptid.estimation import BlockJackknife, ClusterRobust, Ridge
from haptid.estimation.block_moments import Adjustment
from haptid.observation.rows import Rows
from motions import motion, truth
from sampling import of_mean


def weighted_clusters(observation, weights):
    """W and y of every time block, all motors under one another, with their weights."""
    (rows,) = Rows(observation)
    parts = [slice(a, b) for a, b in zip(rows.edges, rows.edges[1:], strict=False)]
    W = [np.concatenate([w * motor[part] for w, motor in zip(weights, rows.W, strict=True)]) for part in parts]
    y = [np.concatenate([w * motor[part] for w, motor in zip(weights, rows.y, strict=True)]) for part in parts]
    return W, y


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


@pytest.fixture(scope="module")
def rows(model):
    return haptid.observe(model, motion(model, truth(model), seconds=6.0, dt=5e-3, noise=0.1, phi=0.9))


@pytest.mark.parametrize("method", [haptid.WLS(), Ridge(strength=1.0)], ids=["free", "with a prior"])
def test_it_is_the_cr2_of_whole_rows(rows, method):
    """Residuals of a block times (1 - H)^-1/2 of its own rows, as Bell and McCaffrey write it."""
    found = haptid.estimate(rows, method)
    W, y = weighted_clusters(rows, found.weights)
    root, pull = found.fit.solution.root, found.fit.solution.pull
    bread = root @ root.T
    believed = 0.0 if pull is None else root @ pull.T @ pull @ root.T
    asked, adjusted = [], []
    for w, own in zip(W, y, strict=True):
        values, vectors = np.linalg.eigh(np.eye(len(w)) - w @ bread @ w.T)
        adjusted.append((vectors * values**-0.5) @ vectors.T)
        asked.append(bread @ w.T @ adjusted[-1] @ (own - w @ found.beta))
    expected = np.array(asked).T @ np.array(asked) + believed
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).min())
    if pull is not None:
        return
    # Its degrees of freedom, from the matrix of all rows that Pustejovsky and Tipton write. Blocks that carry little of
    # a direction are summed to the second order of what they carry: 1e-3 is left out here at most.
    whole = np.concatenate(W)
    annihilator = np.eye(len(whole)) - whole @ bread @ whole.T
    ends = np.cumsum([0, *map(len, W)])
    for k in range(len(found.beta)):
        G = np.zeros((len(whole), len(W)))
        for g, (w, A) in enumerate(zip(W, adjusted, strict=True)):
            G[ends[g] : ends[g + 1], g] = A @ w @ bread[k]
        P = G.T @ annihilator @ G
        assert found.dof[k] == pytest.approx(np.trace(P) ** 2 / (P**2).sum(), rel=2e-3)


@pytest.mark.parametrize("size", [0.02, 0.3, 0.9])
def test_light_blocks_are_summed_to_the_same(size):
    """The series and the eigenvalues agree."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(5, 4, 4))
    G = A @ A.transpose(0, 2, 1)
    G *= size / np.linalg.norm(G, axis=(1, 2))[:, None, None]
    s = rng.normal(size=(5, 4))
    expected = [np.linalg.solve(linalg.sqrtm(np.eye(4) - g).real, v) for g, v in zip(G, s, strict=True)]
    np.testing.assert_allclose(Adjustment.of(G).times(s), expected, rtol=1e-10)


def test_nuisances_of_the_same_rows_move_scores_alone(rows):
    """A fit with other nuisances shares what they do not change, and is what it is without sharing."""
    fit = haptid.estimate(rows, haptid.WLS()).fit
    first, second = 1e-3 * np.random.default_rng(0).normal(size=(2, len(rows.blocks), len(fit.solution.beta)))
    moved = fit.with_moved(first).with_moved(second)
    assert moved.pooled_moments.adjustment is fit.pooled_moments.adjustment
    for shared, own in ((moved, replace(fit, moved=second)), (moved.with_moved(None), replace(fit))):
        got, wanted = ClusterRobust().spread(shared), ClusterRobust().spread(own)
        np.testing.assert_array_equal(got.covariance, wanted.covariance)
        np.testing.assert_array_equal(got.dof, wanted.dof)
    assert not np.allclose(moved.pooled_moments.s, fit.pooled_moments.s)


def test_of_white_rows_the_variance_is_unbiased(model):
    """What the fit has taken off the residuals is given back: no other of its kind is right for few blocks."""
    beta = truth(model)
    clean = motion(model, beta, seconds=6.0, dt=5e-3)
    rng, ratios = np.random.default_rng(0), []
    for _ in range(60):
        noisy = replace(clean, tau=clean.tau + 0.05 * clean.tau.std(axis=0) * rng.standard_normal(clean.tau.shape))
        found = haptid.estimate(haptid.observe(model, noisy), haptid.WLS())
        ratios.append(np.mean(np.diag(found.covariance) / np.diag(found.classical_covariance)))
    assert np.mean(ratios) == pytest.approx(1.0, abs=of_mean(np.array(ratios)))


def test_what_motors_share_is_in_the_interval():
    """One disturbance that moves all motors: leaving out one motor at a time does not see that they agree."""
    model = haptid.DynamicModel(haptid.read_device("arm3"))
    beta = truth(model)
    clean = motion(model, beta, seconds=10.0, dt=5e-3)
    rng, errors, kinds = np.random.default_rng(0), [], (ClusterRobust(), BlockJackknife())
    variances = {kind.name: [] for kind in kinds}
    for _ in range(150):
        common = rng.standard_normal((len(clean.tau), 1)) + 0.3 * rng.standard_normal(clean.tau.shape)
        noisy = replace(clean, tau=clean.tau + 0.1 * clean.tau.std(axis=0) * common)
        found = haptid.estimate(haptid.observe(model, noisy), haptid.WLS())
        errors.append(found.beta - beta)
        for kind in kinds:
            variances[kind.name].append(np.diag(kind.spread(found.fit).covariance))
    true = np.mean(np.square(errors), axis=0)
    together, apart = (np.mean(variances[kind.name], axis=0) / true for kind in kinds)
    assert together.min() > 0.6
    assert together.max() < 1.6
    assert apart.min() < 0.6 or apart.max() > 1.6
