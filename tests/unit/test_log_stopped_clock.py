"""Logs whose clock stands still for a while, without a gap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.log import Channels, Log, Signal, read_log
from haptid.log.stopped_clock import running_times

N, STEP, FIRST, STOPPED = 2000, 0.004, 800, 150
T = np.arange(N) * STEP
Q = np.sin(3 * T) + 0.3 * np.cos(8 * T)
CHANNELS = Channels(Signal(("q",), "rad"), Signal(("tau",), "N m"), time="t")


def log_of(tmp_path: Path, stamps: np.ndarray, q: np.ndarray = Q) -> Log:
    path = tmp_path / "log.csv"
    table = np.column_stack((stamps, q, q + np.cos(5 * T)))
    np.savetxt(path, table, delimiter=",", header="t,q,tau", comments="", fmt="%.9f")
    return read_log(path, CHANNELS)


def stopped(crawl: float = 0.0) -> np.ndarray:
    steps = np.full(N - 1, STEP)
    steps[FIRST : FIRST + STOPPED] = crawl
    return np.concatenate(([0.0], np.cumsum(steps)))


@pytest.mark.parametrize("crawl", [0.0, 1e-6])
def test_rows_of_a_stopped_clock_keep_their_step(tmp_path: Path, crawl: float) -> None:
    log = log_of(tmp_path, stopped(crawl))
    assert log.rate_hz == pytest.approx(1 / STEP, rel=1e-6)
    assert log.t[-1] == pytest.approx(T[-1])
    np.testing.assert_allclose(log.position[:, 0], Q, atol=1e-6)
    assert any(f"stands still over {STOPPED} rows, first at t = 3.2 s" in str(note) for note in log.notes)


def test_with_jitter_too(tmp_path: Path) -> None:
    jitter = np.random.default_rng(1).uniform(-0.1, 0.1, N) * STEP
    log = log_of(tmp_path, np.maximum.accumulate(stopped() + jitter))
    assert log.rate_hz == pytest.approx(1 / STEP, rel=2e-3)


def test_a_clock_that_catches_up_is_none(tmp_path: Path) -> None:
    stamps = T.copy()
    stamps[FIRST : FIRST + STOPPED] = stamps[FIRST]  # written late, in one go
    log = log_of(tmp_path, stamps)
    assert not any("stands still" in str(note) for note in log.notes)
    groups = np.where(T < 5, T, T[(np.arange(N) // 40) * 40])  # rows that are sent together, with one stamp
    times, said = running_times(groups, lambda: (Q,))
    assert times is groups
    assert not said


def test_rows_in_which_nothing_moves_are_no_stopped_clock(tmp_path: Path) -> None:
    q = Q.copy()
    q[FIRST : FIRST + STOPPED + 1] = Q[FIRST] + 1e-6 * np.arange(STOPPED + 1)
    assert not any("stands still" in str(note) for note in log_of(tmp_path, stopped(), q).notes)


@pytest.mark.parametrize(("share", "noise"), [(0.2, 0.0), (0.05, 0.02)])
def test_a_burst_of_rows_at_a_higher_rate_is_no_stopped_clock(share: float, noise: float) -> None:
    """Also where the joint is the fastest there, or where noise is most of what it moves by from row to row."""
    steps = np.full(N - 1, STEP)
    steps[FIRST : FIRST + STOPPED] = share * STEP
    t = np.concatenate(([0.0], np.cumsum(steps)))
    middle = t[FIRST + STOPPED // 2]
    q = np.tanh(3 * (t - middle)) + 0.5 * t + noise * np.random.default_rng(1).standard_normal(N)
    times, said = running_times(t, lambda: (q,))
    assert times is t
    assert not said
