"""Known targets come back: exactly without noise, and inside their own intervals with it."""

import numpy as np
import pytest

import haptid
from haptid.inference.targets import target_map, targets
from motions import motion, truth


@pytest.fixture(scope="module")
def model():
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def test_without_noise_they_come_back_exactly(model):
    beta = truth(model)
    found = targets(haptid.estimate(haptid.observe(model, motion(model, beta)), haptid.OLS()))
    np.testing.assert_allclose(found.value, target_map(model) @ beta, rtol=1e-8)


def test_the_papers_own_column_comes_back_in_units_of_command(model):
    """A device whose fourteen parameters are those of Table I, Normal, shows them again to four decimals."""
    normal = [0.0039, 0.0037, -0.0011, 0.0019, 0.0057, 0.0026, -0.0525, -0.3002,
              -0.0057, -0.0035, -0.0005, 0.0707, 0.0251, 0.0248]  # fmt: skip
    beta = np.linalg.solve(target_map(model), np.array(normal) / 2.73)
    made = motion(model, beta, seconds=20.0, noise=0.01)
    command = targets(haptid.estimate(haptid.observe(model, made), haptid.WLS())).in_command()
    np.testing.assert_allclose(command.value, normal, atol=2e-4)


def test_intervals_hold_the_truth_about_95_times_in_100(model):
    beta = truth(model)
    wanted = target_map(model) @ beta
    runs, inside = 40, 0
    for run in range(runs):
        made = motion(model, beta, seconds=10.0, seed=run, noise=0.1, phi=0.95)
        low, high = targets(haptid.estimate(haptid.observe(model, made), haptid.WLS())).conf_int().T
        inside += int(((low <= wanted) & (wanted <= high)).sum())
    assert 0.90 < inside / (runs * len(wanted)) < 0.99
