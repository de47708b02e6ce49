"""Drift between the clocks of torques and positions is found, and not where there is none."""

from __future__ import annotations

import numpy as np
import pytest

import haptid
from haptid.log.channel_clocks import ClockDrift, clock_drift
from motions import truth

N, DT = 20_000, 2e-3


def drift_of(steps: float, seed: int, delay: float = 1.0, fading: float = 0.0) -> ClockDrift | None:
    """Of a device whose torques come later by a delay that grows by so many steps.

    Args:
        steps: growth over the log.
        seed: of motion and noise.
        delay: at the start, steps.
        fading: share by which the motion becomes smaller towards the end.
    """
    rng, t = np.random.default_rng(seed), np.arange(N) * DT
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    omega, angle = 2 * np.pi * rng.uniform(0.2, 2.0, (3, 5, 1)), rng.uniform(0, 2 * np.pi, (3, 5, 1))
    size = 0.12 / (omega / 6) ** 0.7 * (1 - fading * t / t[-1])

    def motion(at: np.ndarray) -> list[np.ndarray]:
        return [np.sum(size * omega**k * np.sin(omega * at + angle + 0.5 * np.pi * k), axis=1) for k in range(3)]

    step = 2 * np.pi / 2**14
    q = step * np.round(motion(t)[0] / step)
    tau = haptid.inverse_dynamics(model, truth(model), *motion(t - DT * (delay + steps * t / t[-1])))
    tau += 0.01 * tau.std(axis=1, keepdims=True) * rng.normal(size=tau.shape)
    return clock_drift(q.T, tau.T, ((0, N),), DT)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("steps", [-4.0, 3.0])
def test_a_drift_is_found_with_its_sign(steps: float, seed: int) -> None:
    found = drift_of(steps, seed)
    assert found is not None
    assert 0.3 < found.seconds / (steps * DT) < 1.1


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("fading", [0.0, 0.8])
def test_a_constant_delay_is_no_drift(seed: int, fading: float) -> None:
    assert drift_of(0.0, seed, delay=3.0, fading=fading) is None


def test_a_short_log_says_nothing() -> None:
    x = np.random.default_rng(0).normal(size=(300, 1))
    assert clock_drift(x, x, ((0, 300),), DT) is None


def test_a_slow_move_of_all_joints_is_no_drift() -> None:
    """The weight of a chain depends on sums of its angles, which the columns of single joints lack."""
    t = np.arange(5000) * 1e-3
    s = t**2 / 25
    q = np.column_stack([1.6 * s, 1.5 * s, 1.4 * s]) + 5e-6 * np.random.default_rng(1).normal(size=(t.size, 3))
    total = np.cumsum(q, axis=1)
    tau = 9.81 * np.cumsum(np.cos(total)[:, ::-1], axis=1)[:, ::-1]
    assert clock_drift(q, tau, ((0, t.size),), 1e-3) is None
