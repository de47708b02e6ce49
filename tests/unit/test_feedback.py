"""Disturbances that move a device in its loop are seen in its acceleration, noise of a torque channel is not."""

from __future__ import annotations

import numpy as np
import pytest

from haptid.treatment_choice.feedback import feeds_back

DT, BANDWIDTH = 2e-3, 1.5


def controlled(
    disturbance: float, sensor: float, seed: int = 0, seconds: float = 20.0
) -> tuple[np.ndarray, np.ndarray]:
    """Position and command of a mass of 1 kg that a controller moves along sines, (1, n) each."""
    rng, n = np.random.default_rng(seed), round(seconds / DT)
    t = np.arange(n) * DT
    reference, rate = (sum(a * f(w * t) for a, w, f in waves) for waves in _waves())
    x, v, command, seen = 0.0, 0.0, np.zeros(n), np.zeros(n)
    for k in range(n):
        seen[k] = x + sensor * rng.normal()
        command[k] = 2000 * (reference[k] - x) + 80 * (rate[k] - v)
        v += DT * (command[k] + disturbance * rng.normal())
        x += DT * v
    return seen[None], command[None]


def _waves():
    return [
        [(1.0, 2 * np.pi * f, np.sin) for f in (0.5, 1.0, 1.5)],
        [(2 * np.pi * f, 2 * np.pi * f, np.cos) for f in (0.5, 1.0, 1.5)],
    ]


def test_a_disturbance_in_the_loop_is_seen():
    assert feeds_back(*controlled(20.0, 0.0), DT, BANDWIDTH)


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_a_torque_channel_is_not(seed):
    q, u = controlled(0.0, 1e-5, seed)
    rng = np.random.default_rng(seed)
    assert not feeds_back(q, u + rng.normal(size=u.shape), DT, BANDWIDTH)


def test_coarse_positions_hide_it_and_short_logs_tell_nothing():
    q, u = controlled(20.0, 0.05)
    assert not feeds_back(q, u, DT, BANDWIDTH)
    assert not feeds_back(q[:, :60], u[:, :60], DT, BANDWIDTH)
    assert not feeds_back(np.zeros((1, 5000)), np.zeros((1, 5000)), DT, BANDWIDTH)


def test_the_motor_behind_any_channel_is_found():
    q, u = controlled(20.0, 0.0)
    still = np.random.default_rng(1).normal(size=q.shape)
    assert feeds_back(np.vstack([still, q]), np.vstack([u, still]), DT, BANDWIDTH)
