"""Time base of a log: when its samples were taken, and the uniform grid that they are brought to.

Recorders are not ideal: stamps jitter, rows are lost, recording pauses, and a sample is written twice. Each of these is
recognised, acted on by itself, and reported in a sentence with its size. A log without any is taken as it is.

0. A clock that stood still while the joints moved on, and never caught up, is taken to have run, see
   `haptid.log.stopped_clock`.
1. Gaps. A step longer than a quarter period of the fastest motion, or than ten steps and an eighth of that period,
   splits the log into segments; shorter ones are bridged.
2. Regular stamps, also rounded ones and ones with missing rows, are the grid.
3. Otherwise the stamps deviate from the regular grid, after a slow drift of the clock has been followed. The roughness
   of the positions is regressed on speed times deviation: the slope is 1 where the stamps say when samples were taken,
   and 0 where sampling is regular and only the stamps jitter. Above one half, and clearly above 0, the stamps are
   used, else the grid: jitter that the positions do not show changes them by less than their noise.
4. Stale rows are dropped, see `haptid.log.stale`.
5. Where the motion shows that samples are whole sampling periods apart, but others than the times found so far say, the
   motion's count is the time, see `haptid.log.sample_counts`.
6. Samples that are not on the grid are brought to it by a least-squares spline, see `haptid.log.resampling`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.errors import LogTimeError
from haptid.log.resampling import CARRIED, KNOT, Resampling, Spans
from haptid.log.row_times import (
    LONGEST_GAP,
    MOST_STEPS,
    RawSignals,
    RowTimes,
    Sampling,
    TimesFrom,
    counted_times,
    irregular_times,
    regular_times,
    sampled_median,
    uniform,
)
from haptid.log.spectrum import fastest
from haptid.log.stale import Stale, polled
from haptid.log.stamps import FEWEST_SAMPLES, Stamps
from haptid.log.stopped_clock import running_times

# A step up to this many regular ones, and four standard deviations of the jitter, is no gap between segments.
SHORTEST_GAP = 4.5
# Nor is one below a quarter period of the fastest motion, at most `LONGEST_GAP` steps or this long, s; nor any below
# this share of the period, across which positions are interpolated to a thousandth of their stroke.
LONGEST_GAP_S, BRIDGED = 0.05, 1 / 8


@dataclass(frozen=True)
class TimeBaseReport:
    """What was found in the time base of a log, and what was done.

    Attributes:
        method: regular (samples are the grid), stamps (resampled from the times of the stamps), line (sampling is
            regular, the stamps jitter) or counted (periods between rows are counted by the motion).
        jitter: standard deviation of the stamps about the grid, steps; 0 where they are regular.
        slope, slope_se: of the positions' roughness on speed times deviation, and its standard error; 1 where stamps
            are right, 0 where the grid is; None where it was not needed.
        missing: missing samples that were filled.
        gaps: first time and length of each gap that splits the log, s.
        stale_position, stale_torque: share of rows that were dropped as stale.
        usable_bandwidth_hz: highest frequency that resampled channels carry; None where none was resampled.
        clock_drift_s: growth of the torques' delay over the log, s, see `haptid.log.channel_clocks`; 0 where not clear.
        sentences: the same in words; empty for a regular log.
    """

    method: TimesFrom = "regular"
    jitter: float = 0.0
    slope: float | None = None
    slope_se: float | None = None
    missing: int = 0
    gaps: tuple[tuple[float, float], ...] = ()
    stale_position: float = 0.0
    stale_torque: float = 0.0
    usable_bandwidth_hz: float | None = None
    clock_drift_s: float = 0.0
    sentences: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TimeBase:
    """Uniform grid of a log, and how positions and torques come to it.

    Attributes:
        t: grid, (n,), s; uniform within each segment.
        segments: first grid point and one past the last of each segment.
        position, torque: of the signals.
        report: findings.
    """

    t: Array
    segments: Spans
    position: Resampling
    torque: Resampling
    report: TimeBaseReport


def time_base(path: Path, stamps: Stamps, recorded: RawSignals, sampling: Sampling, keep_stale: bool) -> TimeBase:
    """The time base of a log with stamps.

    Args:
        path: of the file.
        stamps: of the rows.
        recorded: the rows.
        sampling: "stamps" and "regular" are taken as said; "auto" chooses by the positions.
        keep_stale: whether stale rows are kept.

    Raises:
        LogTimeError: no segment has `FEWEST_SAMPLES`.
    """
    again = stamps.repeated[(recorded.same_position & recorded.same_torque)[stamps.repeated]]
    held = None if keep_stale else polled(recorded.same_position, recorded.same_torque, recorded.positions)
    sentences = [*stamps.notes]
    if held is not None:
        again = np.flatnonzero(~held[0])
        sentences.append(
            f"{100 * again.size / stamps.seconds.size:.3g} % of the rows hold the sample of the row before: the "
            f"recorder writes some {held[1]} rows for each sample, of which one is kept"
        )
    elif again.size:
        sentences.append(
            f"{again.size} samples repeat the one before, first at t = {stamps.seconds[again[0]]:.6g} s: dropped"
        )
    rows = np.delete(np.arange(stamps.seconds.size), again) if again.size else None
    recorded = recorded.without(again)
    seconds = stamps.seconds if rows is None else stamps.seconds[rows]
    if sampling == "auto":
        seconds, said = running_times(seconds, recorded.positions)
        sentences += said
    stale = None if keep_stale else recorded.stale()
    spans, gaps, said = _segments(path, seconds, recorded)
    sentences += said
    found = regular_times(seconds, spans, stamps.fineness)
    if found is None:
        found = irregular_times(path, seconds, spans, recorded, stale, sampling)
    if sampling == "auto" and not keep_stale:
        found, stale = counted_times(seconds, spans, recorded, stale, found)
    return _assembled(found, spans, gaps, stale, rows, seconds.size, sentences)


def at_rate(path: Path, start: int, stop: int, rate_hz: float, recorded: RawSignals, keep_stale: bool) -> TimeBase:
    """The time base of rows start..stop at a given rate."""
    t = np.arange(start, stop) / rate_hz
    if not keep_stale and polled(recorded.same_position, recorded.same_torque, recorded.positions) is not None:
        regular = Stamps(np.empty(0, np.intp), t, 1e-9 / rate_hz)
        return time_base(path, regular, recorded, "auto", keep_stale)
    stale = None if keep_stale else recorded.stale()
    found, spans = RowTimes("regular", 1 / rate_hz, (float(t[0]),), t, np.arange(t.size)), ((0, t.size),)
    if not keep_stale:
        found, stale = counted_times(t, spans, recorded, stale, found)
    return _assembled(found, spans, (), stale, None, t.size, [])


def _assembled(
    found: RowTimes,
    spans: Spans,
    gaps: tuple[tuple[float, float], ...],
    stale: Stale | None,
    rows: NDArray[np.intp] | None,
    count: int,
    sentences: Sequence[str],
) -> TimeBase:
    """Grid and resampling of both signals, with sentences."""
    points = []
    for a, b in spans:
        own = (found.times[b - 1] - found.times[a]) / found.step if found.slots is None else found.slots[b - 1]
        points.append(int(np.rint(own)) + 1)
    edges = np.cumsum([0, *points])
    segments = tuple((int(a), int(b)) for a, b in pairwise(edges))
    whole = spans == ((0, count),)
    if whole and found.method == "regular" and not found.missing:
        grid = found.times  # of every row: one array in memory
    else:
        grid = np.concatenate([uniform(f, found.step, n) for f, n in zip(found.first, points, strict=True)])
    t = freeze(grid)
    on_grid = found.slots
    if on_grid is not None:
        on_grid = on_grid.copy()
        for (a, b), (start, _) in zip(spans, segments, strict=True):
            on_grid[a:b] += start

    def signal_of(old: NDArray[np.bool_] | None) -> Resampling:
        drop = old is not None and bool(old.any())
        kept, bounds = rows, spans
        times, slots = found.times, on_grid
        if drop or not whole:
            chosen = np.concatenate([np.arange(a, b) for a, b in spans])
            if drop:
                assert old is not None
                chosen = chosen[~old[chosen]]
            bounds = tuple((int(a), int(b)) for a, b in (np.searchsorted(chosen, span) for span in spans))
            kept, times = chosen if rows is None else rows[chosen], times[chosen]
            slots = None if slots is None else slots[chosen]
        if found.slots is not None and not found.missing and not drop:
            return Resampling("direct", kept, times, t, segments, bounds)
        if found.slots is not None and not drop and not found.smooth:
            return Resampling("interpolated", kept, times, t, segments, bounds)
        long = sum(float(found.times[b - 1] - found.times[a]) for a, b in spans)
        mean = long / max(times.size - len(spans), 1)
        return Resampling("fitted", kept, times, t, segments, bounds, KNOT * max(found.step, mean), slots)

    position, torque = (signal_of(None if stale is None else old) for old in _masks(stale))
    knot = max(position.knot, torque.knot)
    bandwidth = CARRIED / knot if knot else None
    more = list(found.sentences)
    shares = [0.0 if old is None else float(old.mean()) for old in _masks(stale)]
    for share, name in zip(shares, ("positions", "torques"), strict=True):
        if share:
            more.append(f"{100 * share:.2g} % of the {name} are stale (they repeat the row before): dropped")
    if bandwidth is not None:
        more.append(
            f"resampled at {1 / found.step:.6g} Hz by a least-squares cubic spline, which carries up to "
            f"{bandwidth:.3g} Hz (error below 2 %; 0.005 % at a tenth of half the sampling rate)"
        )
    report = TimeBaseReport(
        found.method,
        found.jitter,
        None if found.slope is None else found.slope[0],
        None if found.slope is None else found.slope[1],
        found.missing,
        gaps,
        shares[0],
        shares[1],
        bandwidth,
        sentences=(*sentences, *more),
    )
    return TimeBase(t, segments, position, torque, report)


def _masks(stale: Stale | None) -> tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None]:
    return (None, None) if stale is None else (stale.position, stale.torque)


def _segments(
    path: Path, seconds: Array, recorded: RawSignals
) -> tuple[Spans, tuple[tuple[float, float], ...], list[str]]:
    """Rows of each segment without a gap longer than the motion can bridge, the gaps, and a sentence."""
    steps = np.diff(seconds)
    whole = ((0, seconds.size),)
    candidates, step = candidate_gaps(steps)
    if not candidates.size:
        return whole, (), []
    edge = _motion_edge(recorded.positions(), candidates, step)
    period = 1 / edge if edge else 0.0
    longest_bridged = max(LONGEST_GAP * step, LONGEST_GAP_S, BRIDGED * period)
    limit = min(0.25 * period, longest_bridged) if edge else longest_bridged
    limit = max(limit, SHORTEST_GAP * step)
    breaks = candidates[steps[candidates] > limit]
    if not breaks.size:
        return whole, (), []
    edges = [0, *(breaks + 1).tolist(), seconds.size]
    spans = tuple((a, b) for a, b in pairwise(edges) if b - a >= FEWEST_SAMPLES)
    longest = int(breaks[np.argmax(steps[breaks])])
    if not spans:
        raise LogTimeError(
            f"{path}: {breaks.size} gaps of up to {steps[longest]:.4g} s (limit {limit:.3g} s, a quarter period of the "
            f"fastest motion) leave no {FEWEST_SAMPLES} samples in a row.",
            where=float(seconds[longest]),
            found=float(steps[longest]),
            limit=limit,
            advice="Record again with a recorder that keeps up, or leave `time` out and give `rate_hz` if the samples "
            "are regular and only their stamps are not.",
        )
    left = seconds.size - sum(b - a for a, b in spans)
    gaps = tuple((float(seconds[k]), float(steps[k])) for k in breaks)
    sentence = (
        f"{breaks.size} gap{'s' if breaks.size > 1 else ''} of more than {limit:.3g} s (a quarter period of the "
        f"fastest motion, {edge:.2g} Hz; at most {LONGEST_GAP:.0f} steps, {LONGEST_GAP_S:g} s or an eighth of it), "
        f"the longest "
        f"{steps[longest]:.4g} s at t = {seconds[longest]:.6g} s: {len(spans)} segments of the log are treated by "
        f"themselves"
    )
    if left:
        sentence += f"; {left} samples in shorter ones than {FEWEST_SAMPLES} are not used"
    return spans, gaps, [sentence]


def candidate_gaps(steps: Array) -> tuple[NDArray[np.intp], float]:
    """Steps too long for jitter, as indices, and the mean of the others, s."""
    median = sampled_median(steps)
    usual = steps[steps <= LONGEST_GAP * median] if median > 0 else steps
    step = float(usual.mean())
    jitter = sampled_median(np.abs(usual - median)) if median > 0 else step
    return np.flatnonzero(steps > SHORTEST_GAP * step + 4 * jitter), step


def _motion_edge(channels: Iterable[Array], gaps: NDArray[np.intp], step: float) -> float:
    """The largest bandwidth of the channels' motion, Hz; 0 where nothing moves, infinite without enough rows in a row.

    A part between gaps may be too short to show the motion: all are joined, with what the position moves by in each gap
    taken off.

    Args:
        channels: positions, each (rows,).
        gaps: rows before a step that may be a gap.
        step: the mean of the others, s.
    """
    joined = []
    for channel in channels:
        if np.diff(gaps, prepend=-1, append=channel.size - 1).max() < FEWEST_SAMPLES:
            return np.inf
        moved = np.diff(channel, prepend=channel[:1])
        moved[gaps + 1] = 0.0
        joined.append(np.cumsum(moved)[:MOST_STEPS])
    return fastest(joined, step)
