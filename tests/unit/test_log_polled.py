"""A recorder that polls a slower source: one row of each sample is kept, and the motion comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from haptid.log import Channels, Log, Signal, read_log

SLOW, FAST = 100.0, 1000.0


def polled(folder: Path, seed: int, late_s: float, rest_s: float = 0.0, stamps: bool = True, **more: str) -> Log:
    """A motion sampled at 100 Hz, which a recorder reads at 1 kHz; samples arrive up to `late_s` late."""
    rng = np.random.default_rng(seed)
    taken = np.arange(0, 12, 1 / SLOW)
    arrived = np.maximum.accumulate(taken + rng.uniform(0, late_s, taken.size))
    moved = np.clip(taken - rest_s, 0, None)
    q = np.column_stack([np.sin(2 * np.pi * 0.5 * moved), 0.5 * np.sin(2 * np.pi * 0.8 * moved)])
    tau = np.column_stack([np.sin(2 * np.pi * 0.3 * moved + 1), np.sin(2 * np.pi * 0.7 * moved)])
    t = np.arange(0.02, 11.9, 1 / FAST)
    row = np.searchsorted(arrived, t, side="right") - 1
    path = folder / "log.npz"
    np.savez(path, t=t, q=q[row], tau=tau[row])
    time = {"time": "t"} if stamps else {"rate_hz": FAST}
    return read_log(
        path, Channels(Signal(("q[1]", "q[2]"), "rad"), Signal(("tau[1]", "tau[2]"), "N m"), **time, **more)
    )  # type: ignore[arg-type]


@pytest.mark.parametrize("stamps", [True, False])
@pytest.mark.parametrize("late_s", [0.0, 0.004])
def test_one_row_of_each_sample_is_kept(tmp_path: Path, late_s: float, stamps: bool) -> None:
    log = polled(tmp_path, 1, late_s, stamps=stamps)
    assert log.rate_hz == pytest.approx(SLOW, rel=2e-3)
    assert "90 % of the rows hold the sample of the row before: the recorder writes some 10 rows" in " ".join(log.notes)
    t = log.t + 0.02  # times count from the first row
    # Samples are seen half of the usual lateness late, and to a row: what is left over is far below a sample's step.
    late = min(
        float(np.abs(log.position[50:-50, 0] - np.sin(np.pi * (t[50:-50] - d))).max())
        for d in np.arange(-1e-3, late_s + 2e-3, 2.5e-4)
    )
    assert late < 0.2 * np.pi / SLOW


def test_rest_in_a_polled_log_is_no_gap(tmp_path: Path) -> None:
    log = polled(tmp_path, 2, 0.0, rest_s=3.0)
    assert len(log.segments) == 1
    assert log.t.size == pytest.approx(11.88 * SLOW, rel=0.01)
    np.testing.assert_allclose(log.position[: int(2.9 * SLOW)], 0.0, atol=1e-3)  # a spline rings where motion begins


def test_repeats_are_kept_where_asked_for(tmp_path: Path) -> None:
    log = polled(tmp_path, 3, 0.0, stale="keep")
    assert log.rate_hz == pytest.approx(FAST)


def test_coarse_encoders_in_slow_motion_are_no_polling(tmp_path: Path) -> None:
    """Steps of one count at even times, with torques of few levels that repeat with them."""
    t = np.arange(0, 8, 1 / FAST)
    q = np.floor(np.abs((t % 4) - 2) * 100) * 2 * np.pi / 4096
    path = tmp_path / "log.npz"
    np.savez(path, t=t, q=q, tau=np.floor(20 * q) + 0.1)
    log = read_log(path, Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t"))
    assert log.rate_hz == pytest.approx(FAST)
    assert not any("hold the sample" in note for note in log.notes)
