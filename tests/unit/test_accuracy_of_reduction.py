"""Exact torque of known parameters comes back from the triangles as well as the condition of the motion allows."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from motions import multisine, truth
from small_study import two_links

CONDITION = 1e6


def observed(size: float, decimation: int) -> tuple[np.ndarray, haptid.Observation]:
    """True parameters, and the rows of a motion of some size without noise, with exact rates."""
    model = two_links()
    beta = truth(model) + 0.1
    q, qd, qdd = multisine(2, 10.0, 1e-3, 3, size)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    treatment = haptid.Treatment(cutoff_hz=None, decimation=decimation)
    return beta, haptid.observe(model, haptid.Motion(1e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T)))


def of_condition(decimation: int) -> tuple[np.ndarray, haptid.Observation]:
    """The smaller the motion, the worse it tells parameters apart: halve it until it is as bad as wanted."""
    size = 0.5
    beta, observation = observed(size, decimation)
    while observation.condition[0] < CONDITION:
        size *= 0.7
        beta, observation = observed(size, decimation)
    return beta, observation


@pytest.mark.parametrize("decimation", [1, 8])
def test_a_solution_at_condition_1e6_has_ten_digits(decimation: int) -> None:
    beta, observation = of_condition(decimation)
    assert CONDITION <= observation.condition[0] < 10 * CONDITION
    for method in (haptid.OLS(), haptid.WLS()):
        found = haptid.estimate(observation, method).beta
        assert np.linalg.norm(found - beta) <= 1e-10 * np.linalg.norm(beta)
    # Normal equations square the condition: they would be far off.
    W, y = observation.stack()[:, :-1], observation.stack()[:, -1]
    squared = np.linalg.solve(W.T @ W, W.T @ y)
    assert np.linalg.norm(squared - beta) > 1e-10 * np.linalg.norm(beta)
