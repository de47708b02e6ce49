"""Times of the rows of a log, and the grid near them: regular, followed along a line, by their stamps, or counted.

The rules are in `haptid.log.time_base`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import polynomial_filter, running_maximum
from haptid.errors import LogTimeError
from haptid.log.lost_rows import lost_rows
from haptid.log.resampling import Spans
from haptid.log.sample_counts import WIDEST_MEAN, StepCounts, count_steps
from haptid.log.spectrum import Spectrum, lattice_step
from haptid.log.stale import Stale, find_stale

Sampling = Literal["auto", "stamps", "regular"]
TimesFrom = Literal["regular", "stamps", "line", "counted"]

# Stamps this close to a uniform grid, in steps, are on it; so are ones whose jitter has this standard deviation: the
# position error is below any encoder's resolution.
UNIFORM, UNIFORM_SD = 1e-4, 1e-3
# A step longer than this many regular ones is a gap in regular stamps.
_GAP = 1.5
# The most regular steps of a step that is no gap between segments.
LONGEST_GAP = 10.0
# Share of missing samples that are interpolated; more are bridged by the least-squares spline.
MISSING_LIMIT = 0.01
# Rows in which the median follows a drifting clock.
DRIFT_ROWS = 201
# Change of the rate, as a share, from which on the drift is not neglected.
DRIFT = 2e-3
# Differences of such medians in a row that a drift is in.
_LASTS = 3
# Rows after which late stamps, as of a recorder that was held up, are back in time.
_LATE = 64
# Jitter, in steps, up to which missing rows are counted by rounding each step; above it by the means of many.
COUNTED = 0.12
# Slope above which the stamps say when samples were taken, and the most rows that it is computed from.
TELL, ROWS_OF_SLOPE = 0.5, 2**17
# Standard errors from 0, or from 1, from which on that slope is clear.
SLOPE_CLEAR = 2.0
# Rows of the smoothing filters of that regression: of the speed, and of the roughness.
_WIDE, _NARROW = 51, 11
# Shortest step of rows around one, in regular ones, that a speed is divided by.
_SLOWEST = 0.1
# Periods of the motion in those filters, at most, and their fewest rows: a longer cubic does not follow the motion.
_FOLLOWS, _SHORTEST = 0.5, 7
# Share, and number, of the clear steps in which the motion's count must differ from the times by this many periods.
_MISCOUNTED, _FEWEST_MISCOUNTED, _DIFFERENT = 0.002, 10, 0.6
# Of a log with more rows, pieces say first whether it may have such steps, at this share of the share above: the first
# and the roughest piece of this length in each group. The roughest have at least the share of the whole log.
_LONG, _PIECE, _GROUP, _SUSPECT = 2**17, 2**10, 16, 1 / 3
# Change of the speed from a step to the next, over its noise and over the speed, from which on a step is rough: one of
# other periods changes it by a whole speed, and is clear from ten deviations of a step's noise on.
_ROUGH, _ROUGH_SHARE = 5.0, 0.5
# Share by which a period of the motion is shorter than that of regular stamps where these only count the rows: clocks
# agree better than that, and a recorder with another rate than its device's differs by more.
_LOST = 0.05
# Steps above which a median is estimated from every second one, every third one, ...
MOST_STEPS = 2**18


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
class RowTimes:
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


def uniform(first: float, step: float, n: int) -> Array:
    t = np.arange(n, dtype=np.float64)
    t *= step
    t += first
    return t


def sampled_median(steps: Array) -> float:
    return float(np.median(steps[:: max(1, steps.size // MOST_STEPS)]))


def regular_times(seconds: Array, spans: Spans, fineness: float) -> RowTimes | None:
    """Times of stamps that are regular within their resolution, also with missing rows; None for others."""
    parts = [seconds[a:b] for a, b in spans]
    steps = [np.diff(part) for part in parts]
    median = sampled_median(steps[0] if len(steps) == 1 else np.concatenate(steps))
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
        step, off = _coarse(parts[0], fineness)
        if not step:
            return None
        slots = [np.arange(parts[0].size)]
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
    if not missing and spans == ((0, seconds.size),):
        times = uniform(first[0], step, n)
    else:
        times = seconds.copy()  # of rows in no segment
        for (a, b), own, f, m in zip(spans, slots, first, count, strict=True):
            times[a:b] = uniform(f, step, m)[own]
    place = np.zeros(seconds.size, dtype=np.intp)
    for (a, b), own in zip(spans, slots, strict=True):
        place[a:b] = own
    return RowTimes("regular", step, first, times, place, missing, smooth, sentences=tuple(notes))


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


def irregular_times(
    path: Path, seconds: Array, spans: Spans, recorded: RawSignals, stale: Stale | None, sampling: Sampling
) -> RowTimes:
    """Times of rows whose stamps are not regular.

    Raises:
        LogTimeError: the clock stands still over most of the longest segment.
    """
    slots, offset, step = _line(seconds, spans)
    if step <= 0:
        raise _stands_still(path, seconds)
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
        # The grid ends with the stamps.
        step = sum(float(seconds[b - 1] - seconds[a]) for a, b in spans) / sum(int(slots[b - 1]) for _, b in spans)
        return RowTimes("stamps", step, first, seconds, None, 0, True, jitter, slope, (f"{spread}; {chosen}",))
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
        return RowTimes("line", step, first, seconds - deviation, None, 0, True, jitter, slope, tuple(notes))
    times = np.zeros(seconds.size)
    for (a, b), f in zip(spans, first, strict=True):
        times[a:b] = f + step * slots[a:b]
    smooth = missing > MISSING_LIMIT * seconds.size
    if missing:
        notes.append(f"{missing} missing samples ({100 * missing / (seconds.size + missing):.2g} %) filled")
    return RowTimes("line", step, first, times, slots, missing, smooth, jitter, slope, tuple(notes))


def counted_times(
    seconds: Array, spans: Spans, recorded: RawSignals, stale: Stale | None, found: RowTimes
) -> tuple[RowTimes, Stale | None]:
    """Times and stale rows by the motion's count of sampling periods; as they were where these agree with it."""
    many = seconds.size
    taken, fresh = found.times / found.step, np.ones(many, dtype=bool) if stale is None else ~stale.position
    # Positions that are held while torques go on are of a channel that is stuck, and no count of what the rows hold:
    # where motion and stamps agree again behind them, times are right.
    fresh &= ~recorded.same_position | recorded.same_torque
    if many > _LONG and not _may_be_miscounted(spans, recorded, taken, fresh):
        return found, stale
    counts = count_steps(recorded.positions(), spans, many)
    if counts is None:
        return found, stale
    miscounted, clear = _miscounted(counts, taken, fresh)
    if miscounted < max(_FEWEST_MISCOUNTED, _MISCOUNTED * clear):
        return found, stale
    taken = np.diff(taken)
    same = recorded.same_position[1:]
    periods = np.where(counts.resolved, counts.periods, np.where(same, 1, np.maximum(np.rint(taken), 1))).astype(
        np.intp
    )
    a, b = max(spans, key=lambda span: span[1] - span[0])
    # The latency of a queue wanders: over half a segment it matters least.
    half = (b - a) // 2
    total = np.cumsum(periods[a : b - 1])
    period = float(np.median((seconds[a + 1 + half : b] - seconds[a + 1 : b - half]) / (total[half:] - total[:-half])))
    longer = ""
    if len(spans) == 1 and found.method == "regular" and not found.missing and 1e-3 < 1 - period / found.step < _LOST:
        longer = (
            f"; the motion lasts {100 * (found.step / period - 1):.2g} % longer than the stamps, which count the rows"
        )
        period = found.step
    slots, times = np.zeros(many, dtype=np.intp), np.zeros(many)
    again = np.append(False, periods == 0)
    missing, first = 0, []
    for a, b in spans:
        slots[a + 1 : b] = np.cumsum(periods[a : b - 1])
        first.append(float(seconds[a]))
        times[a:b] = uniform(first[-1], period, int(slots[b - 1]) + 1)[slots[a:b]]
        missing += int(np.maximum(periods[a : b - 1] - 1, 0).sum())
    note = (
        f"the positions advance by whole sampling periods of {period:.4g} s that the stamps, or the rows, do not "
        f"show: {int(again.sum())} rows hold an earlier sample, {missing} samples are missing; times are counted by "
        f"the motion{longer}"
    )
    made = Stale(again, again, np.append(False, counts.clear))
    return RowTimes(
        "counted", period, tuple(first), times, slots, missing, True, found.jitter, found.slope, (note,)
    ), made if again.any() else None


def _miscounted(counts: StepCounts, taken: Array, fresh: NDArray[np.bool_]) -> tuple[int, int]:
    """Steps between fresh rows in which the motion's count differs from the times, in periods, and all clear ones."""
    rows = np.flatnonzero(fresh)
    counted, unclear = (np.concatenate([[0], np.cumsum(each)]) for each in (counts.periods, ~counts.clear))
    clear = np.diff(unclear[rows]) == 0
    apart = np.abs(np.diff(counted[rows]) - np.diff(taken[rows]))[clear] > _DIFFERENT
    return int(apart.sum()), apart.size


def _may_be_miscounted(spans: Spans, recorded: RawSignals, taken: Array, fresh: NDArray[np.bool_]) -> bool:
    """Whether pieces of a long log have steps of other periods than its times; true where pieces do not tell.

    Counting all rows takes longer than reading them, and holds all positions in memory. The speeds of all rows say
    where to look: a queue that lasts some seconds lies between pieces at even distances. Rows at the end of a segment
    that fill no piece are not looked at.
    """
    starts = np.concatenate([np.arange(a, b - _PIECE + 1, _PIECE) for a, b in spans])
    if _PIECE * len(starts) < len(taken) // 2:  # most segments are too short
        return True
    rough = _rough_steps(recorded, starts)
    first = range(0, len(starts), _GROUP)
    chosen = np.union1d(first, [k + int(np.argmax(rough[k : k + _GROUP])) for k in first])
    pieces = [(int(a), int(a) + _PIECE) for a in starts[chosen]]

    def joined(x: Array) -> Array:
        """The pieces one after the other, each beginning where the one before ends."""
        return np.append(0.0, np.cumsum(np.concatenate([np.diff(x[a:b]) for a, b in pieces])))

    rows = (_PIECE - 1) * len(pieces) + 1
    counts = count_steps((joined(channel) for channel in recorded.positions()), [(0, rows)], rows)
    if counts is None:
        return False
    near_a_joint = (np.arange(rows - 1) + WIDEST_MEAN // 2) % (
        _PIECE - 1
    ) < WIDEST_MEAN  # speeds there are those of two pieces
    counts = replace(counts, clear=counts.clear & ~near_a_joint)
    kept = np.append(np.concatenate([fresh[a : b - 1] for a, b in pieces]), True)
    miscounted, clear = _miscounted(counts, joined(taken), kept)
    return miscounted > _SUSPECT * _MISCOUNTED * clear


def _rough_steps(recorded: RawSignals, starts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Steps of each piece after which the speed of a channel changes by more than motion or noise, (pieces,)."""
    rough = np.zeros(len(starts), dtype=np.intp)
    for channel in recorded.positions():  # one piece's steps in memory at a time
        every = max(1, (channel.size - 2) // MOST_STEPS)
        first, second, third = (channel[k : channel.size - 2 + k : every] for k in range(3))
        some = np.abs((third - second) - (second - first))
        noise = max(1.4826 * sampled_median(some), lattice_step(channel[: 1 << 16]) / 2**0.5)
        for k, a in enumerate(starts):
            speed = np.diff(channel[a : a + _PIECE])
            limit = max(_ROUGH * noise, _ROUGH_SHARE * float(np.abs(speed).mean()))
            rough[k] += np.count_nonzero(np.abs(np.diff(speed)) > limit)
    return rough


def _said(value: float, se: float) -> str:
    return f" (slope of the positions' roughness on speed times deviation {value:.2f} +- {se:.2g})"


def _line(seconds: Array, spans: Spans) -> tuple[NDArray[np.intp], Array, float]:
    """Number of each row in its segment with missing rows counted, its distance from the line, s, and the step, s.

    The step is 0 where the clock stands still over most of the longest segment.
    """
    steps = np.concatenate([np.diff(seconds[a:b]) for a, b in spans])
    median = sampled_median(steps)
    spread = (
        sampled_median(np.abs(steps - median)) / (0.95 * median) if median > 0 else np.inf
    )  # 1.4826 / sqrt(2) of the MAD
    slots = np.zeros(seconds.size, dtype=np.intp)
    for a, b in spans:
        own = np.ones(b - a - 1, dtype=np.intp)
        if spread < COUNTED:
            own = np.rint(np.diff(seconds[a:b]) / median).astype(np.intp)
        else:
            own = 1 + lost_rows(seconds[a:b], spread)
        index = np.arange(1, b - a)  # no two rows are in one place
        slots[a + 1 : b] = index + np.maximum(np.maximum.accumulate(_lasting(np.cumsum(own) - index)), 0)
    # Between the ends alone, their jitter would be an error of the rate: over half a segment the median has little.
    a, b = max(spans, key=lambda span: span[1] - span[0])
    half = (b - a) // 2
    step = float(
        np.median((seconds[a + half : b] - seconds[a : b - half]) / (slots[a + half : b] - slots[a : b - half]))
    )
    offset = np.zeros(seconds.size)
    for a, b in spans:
        offset[a:b] = seconds[a:b] - seconds[a] - step * slots[a:b]
    return slots, offset, step


def _stands_still(path: Path, seconds: Array) -> LogTimeError:
    """Error of a clock that gives no rate."""
    repeated = int(np.count_nonzero(seconds[1:] == seconds[:-1]))
    return LogTimeError(
        f"{path}: the clock stands still over most of the longest part without a gap: {repeated} of {seconds.size} "
        "stamps equal the one before, so that the rate is unknown.",
        where=path,
        found=repeated / seconds.size,
        advice="Take the part in which it moves with `time_range`; or, if samples were regular, leave `time` out and "
        "give `rate_hz`.",
    )


def _lasting(lost: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows that were counted as lost, less those of late stamps: the least of each and the _LATE - 1 after it."""
    ahead = np.append(-lost, np.full(_LATE // 2, -np.inf))
    return -running_maximum(ahead, _LATE)[_LATE // 2 :].astype(np.intp)


def _followed(offset: Array) -> tuple[Array, float]:
    """Medians of `DRIFT_ROWS` rows joined by lines, and the largest lasting change from one row to the next.

    A jump, as of a row that was miscounted, is in two differences of medians at most: a drift is in more.
    """
    whole = offset.size // DRIFT_ROWS
    if whole < 3:
        return np.full(offset.size, float(np.median(offset))), 0.0
    middles = np.median(offset[: whole * DRIFT_ROWS].reshape(whole, DRIFT_ROWS), axis=1)
    at = DRIFT_ROWS * (np.arange(whole) + 0.5) - 0.5
    follow, changes = np.interp(np.arange(offset.size), at, middles), np.diff(middles)
    if changes.size < _LASTS:
        return follow, 0.0
    runs = np.lib.stride_tricks.sliding_window_view(changes, _LASTS)
    lasting = np.maximum(runs.min(axis=1), -runs.max(axis=1))  # below zero where signs differ
    return follow, max(float(lasting.max()), 0.0) / DRIFT_ROWS


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
    spans = tuple((a, min(b, a + ROWS_OF_SLOPE // len(spans))) for a, b in spans)
    upper = lower = 0.0
    for channel in positions:
        pairs = [_roughness(channel[a:b], deviation[a:b], fresh[a:b]) for a, b in spans]
        rough, moved_by = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        power = float(moved_by @ moved_by)
        if power == 0:
            continue
        cross = float(moved_by @ rough)
        noise = max(float(rough @ rough) - cross**2 / power, 1e-12 * power) / rough.size
        upper, lower = upper + cross / noise, lower + power / noise
    return (upper / lower, lower**-0.5) if lower > 0 else (0.0, np.inf)


def _roughness(position: Array, deviation: Array, fresh: NDArray[np.bool_]) -> tuple[Array, Array]:
    """High-pass of a position, and of its speed times the deviation, at the fresh rows.

    Where the rate wanders, as of a loop that waits for its bus, the deviation is that from the rate of the rows around.
    """
    fastest = Spectrum.of(position, 1.0).bandwidth  # periods in a row
    follows = max(int(_FOLLOWS / fastest) // 2 * 2 + 1, _SHORTEST) if fastest else _WIDE
    wide = min(position.size // 4 * 2 - 1, _WIDE, follows)
    around = min(position.size // 4 * 2 - 1, _WIDE)
    usual, changes = (polynomial_filter(deviation, around, 3, derivative) for derivative in (0, 1))
    speed = polynomial_filter(position, wide, 3, 1) / np.maximum(1.0 + changes, _SLOWEST)  # in a regular step
    moved_by = speed * (deviation - usual)
    pair = [(x - polynomial_filter(x, min(wide, _NARROW), 3))[fresh] for x in (position, moved_by)]
    return pair[0], pair[1]
