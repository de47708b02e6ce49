"""Recovery of known bodies by constrained estimates, inside their intervals."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.estimation import PhysicallyConsistent
from motions import motion
from true_parameters import true_parameters


@pytest.mark.parametrize("name", ["phantom_premium_15", "sr400", "arm7"])
def test_without_noise_they_come_back(name):
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = model.base.of(true_parameters(model))
    observation = haptid.observe(model, motion(model, beta, seconds=20.0, dt=4e-3))
    found = haptid.estimate(observation, PhysicallyConsistent(haptid.OLS()))
    np.testing.assert_allclose(found.beta, beta, rtol=1e-6, atol=1e-8 * np.abs(beta).max())
    assert found.feasible.ok


def test_the_held_estimate_is_nearer_to_the_truth_than_the_free_one():
    """The truth is possible, so in the metric of the weighted rows projection cannot lead away from it."""
    model = haptid.DynamicModel(haptid.read_device("arm7"))
    beta = model.base.of(true_parameters(model))
    made = motion(model, beta, seconds=10.0, dt=4e-3, noise=0.3, phi=0.9)
    found = haptid.estimate(haptid.observe(model, made), PhysicallyConsistent())
    R = found.observation.stack(found.weights)[:-1, :-1]
    far = [np.linalg.norm(R @ (guess - beta)) for guess in (found.constrained_fit.free, found.beta)]
    assert found.constrained_fit.active
    assert far[1] < far[0]


def test_intervals_hold_the_truth_on_the_border_too():
    """40 runs with hardly any viscous friction: about half of the free estimates are negative, and are held."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    chi = true_parameters(model, FV=1e-6)
    beta, names = model.base.of(chi), model.base.names
    clean = motion(model, beta, seconds=10.0, dt=2e-3)
    runs, inside, held = 40, np.zeros(len(beta)), 0
    for run in range(runs):
        noise = np.random.default_rng(run).standard_normal(clean.tau.shape) * 0.1 * clean.tau.std(axis=0)
        made = replace(clean, tau=clean.tau + noise)
        found = haptid.estimate(haptid.observe(model, made), PhysicallyConsistent())
        low, high = found.conf_int().T
        inside += (low <= beta) & (beta <= high)
        held += bool(found.constrained_fit.active)
        assert (low[[names.index(f"FV{k}") for k in (1, 2, 3)]] >= 0).all()
    assert held > runs / 2
    assert 0.92 < inside.sum() / (runs * len(beta)) <= 1.0
    assert inside.min() >= 0.8 * runs
