"""Known parameters lie inside the intervals of every estimator that weights rows: a small version of the benchmarks."""

from dataclasses import replace

import numpy as np
import pytest

import haptid
from haptid.estimation import (
    GLS,
    IRLS,
    SUR,
    Bounds,
    Classical,
    EqualityConstraints,
    FixedB,
    Heteroscedastic,
    Huber,
    Sandwich,
)
from motions import motion, truth

DEVICE = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
BETA = truth(DEVICE)
RUNS = 5


def inside(method, intervals=None, phi=0.9):
    """Share of intervals that hold the truth, over all parameters and a few runs; exact ones left out."""
    clean, held = motion(DEVICE, BETA, seconds=10.0, dt=2e-3), []
    for seed in range(RUNS):
        noisy = motion(DEVICE, BETA, seconds=10.0, dt=2e-3, noise=0.1, phi=phi, seed=1)
        rng = np.random.default_rng(seed)
        noise = np.roll(noisy.tau - clean.tau, rng.integers(500, 4500, 1), axis=0) * rng.choice([-1.0, 1.0], 3)
        made = haptid.observe(DEVICE, replace(clean, tau=clean.tau + noise))
        found = haptid.estimate(made, method, intervals)
        low, high = found.conf_int().T
        held.append(((low <= BETA) & (high >= BETA))[found.se > 1e-12])
    return np.mean(np.concatenate(held))


@pytest.mark.parametrize(
    "method",
    [
        SUR(),
        GLS(),
        IRLS(),
        IRLS(Huber()),
        Heteroscedastic(),
        EqualityConstraints({"FC1": float(BETA[DEVICE.base.names.index("FC1")])}),
        Bounds({"FC1": (0.0, None)}),
    ],
    ids=lambda method: method.name,
)
def test_the_truth_is_inside_the_intervals(method):
    assert inside(method) > 0.85


@pytest.mark.parametrize("intervals", [FixedB(), Sandwich()], ids=lambda kind: kind.name)
def test_it_is_inside_the_others_too(intervals):
    assert inside(haptid.WLS(), intervals) > 0.8


def test_of_whitened_rows_the_classical_is_right_and_of_weighted_ones_far_too_narrow():
    assert inside(GLS(), Classical()) > 0.8
    assert inside(haptid.WLS(), Classical()) < 0.75
