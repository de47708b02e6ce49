"""Sampling periods counted by the motion: a queue between device and recorder, and what must not be taken for one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptid.log import Channels, Log, Signal, read_log
from haptid.log.sample_counts import count_steps

MANY, PERIOD = 4000, 1e-3


def motion(t: np.ndarray) -> np.ndarray:
    """Positions of three joints, (times, 3), rad."""
    return np.stack([np.sin(3 * t), 0.7 * np.cos(2.1 * t + 0.3), 0.5 * np.sin(1.3 * t) + 0.2 * t], axis=-1)


def queue(rng: np.random.Generator, late: float, rows: int = MANY) -> np.ndarray:
    """Sample that each row of a polling recorder holds, (rows,): the latency changes now and then by whole periods."""
    jumps = rng.random(rows) < late
    latency = np.cumsum(jumps * rng.choice([-1, 1, 2, 6], rows, p=[0.6, 0.3, 0.05, 0.05]))
    held = np.arange(rows) + 20 - np.maximum(latency, 0)
    return np.maximum.accumulate(np.maximum(held, 0))


def read(folder: Path, held: np.ndarray, counts: float, **time: float) -> Log:
    """The rows that a recorder has written, with positions of an encoder."""
    q = np.round(motion(held * PERIOD) / counts) * counts
    torque = np.cos(3 * held * PERIOD) + 1e-3 * np.random.default_rng(5).normal(size=held.max() + 1)[held]
    path = folder / "log.npz"
    np.savez(path, t=np.arange(MANY) * PERIOD, q=q, tau=torque)
    channels = Channels(Signal(("q[1]", "q[2]", "q[3]"), "rad"), Signal("tau", "N m"), **(time or {"time": "t"}))
    return read_log(path, channels)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31), late=st.floats(0.02, 0.1))
def test_steps_of_a_queue_are_counted(seed: int, late: float) -> None:
    rng = np.random.default_rng(seed)
    held = queue(rng, late)
    q = motion(held * PERIOD) + 1e-5 * rng.normal(size=(MANY, 3))
    found = count_steps(q.T, [(0, MANY)], MANY)
    assert found is not None
    assert found.clear.mean() > 0.9
    # Where most rows of a tenth of a second repeat, the speed is known from a few steps only.
    assert np.mean(found.periods[found.clear] != np.diff(held)[found.clear]) < 2e-3


@pytest.mark.parametrize("rate", [False, True])
def test_positions_of_a_queue_come_back(tmp_path: Path, rate: bool) -> None:
    held = queue(np.random.default_rng(2), 0.06)
    log = read(tmp_path, held, 1e-5, **({"rate_hz": 1 / PERIOD} if rate else {}))
    assert log.time_base.method == "counted"
    assert "whole sampling periods" in " ".join(log.time_base.sentences)
    assert log.dt == pytest.approx(PERIOD, rel=5e-3)  # the latency changes by up to 20 ms in 4 s
    inner = slice(50, -50)
    off = np.asarray(log.position)[inner] - motion((held[0] + np.arange(len(log.t))[inner]) * PERIOD)
    as_stamped = motion(held * PERIOD) - motion(held[0] * PERIOD + np.arange(MANY) * PERIOD)
    assert np.abs(off).max() < 4e-5
    assert np.abs(as_stamped).max() > 5e-3


@pytest.mark.parametrize(("skipped", "share"), [(40, 0.0), (400, 1 / 11)])
def test_rows_that_are_numbered_keep_their_step(tmp_path: Path, skipped: int, share: float) -> None:
    """Stamps that count the rows of a loop that is late at times; but a slower recorder has its own clock."""
    steps = np.ones(MANY, dtype=int)
    steps[np.random.default_rng(4).choice(MANY, skipped, replace=False)] = 2
    log = read(tmp_path, np.cumsum(steps) - 1, 1e-5)
    assert log.time_base.method == "counted"
    assert log.dt == pytest.approx(PERIOD * (1 - share), rel=1e-3)
    assert ("count the rows" in " ".join(log.time_base.sentences)) == (share == 0.0)


def test_regular_samples_are_left_alone(tmp_path: Path) -> None:
    for counts in (1e-6, 1e-3, 6e-3):
        log = read(tmp_path, np.arange(MANY), counts)
        assert log.time_base.method == "regular"
        assert len(log.t) == MANY


def test_vibration_and_glitches_are_no_periods() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(MANY) * PERIOD
    vibrating = motion(t) + 1e-3 * np.sin(2 * np.pi * 180 * t)[:, None]
    assert count_steps(vibrating.T, [(0, MANY)], MANY) is None
    glitches = motion(t) + 5e-3 * (rng.random((MANY, 3)) < 1e-3)
    found = count_steps(glitches.T, [(0, MANY)], MANY)
    assert found is None or np.mean(found.periods[found.clear] != 1) < 2e-3


def test_rest_between_moves_is_no_repeated_row() -> None:
    """Six moves there and back at the rate of a slow recorder, a few rows each, and long rest."""
    for seed in range(42):
        rng = np.random.default_rng(seed)
        pieces = [np.zeros(35)]
        for _ in range(6):
            share = np.clip((np.arange(5) + rng.uniform()) / 4.2, 0, 1)
            there = np.diff(np.round(200 * (1 - np.cos(np.pi * share))), prepend=0.0)
            pieces += [there, np.zeros(int(rng.integers(0, 2))), -there, np.zeros(int(rng.integers(20, 45)))]
        q = np.cumsum(np.concatenate(pieces))
        assert count_steps([q], [(0, q.size)], q.size) is None


def read_long(folder: Path, first: int, last: int) -> str:
    """How the times of 150 000 rows are found, of which rows first..last are from a queue, 0 to 3 periods late."""
    held = np.arange(150_000)
    steps = np.random.default_rng(3).choice([-1, 0, 1], last - first, p=[0.06, 0.88, 0.06])
    late = np.abs((np.cumsum(steps) + 3) % 6 - 3)
    held[first:last] = np.maximum.accumulate(held[first:last] - late)
    t = np.arange(len(held)) * PERIOD
    np.savez(folder / "log.npz", t=t, q=np.round(motion(held * PERIOD) / 1e-5) * 1e-5, tau=np.cos(3 * t))
    channels = Channels(Signal(("q[1]", "q[2]", "q[3]"), "rad"), Signal("tau", "N m"), time="t")
    return read_log(folder / "log.npz", channels).time_base.method


@pytest.mark.parametrize(("first", "last"), [(0, 150_000), (91_200, 98_200), (17_500, 24_500)])
def test_a_long_log_of_a_queue_is_counted_as_a_short_one(tmp_path: Path, first: int, last: int) -> None:
    assert read_long(tmp_path, first, last) == "counted"


def test_of_a_long_log_with_true_stamps_only_pieces_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted: list[int] = []

    def noted(positions, spans, rows):
        counted.append(rows)
        return count_steps(positions, spans, rows)

    monkeypatch.setattr("haptid.log.row_times.count_steps", noted)
    assert read_long(tmp_path, 0, 0) == "regular"
    assert len(counted) == 1
    assert counted[0] < 150_000 / 7


@pytest.mark.parametrize("seed", range(4))
def test_an_encoder_that_sticks_is_no_queue(tmp_path: Path, seed: int) -> None:
    """The other joint is slow in these moments; the log was resampled, with an error of up to 193 % of the torque."""
    rng, t = np.random.default_rng(seed), np.arange(MANY) * PERIOD
    q = np.stack([0.02 * np.sin(3 * t), np.cos(5.1 * t + 0.3)], axis=-1)
    q = 1e-5 * np.round(q / 1e-5)
    for start in rng.integers(0, MANY - 60, 12):
        q[start : start + 50, 1] = q[start, 1]
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=rng.normal(size=(MANY, 2)))
    channels = Channels(Signal(("q[1]", "q[2]"), "rad"), Signal(("tau[1]", "tau[2]"), "N m"), time="t")
    log = read_log(tmp_path / "log.npz", channels)
    assert "periods" not in " ".join(log.time_base.sentences)
    np.testing.assert_array_equal(np.asarray(log.position), q)


@pytest.mark.parametrize("seed", range(3))
def test_an_only_encoder_that_sticks_while_torques_go_on_is_no_queue(tmp_path: Path, seed: int) -> None:
    """Of one joint no other position says that time goes on, but the torque does; a queue holds both."""
    rng, t = np.random.default_rng(seed), np.arange(MANY) * PERIOD
    q = 1e-5 * np.round(np.cos(5.1 * t + 0.3) / 1e-5)
    held = np.arange(MANY)
    for start in 60 * rng.choice(MANY // 60, 25, replace=False):
        held[start : start + 18] = start
    channels = Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t")
    for name, tau, method in (
        ("stuck", rng.normal(size=MANY), "regular"),
        ("queue", rng.normal(size=MANY)[held], None),
    ):
        np.savez(tmp_path / f"{name}.npz", t=t, q=q[held], tau=tau)
        log = read_log(tmp_path / f"{name}.npz", channels)
        said = " ".join(log.time_base.sentences)
        if method:
            assert log.time_base.method == method
            assert "stale" not in said
            np.testing.assert_array_equal(np.asarray(log.position)[:, 0], q[held])
        else:
            assert "hold an earlier sample" in said
