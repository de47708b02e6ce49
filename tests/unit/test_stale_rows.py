"""Stale rows: found where they are, and never where motion is slow, encoders coarse, or a device at rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from haptid.log.stale import LONGEST_RUN, find_stale, smallest_step

N = 8000
QUICK = settings(max_examples=40, deadline=None)


def same(block: np.ndarray) -> np.ndarray:
    return np.append(False, (np.diff(block, axis=1) == 0).all(axis=0))


def found(q: np.ndarray, tau: np.ndarray):
    return find_stale(same(q), same(tau), lambda: iter(q), lambda: iter(tau))


def motion(kind: str, rate: float, joints: int, rng: np.random.Generator) -> np.ndarray:
    """Positions in rad, (joints, N)."""
    t = np.arange(N) / rate
    frequency = {"slow": 0.05, "plain": 1.0, "paused": 1.0, "rest": 0.0}[kind] * rng.uniform(0.7, 1.3, (joints, 1))
    q = rng.uniform(0.2, 1.0, (joints, 1)) * np.sin(2 * np.pi * frequency * t + rng.uniform(0, 6, (joints, 1)))
    if kind == "paused":
        q[:, N // 3 : N // 2] = q[:, N // 3, None]
    return q


@QUICK
@example(0, "slow", 200.0, 1, 14, "spring", 1.5)  # noise that happens to go one way was taken for fast motion
@example(18, "slow", 1000.0, 1, 16, "spring", 1.5)  # repeats that no motion catches up on, with torques that follow
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["slow", "plain", "paused", "rest"]),
    st.sampled_from([200.0, 1000.0, 4000.0]),
    st.integers(1, 3),
    st.integers(9, 20),
    st.sampled_from(["noise", "spring", "rounded", "steps"]),
    st.sampled_from([0.0, 0.5, 1.5]),
)
def test_clean_logs_have_none(
    seed: int, kind: str, rate: float, joints: int, bits: int, torque: str, flicker: float
) -> None:
    rng = np.random.default_rng(seed)
    step = 2 * np.pi / 2**bits
    q = motion(kind, rate, joints, rng)
    q = step * np.round(q / step + flicker * rng.normal(size=q.shape))
    noisy = q + 0.02 * rng.normal(size=q.shape)
    tau = {"noise": noisy, "spring": -3.0 * q, "rounded": 0.01 * np.round(noisy / 0.01), "steps": np.sign(noisy)}
    assert found(q, tau[torque]) is None


@QUICK
@example(507, 0.25, 12, True, False)  # most slow repeats are stale rows: torques were taken to follow the positions
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.4), st.integers(12, 20), st.booleans(), st.booleans())
def test_rows_of_a_polling_recorder_are_found(seed: int, share: float, bits: int, fine: bool, paused: bool) -> None:
    rng = np.random.default_rng(seed)
    step = 2 * np.pi / 2**bits
    q = step * np.round(motion("paused" if paused else "plain", 500.0, 3, rng) / step)
    tau = 2 * q + 0.02 * rng.normal(size=q.shape)
    if not fine:
        tau = 0.004 * np.round(tau / 0.004)
    old = rng.random(N) < share
    old[0] = False
    row = np.maximum.accumulate(np.where(old, 0, np.arange(N)))
    stale = found(q[:, row], tau[:, row])
    assert stale is not None
    truth = row == np.append(-1, row[:-1])
    rest = paused & (np.arange(N) >= N // 3) & (np.arange(N) < N // 2 + LONGEST_RUN)
    recognised = truth & ~rest & (fine | stale.moving)
    # Slow parts of a motion hide the repeats of coarse torques: no rule finds these.
    assert (stale.position & recognised).sum() >= 0.9 * recognised.sum()
    assert (stale.position & ~truth).sum() <= 0.002 * N
    np.testing.assert_array_equal(stale.torque & recognised, stale.position & recognised)


def test_a_slow_torque_channel_alone() -> None:
    """Torques at half the rate of the positions: every other one repeats, and only these are dropped."""
    rng = np.random.default_rng(1)
    q = motion("plain", 500.0, 2, rng)
    tau = np.repeat(rng.normal(size=(2, N // 2)), 2, axis=1)
    stale = found(q, tau)
    assert stale is not None
    assert not stale.position.any()
    np.testing.assert_array_equal(stale.torque, np.arange(N) % 2 == 1)


def test_few_repeats_of_exact_torques_are_stale_and_those_at_a_limit_are_not() -> None:
    """Torques of many digits do not repeat by chance, so that fewer repeats of them count than of positions."""
    rng = np.random.default_rng(1)
    q = motion("plain", 500.0, 1, rng)
    tau = 2 * q + 0.02 * rng.normal(size=q.shape)
    old = np.append(False, rng.random(N - 1) < 0.02)
    row = np.maximum.accumulate(np.where(old, 0, np.arange(N)))
    stale = found(q, tau[:, row])
    assert stale is not None
    assert not stale.position.any()
    assert (stale.torque & old).sum() >= 0.9 * old.sum()
    assert not (stale.torque & ~old).any()
    assert found(q, np.clip(tau, -np.inf, np.quantile(tau, 0.96))) is None


def test_longer_repeats_are_rest() -> None:
    rng = np.random.default_rng(1)
    tau = np.repeat(rng.normal(size=(1, N // (2 * LONGEST_RUN))), 2 * LONGEST_RUN, axis=1)
    q = motion("plain", 500.0, 1, rng)[:, : tau.shape[1]]
    assert found(q, tau) is None


@pytest.mark.parametrize("bits", [8, 12, 16, 20])
def test_the_count_of_an_encoder(bits: int) -> None:
    step = 2 * np.pi / 2**bits
    q = motion("plain", 1000.0, 1, np.random.default_rng(bits))[0]
    assert smallest_step(step * np.round(q / step)) == pytest.approx(step, rel=1e-6) or bits == 20
