"""Time base: a motion comes back from irregular, rounded, repeated and missing stamps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import signal

from haptid import errors
from haptid.log import Channels, Log, Signal, read_log, row_times
from haptid.log.spectrum import spectra
from haptid.log.survey import survey

QUICK = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def record(
    folder: Path,
    t: np.ndarray,
    unit: str = "s",
    rate_hz: float | None = None,
    time_range: tuple[float, float] | None = None,
    taken: np.ndarray | None = None,
) -> Log:
    """Read a motion of 1 rad at 1 Hz that was sampled at `taken` (s; the stamps where None) and stamped t."""
    real = np.asarray(t, dtype=float) if taken is None else taken
    path = folder / "log.npz"
    np.savez(path, t=t, q=np.sin(2 * np.pi * real), tau=np.cos(2 * np.pi * real))
    time = {"rate_hz": rate_hz} if rate_hz else {"time": "t", "time_unit": unit}
    return read_log(path, Channels(Signal("q", "rad"), Signal("tau", "N m"), **time), time_range)  # type: ignore[arg-type]


def error(log: Log, start: float = 0.0) -> tuple[float, float]:
    """Largest error of position and of torque against the motion on the log's own grid."""
    t = log.t + start
    return (
        float(np.abs(log.position[:, 0] - np.sin(2 * np.pi * t)).max()),
        float(np.abs(log.torque[:, 0] - np.cos(2 * np.pi * t)).max()),
    )


@QUICK
@given(seed=st.integers(0, 2**32 - 1), jitter=st.floats(1e-2, 0.12), rate=st.sampled_from([200.0, 1000.0, 333.3]))
def test_a_sine_with_irregular_stamps_is_recovered(tmp_path: Path, seed: int, jitter: float, rate: float) -> None:
    n = 1000
    t = (np.arange(n) + np.random.default_rng(seed).uniform(-jitter, jitter, n)) / rate
    t -= t[0]
    log = record(tmp_path, t)
    h = 2 * np.pi / rate
    assert max(error(log)) < 4 * h**4
    assert "irregular" in log.notes[0]
    assert log.t.size == n
    np.testing.assert_allclose(np.diff(log.t), log.dt, rtol=1e-9)
    assert log.t[-1] == pytest.approx(t[-1], rel=1e-12)


def test_irregular_stamps_of_a_long_log_go_piece_by_piece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    t = (np.arange(3000) + np.random.default_rng(0).uniform(-0.1, 0.1, 3000)) / 1000
    t -= t[0]
    whole = record(tmp_path, t)
    monkeypatch.setattr("haptid.log.read.SAMPLES_RESAMPLED", 256)
    pieces = record(tmp_path, t)
    np.testing.assert_allclose(pieces.position, whole.position, rtol=0, atol=1e-14)
    np.testing.assert_allclose(pieces.torque, whole.torque, rtol=0, atol=1e-14)


def test_regular_stamps_leave_the_samples_alone(tmp_path: Path) -> None:
    t = np.arange(5000) * 0.0002 + 12.5
    log = record(tmp_path, t)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * t))
    assert log.notes == ("times count from the file's first stamp, 12.5 s",)
    assert log.t[0] == 0


@pytest.mark.parametrize(("unit", "per_second"), [("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_units_of_time(tmp_path: Path, unit: str, per_second: float) -> None:
    log = record(tmp_path, np.arange(500) * 0.01 * per_second, unit, taken=np.arange(500) * 0.01)
    assert log.rate_hz == pytest.approx(100, rel=1e-12)


def test_stamps_that_would_come_too_fast_are_doubted(tmp_path: Path) -> None:
    """A header of a public recording says ms of times in s: it was identified at 1 MHz without a word."""
    made, right = (record(tmp_path, np.arange(500) * 0.001, unit) for unit in ("ms", "s"))
    assert any("1e+06 Hz" in note and "`time_unit` is probably coarser" in note for note in made.notes)
    assert not any("time_unit" in note for note in right.notes)


def test_rows_that_come_in_bursts_leave_the_unit_of_their_stamps(tmp_path: Path) -> None:
    """Most stamps are a microsecond after the one before, as where packets wait for each other."""
    stamps = np.repeat(np.arange(125) * 0.008, 4) + np.tile(np.arange(4) * 1e-6, 125)
    path = tmp_path / "bursts.csv"
    columns = np.column_stack((1e3 * stamps, np.sin(9 * stamps), np.cos(7 * stamps)))
    np.savetxt(path, columns, "%.9f", ",", header="time_ms,q,tau", comments="")
    assert 'time_unit = "ms"' in survey(path).table


def test_stamps_of_the_epoch_in_nanoseconds_are_not_rounded(tmp_path: Path) -> None:
    taken = np.arange(500) * 1_000_000
    log = record(tmp_path, 1_700_000_000_123_456_789 + taken, "ns", taken=taken * 1e-9)
    assert log.rate_hz == pytest.approx(1000, rel=1e-12)
    assert error(log) < (1e-12, 1e-12)
    assert all("irregular" not in note for note in log.notes)


@pytest.mark.parametrize("rounding", [np.round, lambda t, d: np.floor(t * 10.0**d) / 10.0**d])
def test_stamps_that_are_only_rounded_are_regular(tmp_path: Path, rounding: object) -> None:
    taken = np.arange(1501) / 300
    log = record(tmp_path, rounding(taken, 3), taken=taken)  # type: ignore[operator]
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * taken))
    assert log.rate_hz == pytest.approx(300, rel=1e-3)
    assert "written to" in log.notes[0]


def test_single_precision_stamps_of_a_long_log_are_regular(tmp_path: Path) -> None:
    taken = np.arange(400_000) / 1000
    log = record(tmp_path, taken.astype(np.float32), taken=taken)
    assert log.rate_hz == pytest.approx(1000, rel=1e-6)
    np.testing.assert_array_equal(log.torque[:, 0], np.cos(2 * np.pi * taken))


@settings(QUICK, max_examples=15)
@given(places=st.lists(st.integers(1, 97), min_size=1, max_size=3, unique=True), length=st.integers(1, 3))
def test_short_gaps_are_filled(tmp_path: Path, places: list[int], length: int) -> None:
    t = np.arange(1000) / 200
    lost = np.concatenate([np.arange(10 * p, 10 * p + length) for p in places])
    log = record(tmp_path, np.delete(t, lost))
    np.testing.assert_allclose(log.t, t, atol=1e-12)
    assert error(log) < (1e-4, 2e-2)
    kept = np.delete(np.arange(1000), lost)
    np.testing.assert_allclose(log.position[kept, 0], np.sin(2 * np.pi * t[kept]), rtol=0, atol=1e-12)
    assert f"{lost.size} missing samples" in log.notes[0]


def test_gaps_in_rounded_stamps_are_filled_on_the_true_grid(tmp_path: Path) -> None:
    taken = np.delete(np.arange(1501) / 300, [700, 701, 1200])
    log = record(tmp_path, np.round(taken, 3), taken=taken)
    assert log.t.size == 1501
    assert error(log)[0] < 1e-4
    assert len(log.notes) == 2


def test_a_long_gap_splits_the_log(tmp_path: Path) -> None:
    """Twice 0.2 s at 1 Hz, and 20 samples alone between them: two segments with samples as they were recorded."""
    t = np.delete(np.arange(1000) / 100, [*range(400, 420), *range(440, 460)])
    log = record(tmp_path, t)
    kept = np.delete(t, slice(400, 420))
    assert log.segments == ((0, 400), (400, 940))
    np.testing.assert_allclose(log.t, kept, atol=1e-12)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * kept))
    assert log.time_base is not None
    assert log.time_base.gaps == (pytest.approx((3.99, 0.21)), pytest.approx((4.39, 0.21)))
    assert log.usable_bandwidth_hz is None
    assert log.dt == pytest.approx(0.01)
    assert "20 samples in shorter ones than 50 are not used" in log.notes[0]
    assert record(tmp_path, t, time_range=(4.6, 9)).segments == ((0, 441),)


@pytest.mark.parametrize("digits", [9, 2])  # the second: stamps that are regular within their rounding
@pytest.mark.parametrize("stray", [[0], [999], [0, 1, 2], [0, 999]])
def test_rows_alone_beyond_a_gap_are_left_out(tmp_path: Path, stray: list[int], digits: int) -> None:
    """A recorder that began, waited and went on; or went on, waited and ended. One segment is left."""
    places = np.sort([*stray, *range(300, 700)])
    taken, used = places / 200, np.searchsorted(places, np.arange(300, 700))
    log = record(tmp_path, np.round(taken, digits), taken=taken)
    assert log.segments == ((0, 400),)
    np.testing.assert_allclose(log.t, taken[used] - taken[0], atol=1e-2 if digits == 2 else 1e-9)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * taken[used]))
    assert any("not used" in note for note in log.notes)


def test_a_gap_that_the_motion_bridges_is_none(tmp_path: Path) -> None:
    """0.04 s at 1 Hz; a quarter period is 0.25 s."""
    t = np.delete(np.arange(10_000) / 1000, slice(4000, 4040))
    log = record(tmp_path, t)
    assert len(log.segments) == 1
    assert log.t.size == 10_000
    assert error(log)[0] < 1e-3


def test_a_gap_of_slow_motion_is_bridged(tmp_path: Path) -> None:
    """0.08 s at 500 Hz, 40 steps: less than an eighth of the second that the motion takes."""
    t = np.delete(np.arange(10_000) / 500, [*range(2000, 2040), *range(7200, 7240)])
    log = record(tmp_path, t)
    assert len(log.segments) == 1
    assert log.t.size == 10_000
    assert error(log)[0] < 2e-3


def test_a_log_of_gaps_alone(tmp_path: Path) -> None:
    t = (np.arange(1000) + 100 * (np.arange(1000) // 40)) / 100
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, t)
    assert raised.value.found == pytest.approx(1.01)


def test_many_missing_rows(tmp_path: Path) -> None:
    """13 % of the rows, at random: bridged by the least-squares spline."""
    lost = np.flatnonzero(np.random.default_rng(1).random(4000) < 0.13)
    log = record(tmp_path, np.delete(np.arange(4000) / 500, lost))
    assert log.t.size == 4000
    assert error(log)[0] < 1e-6
    assert log.usable_bandwidth_hz == pytest.approx(0.35 * 0.87 * 500 / 1.5, rel=0.02)


def test_backwards(tmp_path: Path) -> None:
    t = np.concatenate([np.arange(200), 50 + np.arange(100)]) / 100
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, t)
    assert raised.value.where == 200
    assert raised.value.found == (1.99, 0.5)
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, np.concatenate([t, np.arange(100) / 100]))
    assert raised.value.where == 200


def test_overflowed_unsigned_counter_runs_backwards(tmp_path: Path) -> None:
    t = (np.arange(200, dtype=np.uint64) * 1000 + 2**32 - 50_000).astype(np.uint32)
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, t, "us")
    assert raised.value.where == 50


def test_repeated_rows_are_dropped(tmp_path: Path) -> None:
    t = np.insert(np.arange(1000) / 100, [300, 301, 302, 600], np.array([299, 300, 301, 599]) / 100)
    log = record(tmp_path, t)
    np.testing.assert_allclose(log.t, np.arange(1000) / 100, atol=1e-12)
    assert error(log) < (1e-12, 1e-12)
    assert "4 samples repeat the one before, first at t = 2.99 s" in log.notes[0]


def test_a_repeated_stamp_on_another_sample_is_jitter(tmp_path: Path) -> None:
    taken = np.arange(1000) / 100
    t = taken.copy()
    t[500] = t[499]
    log = record(tmp_path, t, taken=taken)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * taken))
    assert log.time_base is not None
    assert log.time_base.method == "line"


def test_stamps_coarser_than_the_sampling(tmp_path: Path) -> None:
    taken = np.arange(3000) / 2000
    log = record(tmp_path, np.floor(taken * 1000), "ms", taken=taken)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * taken))
    assert log.rate_hz == pytest.approx(2000, rel=1e-3)


def test_stamps_that_do_not_give_the_rate(tmp_path: Path) -> None:
    taken = np.arange(5000) / 1000
    for stamps in (np.floor(taken), (1.6e9 + taken).astype(np.float32)):
        with pytest.raises(errors.LogTimeError) as raised:
            record(tmp_path, stamps, taken=taken)
        assert "rate_hz" in raised.value.advice


def test_stamps_of_the_epoch_in_seconds_are_regular(tmp_path: Path) -> None:
    """In double precision they are rounded to 0.24 us."""
    taken = np.arange(5000) / 1000
    log = record(tmp_path, 1.6e9 + taken, taken=taken)
    np.testing.assert_array_equal(log.position[:, 0], np.sin(2 * np.pi * taken))
    assert log.rate_hz == pytest.approx(1000, rel=1e-7)


def test_missing_stamps(tmp_path: Path) -> None:
    for k in (0, 7):
        t = np.arange(100) / 100
        t[k] = np.nan
        with pytest.raises(errors.LogDataError) as raised:
            record(tmp_path, t, taken=np.arange(100) / 100)
        assert raised.value.where == ("t", k)
        assert raised.value.found == 1


def test_a_stamp_that_a_flipped_bit_made_a_signalling_nan_is_one_error(tmp_path: Path) -> None:
    t = np.arange(500) / 100
    q, tau = np.sin(t), np.cos(t)
    t.view(np.uint64)[100] = 0x7FF0000000000001
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=tau)
    with pytest.raises(errors.LogError):
        read_log(tmp_path / "log.npz", Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t"))


def test_a_rate_in_place_of_stamps(tmp_path: Path) -> None:
    taken = np.arange(500) / 250
    log = record(tmp_path, np.zeros(500), rate_hz=250, taken=taken, time_range=(0.5, 1.5))
    np.testing.assert_allclose(log.t, np.arange(125, 376) / 250)
    assert error(log) < (1e-12, 1e-12)


def test_time_range(tmp_path: Path) -> None:
    t = 3 + np.arange(1000) / 100
    log = record(tmp_path, t, time_range=(2, 5))
    assert (log.t[0], log.t[-1]) == pytest.approx((2, 5))
    assert error(log, start=3.0) < (1e-12, 1e-12)
    assert "kept from 2 to 5 s: 301 of 1000 samples" in log.notes
    for time_range in ((5, 2), (20, 30), (np.nan, 1), (3, 3.005)):
        with pytest.raises(errors.LogTimeError):
            record(tmp_path, t, time_range=time_range)
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, t, time_range=(20, 30))
    assert raised.value.found == (20, 30)
    assert raised.value.limit == (0, pytest.approx(9.99))


def test_too_short(tmp_path: Path) -> None:
    with pytest.raises(errors.LogTimeError) as raised:
        record(tmp_path, np.arange(49) / 100)
    assert raised.value.found == 49
    assert raised.value.limit == 50
    assert record(tmp_path, np.arange(50) / 100).t.size == 50


def test_jitter_that_the_positions_do_not_show_is_said_to_be_that(tmp_path: Path) -> None:
    """Neither cause is claimed where the slope is as near to 0 as to 1."""
    rng = np.random.default_rng(4)
    n = 2000
    t = (np.arange(n) + np.concatenate([[0.0], 0.004 * rng.standard_normal(n - 1)])) / 500
    q = np.sin(2 * np.pi * t) + 2e-3 * rng.standard_normal(n)
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=np.cos(2 * np.pi * t))
    log = read_log(tmp_path / "log.npz", Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t"))
    note = next(note for note in log.notes if "irregular" in note)
    assert "too little for the positions to tell" in note
    assert not any("resampled" in note for note in log.notes)


def test_recordings_one_after_the_other_in_a_file_are_segments(tmp_path: Path) -> None:
    t = np.r_[np.arange(0, 3, 1e-3), np.arange(0, 2, 1e-3)]
    q = np.r_[np.sin(2 * t[:3000]), 1.5 + np.sin(3 * t[3000:])]
    path = tmp_path / "log.npz"
    np.savez(path, t=t, q=q, tau=np.cos(2 * t))
    channels = Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t")
    log = read_log(path, channels)
    assert [stop - start for start, stop in log.segments] == [3000, 2000]
    np.testing.assert_allclose(log.position[:, 0], q, atol=1e-12)
    assert any("time restarts at sample 3000" in note for note in log.time_base.sentences)
    np.savez(path, t=np.r_[t[:3000], 1.0 + t[3000:]], q=q, tau=np.cos(2 * t))  # a clock that was set back
    with pytest.raises(errors.LogTimeError, match="time decreases"):
        read_log(path, channels)


def test_a_fast_motion_tells_whether_stamps_are_right(tmp_path: Path) -> None:
    """At 20 samples a period; the speed was taken from 51 samples, and the stamps were called wrong."""
    rng = np.random.default_rng(0)
    t = (np.arange(1000) + 0.3 * rng.uniform(-1, 1, 1000)) / 20
    right = record(tmp_path, t).time_base
    assert right is not None
    assert right.method == "stamps"
    assert right.slope == pytest.approx(1, abs=0.05)
    wrong = record(tmp_path, t, taken=np.arange(1000) / 20).time_base
    assert wrong is not None
    assert wrong.method == "line"
    assert wrong.slope == pytest.approx(0, abs=0.05)


def test_a_loop_whose_rate_wanders_tells_that_its_stamps_are_right(tmp_path: Path) -> None:
    """Stamps go away from regular ones by tens of steps, which hid the rough part: they were called wrong."""
    rng = np.random.default_rng(1)
    usual = np.repeat(rng.choice([0.0042, 0.01], 60, p=[0.3, 0.7]), rng.integers(20, 160, 60))
    t = np.cumsum(usual * (1 + 0.25 * rng.uniform(-1, 1, usual.size)))
    q = np.sin(9 * t) + 0.5 * np.sin(23 * t)
    q = 8e-4 * np.round(q / 8e-4)
    np.savez(tmp_path / "log.npz", t=t, q=q, tau=np.cos(9 * t))
    right = read_log(tmp_path / "log.npz", Channels(Signal("q", "rad"), Signal("tau", "N m"), time="t")).time_base
    assert right is not None
    assert right.jitter > 3
    assert right.method == "stamps"
    assert right.slope == pytest.approx(1, abs=0.1)


def test_the_rate_of_a_short_log_is_not_that_of_its_first_and_last_stamp(tmp_path: Path) -> None:
    taken = np.arange(800) / 100
    t = taken + 5e-3 * np.random.default_rng(0).uniform(-1, 1, 800)
    t[[0, -1]] = taken[[0, -1]] + [-5e-3, 5e-3]
    log = record(tmp_path, np.sort(t), taken=taken)
    assert log.dt == pytest.approx(0.01, rel=1e-4)  # 1.3e-3 by the ends


@pytest.mark.parametrize("tells", [True, False])
def test_gaps_are_counted_where_stamps_jitter_by_half_a_step(tmp_path: Path, tells: bool) -> None:
    rng, n = np.random.default_rng(3), 20_000
    there = np.ones(n, dtype=bool)
    for start in rng.integers(100, n - 100, 60):
        there[start : start + rng.integers(3, 9)] = False
    regular = np.arange(n) / 200
    t = np.sort(regular + 0.5 / 200 * rng.normal(size=n))
    log = record(tmp_path, t[there], taken=(t if tells else regular)[there])
    report = log.time_base
    assert report is not None
    assert report.method == ("stamps" if tells else "line")
    assert report.slope == pytest.approx(float(tells), abs=0.05)
    assert log.dt == pytest.approx(1 / 200, rel=1e-3)  # 1.7 % too long where each row is a step
    if not tells:
        assert max(error(log)) < 0.05  # the stamps alone: 0.015; 0.16 where each row is a step


def test_samples_stay_where_others_are_missing(tmp_path: Path) -> None:
    """What is missing is fitted to the samples around it, which are kept: a spline rounds the jumps of torques."""
    rng, n = np.random.default_rng(0), 2000
    there = np.append(True, rng.random(n - 1) > 0.1)
    there[-1] = True
    t = np.arange(n) / 1000
    log = record(tmp_path, t[there], taken=t[there] + 1e-4 * rng.normal(size=there.sum()))
    assert log.t.size == n
    with np.load(log.path) as raw:
        np.testing.assert_array_equal(log.position[there, 0], raw["q"])
        np.testing.assert_array_equal(log.torque[there, 0], raw["tau"])
    assert np.abs(log.position[~there, 0] - np.sin(2 * np.pi * t[~there])).max() < 4e-3


@pytest.mark.parametrize("late", [[0.9], [3.0, 2.1, 1.2, 0.3]])
def test_stamps_that_come_late_lose_no_row(tmp_path: Path, late: list[float]) -> None:
    """As of a recorder that was held up: the row was counted twice from there on, and the clock was said to drift."""
    taken = np.arange(4000) / 200
    t = taken + 0.06 / 200 * np.random.default_rng(0).normal(size=4000)
    t[1500 : 1500 + len(late)] += np.array(late) / 200
    log = record(tmp_path, np.maximum.accumulate(t) - t[0], taken=taken)
    assert log.t.size == 4000
    assert log.dt == pytest.approx(1 / 200, rel=1e-5)
    assert not any("drifts" in note or "missing" in note for note in log.notes)


def test_a_lost_row_is_counted_where_its_step_is_shortened_by_jitter(tmp_path: Path) -> None:
    taken = np.delete(np.arange(4000) / 200, 1700)
    t = taken + 0.2 / 200 * np.random.default_rng(1).normal(size=3999)
    t[1700] -= 0.5 / 200 + t[1700] - taken[1700]  # 1.5 steps from the row before, less that one's own jitter
    log = record(tmp_path, np.maximum.accumulate(t) - t[0], taken=taken - t[0])
    assert log.t.size == 4000


def test_rows_that_were_not_counted_are_no_drift(tmp_path: Path) -> None:
    """Where jitter is too large to count lost rows, two at the border of two medians changed the rate by 1 %."""
    taken = np.delete(np.arange(4020) / 200, [1608, 1609])
    t = np.sort(taken + 1.2 / 200 * np.random.default_rng(0).normal(size=4018))
    log = record(tmp_path, t - t[0], taken=taken)
    assert log.time_base is not None
    assert log.time_base.method == "line"
    assert not any("drifts" in note for note in log.notes)


def test_a_clock_that_drifts_is_followed(tmp_path: Path) -> None:
    taken = np.arange(4000) / 200
    t = taken * (1 + 0.004 * taken / taken[-1]) + 0.06 / 200 * np.random.default_rng(0).normal(size=4000)
    log = record(tmp_path, t - t[0], taken=taken)
    assert any("drifts: its rate changes" in note for note in log.notes)


@pytest.mark.parametrize("what", ["vibration", "a joint that is held"])
def test_gaps_are_judged_by_the_motion_and_not_by_what_trembles(tmp_path: Path, what: str) -> None:
    """Gaps of 20 ms in a motion at 0.3 Hz: a wobble of milliradians at 42 Hz made a segment of each part."""
    rng, n = np.random.default_rng(0), 20_000
    t, step = np.arange(n) / 1000, 2 * np.pi / 2**14
    motion, wobble = np.sin(2 * np.pi * 0.3 * t), 3 * step * np.sin(2 * np.pi * 42 * t) + step * rng.normal(size=n)
    q = np.column_stack([motion + wobble, motion] if what == "vibration" else [motion, 0.5 + wobble])
    there = np.ones(n, dtype=bool)
    for start in range(1000, n, 2000):
        there[start : start + 20] = False
    path = tmp_path / "log.npz"
    q1, q2 = (step * np.round(q / step))[there].T
    np.savez(path, t=t[there], q1=q1, q2=q2, tau1=np.cos(t[there]), tau2=np.sin(t[there]))
    channels = Channels(Signal(("q1", "q2"), "rad"), Signal(("tau1", "tau2"), "N m"), time="t")
    log = read_log(path, channels)
    assert len(log.segments) == 1
    assert log.t.size == n


@pytest.mark.parametrize(("wander", "jitter", "gap"), [(0.0, 1.0, 1), (0.0, 1.5, 10), (0.9, 0.7, 0), (0.9, 1.5, 0)])
def test_lost_rows_are_counted_as_far_as_the_stamps_tell(wander: float, jitter: float, gap: int) -> None:
    """Above 0.6 steps of jitter none were counted; of stamps that wander, hundreds that never were."""
    rng, rows = np.random.default_rng(3), 6000
    white = rng.normal(size=rows + 200) * np.sqrt(1 - wander**2)
    late = jitter * signal.lfilter([1.0], [1.0, -wander], white)[200:]
    kept = np.ones(rows, dtype=bool)
    for start in rng.choice(np.arange(1, 60), 30 // max(gap, 1), replace=False) * 100 if gap else ():
        kept[start : start + gap] = False
    stamps = np.sort((np.arange(rows) + late)[kept])
    slots = row_times._line(stamps, ((0, len(stamps)),))[0]
    off = slots - np.flatnonzero(kept)
    assert abs(int(slots[-1]) + 1 - rows) <= 0.2 * (~kept).sum()
    assert np.std(off) < 1.5


def test_resampled_positions_keep_the_steps_of_their_encoder(tmp_path: Path) -> None:
    """Ripple of two steps was taken for motion at twenty times the bandwidth, as what is resampled has no steps."""
    step, rng = 2 * np.pi / 2048, np.random.default_rng(5)
    t = (np.arange(8000) + 0.3 * rng.uniform(-1, 1, 8000)) / 100
    q = 0.3 * np.sin(2 * np.pi * 0.1 * t)
    q = step * np.round((q + 2 * step * np.sin(2 * np.pi * q / (8 * step))) / step)
    path = tmp_path / "log.npz"
    np.savez(path, t=t, q=1e3 * q, tau=np.cos(t) + 0.01 * rng.normal(size=t.size))
    channels = Channels(Signal("q", "rad", gain=1e-3), Signal("tau", "N m"), time="t")
    log = read_log(path, channels)
    assert log.position_steps == pytest.approx((step,), rel=1e-6)
    (found,) = spectra(log.between(0, 7000))
    assert found.bandwidth > 1.0
    assert found.narrowed().bandwidth < 0.2
    np.savez(path, t=np.arange(8000) / 100, q=1e3 * q, tau=np.cos(t))
    assert read_log(path, channels).position_steps == ()


def stopped(moving: int, frozen: int) -> np.ndarray:
    """Stamps with jitter, a pause of 5 s, and stamps of a clock that stands still, s."""
    t = np.sort(np.arange(moving) + 0.3 * np.random.default_rng(0).normal(size=moving)) / 200
    return np.append(t - t[0], np.full(frozen, t[-1] - t[0] + 5))


def test_a_segment_in_which_the_clock_stands_still_has_no_lost_rows(tmp_path: Path) -> None:
    """Its step is 0, and rows were counted in steps of it."""
    t = stopped(3500, 2500)
    assert not row_times.lost_rows(t[3500:], 0.3).any()
    log = record(tmp_path, t, taken=np.arange(6000) / 200)
    assert log.segments == ((0, 3500), (3500, 6000))
    assert log.rate_hz == pytest.approx(200, rel=1e-3)


def test_a_clock_that_stands_still_over_most_of_the_log_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(errors.LogTimeError, match=r"clock stands still .* 3499 of 6000 stamps"):
        record(tmp_path, stopped(2500, 3500), taken=np.arange(6000) / 200)
