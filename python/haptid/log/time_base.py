"""Time base of a log: when its samples were taken, and the uniform grid that they are brought to.

Recorders are not ideal: stamps jitter, rows are lost, recording pauses, and a sample is written twice. Each of these is
recognised, acted on by itself, and reported in a sentence with its size. A log without any is taken as it is.

1. Gaps. A step longer than a quarter period of the fastest motion splits the log into segments; shorter ones are
   bridged.
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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, freeze
from haptid._internal.signals import polynomial_filter
from haptid.errors import LogTimeError
from haptid.log.resampling import CARRIED, KNOT, Resampling, Spans
from haptid.log.sample_counts import count_steps
from haptid.log.spectrum import Spectrum
from haptid.log.stale import Stale, find_stale, polled
from haptid.log.stamps import FEWEST_SAMPLES, Stamps

Sampling = Literal["auto", "stamps", "regular"]
TimesFrom = Literal["regular", "stamps", "line", "counted"]

# Stamps this close to a uniform grid, in steps, are on it; so are ones whose jitter has this standard deviation: the
# position error is below any encoder's resolution.
UNIFORM, UNIFORM_SD = 1e-4, 1e-3
# A step longer than this many regular ones is a gap in regular stamps.
_GAP = 1.5
# A step up to this many regular ones, and four standard deviations of the jitter, is no gap between segments.
SHORTEST_GAP = 4.5
# Nor is one below a quarter period of the fastest motion, at most this many steps or this long, s.
LONGEST_GAP, LONGEST_GAP_S = 10.0, 0.05
# Share of missing samples that are interpolated; more are bridged by the least-squares spline.
MISSING_LIMIT = 0.01
# Rows in which the median follows a drifting clock.
DRIFT_ROWS = 201
# Change of the rate, as a share, from which on the drift is not neglected.
DRIFT = 2e-3
# Jitter, in steps, up to which missing rows are counted by rounding each step.
COUNTED = 0.12
# Slope above which the stamps say when samples were taken, and rows that it is computed from at most.
TELL, ROWS_TOLD = 0.5, 2**17
# Standard errors from 0, or from 1, from which on that slope tells.
SLOPE_CLEAR = 2.0
# Rows of the smoothing filters of that regression: of the speed, and of the roughness.
_WIDE, _NARROW = 51, 11
# Share, and number, of the clear steps in which the motion's count must differ from the times by this many periods.
_MISCOUNTED, _FEWEST_MISCOUNTED, _DIFFERENT = 0.002, 10, 0.6
# Steps above which a median is estimated from every second one, every third one, ...
_SAMPLED = 2**18


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


@dataclass(frozen=True, eq=False)
class RawSignals:
    """The rows of a file as they were recorded.

    Attributes:
        same_position, same_torque: whether all channels of a signal equal those of the row before, (rows,).
        positions, torques: give the channels one after the other, each (rows,), in any unit, unwrapped.
    """

    same_position: NDArray[np.bool_]
    same_torque: NDArray[np.bool_]
    positions: Callable[[], Iterable[Array]]
    torques: Callable[[], Iterable[Array]]

    def stale(self) -> Stale | None:
        """Stale rows, by `find_stale`."""
        return find_stale(self.same_position, self.same_torque, self.positions, self.torques)

    def without(self, rows: NDArray[np.intp]) -> RawSignals:
        """Without some rows."""
        if not rows.size:
            return self
        return RawSignals(
            np.delete(self.same_position, rows),
            np.delete(self.same_torque, rows),
            lambda: (np.delete(channel, rows) for channel in self.positions()),
            lambda: (np.delete(channel, rows) for channel in self.torques()),
        )


@dataclass(frozen=True, eq=False)
class _Times:
    """Times of the rows, and the grid near them.

    Attributes:
        method, jitter, slope, sentences: as in `TimeBaseReport`.
        step: of the grid, s.
        first: of each segment's grid, s.
        times: of the rows, s.
        slots: grid point of each row from its segment's first; None where rows are off the grid.
        missing: grid points without a row.
        smooth: whether missing samples are too many to be interpolated.
    """

    method: TimesFrom
    step: float
    first: tuple[float, ...]
    times: Array
    slots: NDArray[np.intp] | None
    missing: int = 0
    smooth: bool = False
    jitter: float = 0.0
    slope: tuple[float, float] | None = None
    sentences: tuple[str, ...] = ()


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
    stale = None if keep_stale else recorded.stale()
    spans, gaps, said = _segments(path, seconds, recorded)
    sentences += said
    found = _regular(seconds, spans, stamps.fineness)
    if found is None:
        found = _irregular(seconds, spans, recorded, stale, sampling)
    if sampling == "auto" and not keep_stale:
        found, stale = _counted(seconds, spans, recorded, stale, found)
    return _assembled(found, spans, gaps, stale, rows, seconds.size, sentences)


def at_rate(path: Path, start: int, stop: int, rate_hz: float, recorded: RawSignals, keep_stale: bool) -> TimeBase:
    """The time base of rows start..stop at a given rate."""
    t = np.arange(start, stop) / rate_hz
    if not keep_stale and polled(recorded.same_position, recorded.same_torque, recorded.positions) is not None:
        regular = Stamps(np.empty(0, np.intp), t, 1e-9 / rate_hz)
        return time_base(path, regular, recorded, "auto", keep_stale)
    stale = None if keep_stale else recorded.stale()
    found, spans = _Times("regular", 1 / rate_hz, (float(t[0]),), t, np.arange(t.size)), ((0, t.size),)
    if not keep_stale:
        found, stale = _counted(t, spans, recorded, stale, found)
    return _assembled(found, spans, (), stale, None, t.size, [], t if found.method == "regular" else None)


def _assembled(
    found: _Times,
    spans: Spans,
    gaps: tuple[tuple[float, float], ...],
    stale: Stale | None,
    rows: NDArray[np.intp] | None,
    count: int,
    sentences: Sequence[str],
    grid: Array | None = None,
) -> TimeBase:
    """Grid and resampling of both signals, with sentences."""
    points = []
    for a, b in spans:
        own = (found.times[b - 1] - found.times[a]) / found.step if found.slots is None else found.slots[b - 1]
        points.append(int(np.rint(own)) + 1)
    edges = np.cumsum([0, *points])
    segments = tuple((int(a), int(b)) for a, b in pairwise(edges))
    if grid is None:
        grid = np.concatenate([_uniform(f, found.step, n) for f, n in zip(found.first, points, strict=True)])
    t = freeze(grid)
    whole = spans == ((0, count),)

    def signal_of(old: NDArray[np.bool_] | None) -> Resampling:
        drop = old is not None and bool(old.any())
        kept, bounds = rows, spans
        times = found.times
        if drop or not whole:
            chosen = np.concatenate([np.arange(a, b) for a, b in spans])
            if drop:
                assert old is not None
                chosen = chosen[~old[chosen]]
            bounds = tuple((int(a), int(b)) for a, b in (np.searchsorted(chosen, span) for span in spans))
            kept, times = chosen if rows is None else rows[chosen], times[chosen]
        if found.slots is not None and not found.missing and not drop:
            return Resampling("direct", kept, times, t, segments, bounds)
        if found.slots is not None and not drop and not found.smooth:
            return Resampling("interpolated", kept, times, t, segments, bounds)
        long = sum(float(found.times[b - 1] - found.times[a]) for a, b in spans)
        mean = long / max(times.size - len(spans), 1)
        return Resampling("fitted", kept, times, t, segments, bounds, KNOT * max(found.step, mean))

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


def _uniform(first: float, step: float, n: int) -> Array:
    t = np.arange(n, dtype=np.float64)
    t *= step
    t += first
    return t


def _median(steps: Array) -> float:
    return float(np.median(steps[:: max(1, steps.size // _SAMPLED)]))


def _segments(
    path: Path, seconds: Array, recorded: RawSignals
) -> tuple[Spans, tuple[tuple[float, float], ...], list[str]]:
    """Rows of each segment without a gap longer than the motion can bridge, the gaps, and a sentence."""
    steps = np.diff(seconds)
    whole = ((0, seconds.size),)
    candidates, step = candidate_gaps(steps)
    if not candidates.size:
        return whole, (), []
    edges = [0, *(candidates + 1).tolist(), seconds.size]
    quiet = max(pairwise(edges), key=lambda span: span[1] - span[0])
    fastest = _motion_edge(recorded.positions(), slice(*quiet), step)
    limit = min(0.25 / fastest if fastest else np.inf, max(LONGEST_GAP * step, LONGEST_GAP_S))
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
        f"fastest motion, {fastest:.2g} Hz; at most {LONGEST_GAP:.0f} steps or {LONGEST_GAP_S:g} s), the longest "
        f"{steps[longest]:.4g} s at t = {seconds[longest]:.6g} s: {len(spans)} segments of the log are treated by "
        f"themselves"
    )
    if left:
        sentence += f"; {left} samples in shorter ones than {FEWEST_SAMPLES} are not used"
    return spans, gaps, [sentence]


def candidate_gaps(steps: Array) -> tuple[NDArray[np.intp], float]:
    """Steps too long for jitter, as indices, and the mean of the others, s."""
    median = _median(steps)
    usual = steps[steps <= LONGEST_GAP * median] if median > 0 else steps
    step = float(usual.mean())
    jitter = _median(np.abs(usual - median)) if median > 0 else step
    return np.flatnonzero(steps > SHORTEST_GAP * step + 4 * jitter), step


def _motion_edge(channels: Iterable[Array], rows: slice, step: float) -> float:
    """The largest bandwidth of the channels' motion, Hz; 0 where nothing moves, infinite in too few rows."""
    parts = [channel[rows][:_SAMPLED] for channel in channels]
    if any(part.size < FEWEST_SAMPLES for part in parts):
        return np.inf
    return max(Spectrum.of(part, step).bandwidth for part in parts)


def _regular(seconds: Array, spans: Spans, fineness: float) -> _Times | None:
    """Times of stamps that are regular within their resolution, also with missing rows; None for others."""
    parts = [seconds[a:b] for a, b in spans]
    steps = [np.diff(part) for part in parts]
    median = _median(steps[0] if len(steps) == 1 else np.concatenate(steps))
    gaps = [np.flatnonzero(own > _GAP * median + min(fineness, 0.25 * median)) for own in steps]
    many = sum(own.size for own in gaps)
    length = sum(float(part[-1] - part[0]) for part in parts)
    lost = sum(float(own[at].sum()) for own, at in zip(steps, gaps, strict=True))
    ordinary = (length - lost) / max(sum(own.size for own in steps) - many, 1)
    missing = 0
    if ordinary > 0:  # it is 0 where most stamps equal the one before
        counts = (np.maximum(np.rint(own[at] / ordinary) - 1, 1) for own, at in zip(steps, gaps, strict=True))
        missing = sum(int(many.sum()) for many in counts)
    n = sum(part.size for part in parts) + missing
    step = length / (n - len(parts))
    placed = [_slots(part, step) for part in parts]
    off = max(far for _, far in placed)
    distinct = missing == 0 or all(bool((np.diff(slots) > 0).all()) for slots, _ in placed)
    notes: list[str] = []
    slots = [own for own, _ in placed]
    if not (distinct and (off <= UNIFORM or (off < 0.5 and off * step <= fineness * (1 + UNIFORM)))):
        if missing or len(parts) > 1:
            return None
        step, off = _coarse(seconds, fineness)
        if not step:
            return None
        slots = [np.arange(seconds.size)]
    smooth = False
    if missing:
        longest = int(np.argmax([own.max(initial=0.0) for own in steps]))
        k = int(np.argmax(steps[longest]))
        smooth = missing > MISSING_LIMIT * n or steps[longest][k] > LONGEST_GAP * step
        notes.append(
            f"{many} short gaps, the longest {steps[longest][k]:.4g} s at t = {parts[longest][k]:.6g} s: "
            f"{missing} missing samples ({100 * missing / n:.2g} %) filled by "
            f"{'the least-squares spline' if smooth else 'interpolation'}"
        )
    if off > UNIFORM:
        notes.append(
            f"stamps are regular within the {fineness:.2g} s that they are written to; "
            f"samples taken as regular at {1 / step:.6g} Hz"
        )
    first = tuple(float(part[0]) for part in parts)
    count = [int(own[-1]) + 1 for own in slots]
    if not missing and len(parts) == 1:
        times = _uniform(first[0], step, n)
    else:
        times = np.empty(seconds.size)
        for (a, b), own, f, m in zip(spans, slots, first, count, strict=True):
            times[a:b] = _uniform(f, step, m)[own]
    place = np.zeros(seconds.size, dtype=np.intp)
    for (a, b), own in zip(spans, slots, strict=True):
        place[a:b] = own
    return _Times("regular", step, first, times, place, missing, smooth, sentences=tuple(notes))


def _slots(seconds: Array, step: float) -> tuple[NDArray[np.intp], float]:
    """Grid point nearest to each stamp, and the largest distance to it in steps."""
    places = (seconds - seconds[0]) / step
    nearest = np.rint(places)
    places -= nearest
    return nearest.astype(np.intp), float(np.abs(places, out=places).max())


def _coarse(seconds: Array, fineness: float) -> tuple[float, float]:
    """Step of a line that all stamps are within their resolution of, and the largest distance in steps; or 0."""
    index = np.arange(seconds.size) - 0.5 * (seconds.size - 1)
    step = float(index @ seconds / (index @ index))
    off = seconds - step * index
    off -= 0.5 * (off.min() + off.max())
    far = float(np.abs(off).max())
    return (step, far / step) if far <= 0.55 * fineness else (0.0, 0.0)


def _irregular(seconds: Array, spans: Spans, recorded: RawSignals, stale: Stale | None, sampling: Sampling) -> _Times:
    """Times of rows whose stamps are not regular."""
    slots, offset, step = _line(seconds, spans)
    follow = np.zeros(seconds.size)
    rate = 0.0
    for a, b in spans if sampling != "regular" else ():
        follow[a:b], own = _followed(offset[a:b])
        rate = max(rate, own / step)
    inside = np.concatenate([np.arange(a, b) for a, b in spans])
    deviation = offset - follow
    jitter = float(np.std(deviation[inside])) / step
    missing = sum(int(slots[b - 1]) + 1 - (b - a) for a, b in spans)
    slope = None
    tell = sampling == "stamps"
    if sampling == "auto" and jitter > UNIFORM_SD:
        fresh = np.ones(seconds.size, dtype=bool) if stale is None else ~stale.position
        slope = stamps_tell(recorded.positions(), deviation / step, fresh, spans)
        tell = slope[0] > TELL and slope[0] > SLOPE_CLEAR * slope[1]
    spread = f"sample times are irregular: they deviate by {jitter:.2g} steps of {step:.4g} s (standard deviation)"
    if tell:
        chosen = "as asked for" if slope is None else f"the stamps say when samples were taken{_said(*slope)}"
        first = tuple(float(seconds[a]) for a, _ in spans)
        return _Times("stamps", step, first, seconds, None, 0, True, jitter, slope, (f"{spread}; {chosen}",))
    first = tuple(float(seconds[a] + np.median(offset[a:b] - follow[a:b]) + follow[a]) for a, b in spans)
    notes = []
    if jitter > UNIFORM_SD or sampling == "regular":
        if slope is None:
            chosen = "as asked for"
        elif slope[0] + SLOPE_CLEAR * slope[1] < 1:
            chosen = f"sampling is regular and only the stamps jitter{_said(*slope)}"
        else:
            chosen = "too little for the positions to tell whether the samples or only their stamps jitter"
        notes.append(f"{spread}; {chosen}; samples taken as regular at {1 / step:.6g} Hz")
    if rate > DRIFT + 5 * 1.25 * 2**0.5 * DRIFT_ROWS**-1.5 * jitter:  # five deviations of a difference of two medians
        notes.append(f"the clock of the stamps drifts: its rate changes by up to {100 * rate:.2g} %; followed")
        return _Times("line", step, first, seconds - deviation, None, 0, True, jitter, slope, tuple(notes))
    times = np.zeros(seconds.size)
    for (a, b), f in zip(spans, first, strict=True):
        times[a:b] = f + step * slots[a:b]
    smooth = missing > MISSING_LIMIT * seconds.size
    if missing:
        notes.append(f"{missing} missing samples ({100 * missing / (seconds.size + missing):.2g} %) filled")
    return _Times("line", step, first, times, slots, missing, smooth, jitter, slope, tuple(notes))


def _counted(
    seconds: Array, spans: Spans, recorded: RawSignals, stale: Stale | None, found: _Times
) -> tuple[_Times, Stale | None]:
    """Times and stale rows by the motion's count of sampling periods; as they were where these agree with it."""
    many = seconds.size
    counts = count_steps(recorded.positions(), spans, many)
    if counts is None:
        return found, stale
    taken = np.diff(found.times) / found.step
    fresh = np.flatnonzero(np.ones(many, dtype=bool) if stale is None else ~stale.position)
    counted, told = (np.concatenate([[0.0], np.cumsum(each)]) for each in (counts.periods, taken))
    unclear = np.concatenate([[0], np.cumsum(~counts.clear)])
    clear = np.diff(unclear[fresh]) == 0
    apart = np.abs(np.diff(counted[fresh]) - np.diff(told[fresh]))[clear] > _DIFFERENT
    if apart.sum() < max(_FEWEST_MISCOUNTED, _MISCOUNTED * apart.size):
        return found, stale
    same = recorded.same_position[1:]
    periods = np.where(counts.resolved, counts.periods, np.where(same, 1, np.maximum(np.rint(taken), 1))).astype(
        np.intp
    )
    a, b = max(spans, key=lambda span: span[1] - span[0])
    # The latency of a queue wanders: over half a segment it matters least.
    half = (b - a) // 2
    total = np.cumsum(periods[a : b - 1])
    period = float(np.median((seconds[a + 1 + half : b] - seconds[a + 1 : b - half]) / (total[half:] - total[:-half])))
    slots, times = np.zeros(many, dtype=np.intp), np.zeros(many)
    again = np.append(False, periods == 0)
    missing, first = 0, []
    for a, b in spans:
        slots[a + 1 : b] = np.cumsum(periods[a : b - 1])
        first.append(float(seconds[a]))
        times[a:b] = _uniform(first[-1], period, int(slots[b - 1]) + 1)[slots[a:b]]
        missing += int(np.maximum(periods[a : b - 1] - 1, 0).sum())
    note = (
        f"the positions advance by whole sampling periods of {period:.4g} s that the stamps, or the rows, do not "
        f"show: {int(again.sum())} rows hold an earlier sample, {missing} samples are missing; times are counted by "
        f"the motion"
    )
    made = Stale(again, again, np.append(False, counts.clear))
    return _Times(
        "counted", period, tuple(first), times, slots, missing, True, found.jitter, found.slope, (note,)
    ), made if again.any() else None


def _said(value: float, se: float) -> str:
    return f" (slope of the positions' roughness on speed times deviation {value:.2f} +- {se:.2g})"


def _line(seconds: Array, spans: Spans) -> tuple[NDArray[np.intp], Array, float]:
    """Number of each row in its segment with missing rows counted, its distance from the line, s, and the step, s."""
    steps = np.concatenate([np.diff(seconds[a:b]) for a, b in spans])
    median = _median(steps)
    spread = _median(np.abs(steps - median)) / (0.95 * median) if median > 0 else np.inf  # 1.4826 / sqrt(2) of the MAD
    slots = np.zeros(seconds.size, dtype=np.intp)
    for a, b in spans:
        own = np.ones(b - a - 1, dtype=np.intp)
        if spread < COUNTED:
            own = np.rint(np.diff(seconds[a:b]) / median).astype(np.intp)
        index = np.arange(1, b - a)  # no two rows are in one place
        slots[a + 1 : b] = index + np.maximum(np.maximum.accumulate(np.cumsum(own) - index), 0)
    step = sum(float(seconds[b - 1] - seconds[a]) for a, b in spans) / sum(int(slots[b - 1]) for _, b in spans)
    offset = np.zeros(seconds.size)
    for a, b in spans:
        offset[a:b] = seconds[a:b] - seconds[a] - step * slots[a:b]
    return slots, offset, step


def _followed(offset: Array) -> tuple[Array, float]:
    """Medians of `DRIFT_ROWS` rows joined by lines, and the largest change from one row to the next."""
    whole = offset.size // DRIFT_ROWS
    if whole < 3:
        return np.full(offset.size, float(np.median(offset))), 0.0
    middles = np.median(offset[: whole * DRIFT_ROWS].reshape(whole, DRIFT_ROWS), axis=1)
    at = DRIFT_ROWS * (np.arange(whole) + 0.5) - 0.5
    follow = np.interp(np.arange(offset.size), at, middles)
    return follow, float(np.abs(np.diff(middles)).max()) / DRIFT_ROWS


def stamps_tell(
    positions: Iterable[Array], deviation: Array, fresh: NDArray[np.bool_], spans: Spans
) -> tuple[float, float]:
    """Slope of the positions' roughness on speed times deviation of the stamps, and its standard error.

    Args:
        positions: channels, each (rows,).
        deviation: of the stamps from regular ones, steps, (rows,).
        fresh: rows that are not stale.
        spans: rows of each segment.
    """
    spans = tuple((a, min(b, a + ROWS_TOLD // len(spans))) for a, b in spans)
    upper = lower = 0.0
    for channel in positions:
        pairs = [_roughness(channel[a:b], deviation[a:b], fresh[a:b]) for a, b in spans]
        rough, told = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        power = float(told @ told)
        if power == 0:
            continue
        cross = float(told @ rough)
        noise = max(float(rough @ rough) - cross**2 / power, 1e-12 * power) / rough.size
        upper, lower = upper + cross / noise, lower + power / noise
    return (upper / lower, lower**-0.5) if lower > 0 else (0.0, np.inf)


def _roughness(position: Array, deviation: Array, fresh: NDArray[np.bool_]) -> tuple[Array, Array]:
    """High-pass of a position, and of its speed times the deviation, at the fresh rows."""
    wide = min(position.size // 4 * 2 - 1, _WIDE)
    told = polynomial_filter(position, wide, 3, 1) * deviation
    pair = [(x - polynomial_filter(x, _NARROW, 3))[fresh] for x in (position, told)]
    return pair[0], pair[1]
