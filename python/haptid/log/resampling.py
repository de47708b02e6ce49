"""Time base: the uniform grid of a log, from time stamps or a rate, and resampling to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from haptid._internal.arrays import Array, freeze
from haptid.errors import LogTimeError
from haptid.log.checks import all_usable, non_finite, repeated_stamps, usable

if TYPE_CHECKING:
    from haptid.log.formats.sniff import RawChannel

FEWEST_SAMPLES = 50
# Stamps this close to a uniform grid, in steps, are on it: the position error is below any encoder's resolution.
UNIFORM = 1e-4
# A step longer than this many regular ones is a gap; one longer than LONGEST_GAP is not filled.
_GAP = 1.5
LONGEST_GAP = 10.0
# Longest sampling period, s; a longer one almost certainly means stamps in another unit.
SLOWEST = 0.5
MISSING_LIMIT = 0.01
REPEATED_LIMIT = 0.01
# Steps above which the median is estimated from every second one, every third one, ...
_SAMPLED = 2**18
# Interpolation is done piece by piece; a cubic spline's dependence on a sample k away decays as (2 - sqrt(3))^k.
SAMPLES_RESAMPLED = 2**16
_MARGIN = 40


@dataclass(frozen=True, eq=False)
class TimeBase:
    """Sample times and the uniform grid of a log.

    Attributes:
        repeated: samples whose stamp equals the one before, to be dropped, (repeats,).
        stamps: times of the other samples, (m,), s.
        t: uniform grid, (n,), s.
        regular: whether the samples are on the grid already.
        notes: findings.
    """

    repeated: NDArray[np.intp]
    stamps: Array
    t: Array
    regular: bool
    notes: tuple[str, ...]


def since_first(path: Path, name: str, raw: RawChannel, scale: float) -> Array:
    """Stamps from the first one on, (n,), s; integer stamps are subtracted as integers, without rounding.

    Stamps in float64 are overwritten.

    Raises:
        LogDataError: the first stamp is missing.
    """
    seconds: Array
    if raw.dtype.kind in "iu":
        whole = raw.astype(np.int64)
        seconds = np.subtract(whole, whole[0], out=whole).astype(np.float64)
    elif usable(raw[:1]).all():
        with np.errstate(invalid="ignore"):
            own = raw.dtype == np.float64 and raw.flags.writeable
            seconds = np.subtract(raw, raw[0], out=raw if own else None, dtype=np.float64)
    else:
        raise non_finite(path, name, int(np.count_nonzero(~usable(raw))), 0, None)
    seconds *= scale
    return seconds


def part(path: Path, seconds: Array, time_range: tuple[float, float] | None) -> slice:
    """Rows from the first to the last stamp inside a time range.

    Raises:
        LogTimeError: no stamp is inside.
    """
    if time_range is None:
        return slice(0, seconds.size)
    inside = np.flatnonzero((seconds >= time_range[0]) & (seconds <= time_range[1]))
    if inside.size == 0:
        last = float(np.nanmax(seconds))
        raise LogTimeError(
            f"{path}: no samples from {time_range[0]:g} to {time_range[1]:g} s.",
            where="time_range",
            found=time_range,
            limit=(0.0, last),
            advice=f"The log runs from 0 to {last:g} s, counted from its first sample; give (from, to) inside it.",
        )
    return slice(int(inside[0]), int(inside[-1]) + 1)


def resolution(raw: RawChannel) -> float:
    """Resolution of the stamps in their own unit: a decimal place, or that of their type."""
    if raw.dtype.kind in "iu":
        return 1.0
    if not all_usable(raw):
        return 0.0
    largest = max(abs(float(raw.min())), abs(float(raw.max())))
    pieces = [raw[start : start + SAMPLES_RESAMPLED] for start in range(0, raw.size, SAMPLES_RESAMPLED)]
    single = all(np.array_equal(piece, piece.astype(np.float32)) for piece in pieces)
    finest = float(np.spacing(np.float32(largest))) if single else float(np.spacing(largest))
    for place in range(10):
        if all(_has_places(piece, place, largest) for piece in pieces):
            return max(finest, 10.0**-place)
    return finest


def _has_places(raw: RawChannel, place: int, largest: float) -> bool:
    shifted = raw * 10.0**place
    error = np.abs(shifted - np.rint(shifted)).max()
    return bool(error <= 4 * np.spacing(largest * 10.0**place))


def check_length(path: Path, samples: int) -> None:
    """Refuse fewer than `FEWEST_SAMPLES`."""
    if samples < FEWEST_SAMPLES:
        raise LogTimeError(
            f"{path}: {samples} samples, below the limit of {FEWEST_SAMPLES}.",
            where=path,
            found=samples,
            limit=FEWEST_SAMPLES,
            advice="Record longer, or widen `time_range`.",
        )


def from_rate(path: Path, rows: slice, rate_hz: float) -> TimeBase:
    """Time base of samples at a declared rate."""
    check_length(path, rows.stop - rows.start)
    t = np.arange(rows.start, rows.stop) / rate_hz
    return TimeBase(np.empty(0, np.intp), freeze(t), t, True, ())


def from_stamps(path: Path, name: str, seconds: Array, fineness: float) -> TimeBase:
    """Time base of stamped samples.

    Args:
        path, name: of the file and of the time channel.
        seconds: stamps, (m,), s.
        fineness: resolution of the stamps, s.

    Raises:
        LogDataError: a stamp is missing.
        LogTimeError: a stamp is earlier than the one before, or too many equal the one before; a gap of more than
            `LONGEST_GAP` steps, or too many short ones; fewer than `FEWEST_SAMPLES`; a sampling period above `SLOWEST`.
    """
    check_length(path, seconds.size)
    _check_order(path, name, seconds)
    step = float(np.median(np.diff(seconds[:SAMPLES_RESAMPLED])))
    if step > SLOWEST:
        raise LogTimeError(
            f"{path}: the time channel {name!r} implies a sampling period of {step:.3g} s (maximum {SLOWEST:g} s).",
            where=name,
            found=step,
            limit=SLOWEST,
            advice="Give the channel's `time_unit`: 'ms', 'us' or 'ns'.",
        )
    repeated = np.flatnonzero(seconds[1:] == seconds[:-1]) + 1
    notes: list[str] = []
    if repeated.size:
        if repeated.size > REPEATED_LIMIT * seconds.size:
            first = int(repeated[0])
            share = repeated.size / seconds.size
            why = f"that is {100 * share:.2g} % of the samples, above the limit of {100 * REPEATED_LIMIT:g} %"
            raise repeated_stamps(path, repeated.size, first, float(seconds[first]), why)
        notes.append(
            f"{repeated.size} samples repeat the one before, first at t = {seconds[repeated[0]]:.6g} s: dropped"
        )
        seconds = np.delete(seconds, repeated)
        check_length(path, seconds.size)
    stamps, t, regular, more = _grid(path, seconds, fineness)
    return TimeBase(repeated, freeze(stamps), freeze(t), regular, (*notes, *more))


def _check_order(path: Path, name: str, seconds: Array) -> None:
    if not all_usable(seconds):
        bad = ~usable(seconds)
        raise non_finite(path, name, int(np.count_nonzero(bad)), int(np.argmax(bad)), None)
    back = np.flatnonzero(seconds[1:] < seconds[:-1])
    if back.size:
        k = int(back[0])
        more = f", and at {back.size - 1} more places" if back.size > 1 else ""
        raise LogTimeError(
            f"{path}: time decreases at sample {k + 1}, from {seconds[k]:.9g} to {seconds[k + 1]:.9g} s{more}.",
            where=k + 1,
            found=(float(seconds[k]), float(seconds[k + 1])),
            advice="Either two recordings are in one file (split them, or keep one with `time_range`), a counter of "
            "the clock overflowed, or rows are out of order.",
        )


def _grid(path: Path, seconds: Array, fineness: float) -> tuple[Array, Array, bool, list[str]]:
    """Stamps, uniform grid, whether the samples are on it, and notes."""
    steps = np.diff(seconds)
    median = float(np.median(steps[:: max(1, steps.size // _SAMPLED)]))
    gaps = np.flatnonzero(steps > _GAP * median + min(fineness, 0.25 * median))
    ordinary = (seconds[-1] - seconds[0] - steps[gaps].sum()) / (steps.size - gaps.size)
    missing = _missing(path, seconds, steps, gaps, ordinary)
    n = seconds.size + missing
    step = (seconds[-1] - seconds[0]) / (n - 1)
    slots, off = _slots(seconds, step)
    distinct = missing == 0 or bool((np.diff(slots) > 0).all())
    rounded = off < 0.5 and off * step <= fineness * (1 + UNIFORM)
    notes: list[str] = []
    if missing:
        longest = gaps[np.argmax(steps[gaps])]
        notes.append(
            f"{gaps.size} short gaps, the longest {steps[longest]:.4g} s at t = {seconds[longest]:.6g} s: "
            f"{missing} missing samples ({100 * missing / n:.2g} %) filled by interpolation"
        )
    if distinct and (off <= UNIFORM or rounded):
        if off > UNIFORM:
            notes.append(
                f"stamps are regular within the {fineness:.2g} s that they are written to; "
                f"samples taken as regular at {1 / step:.6g} Hz"
            )
        del steps
        t = _uniform(float(seconds[0]), step, n)
        return (t[slots] if missing else t), t, missing == 0, notes
    del slots
    relative = np.delete(steps, gaps) if gaps.size else steps
    relative /= ordinary
    relative -= 1.0
    worst = max(abs(float(relative.min())), abs(float(relative.max())))
    notes.append(
        f"sample times are irregular: steps deviate by up to {100 * worst:.2g} % (standard deviation "
        f"{100 * relative.std():.2g} %); resampled at {1 / step:.6g} Hz, positions by a cubic spline, "
        f"torques by a monotone cubic"
    )
    del relative, steps
    return seconds, _uniform(float(seconds[0]), step, n), False, notes


def _uniform(first: float, step: float, n: int) -> Array:
    t = np.arange(n, dtype=np.float64)
    t *= step
    t += first
    return t


def _slots(seconds: Array, step: float) -> tuple[NDArray[np.int32], float]:
    """Index of the grid point nearest to each stamp, and the largest distance to it in steps."""
    slots, off = np.empty(seconds.size, np.int32), 0.0
    for start in range(0, seconds.size, SAMPLES_RESAMPLED):
        places = (seconds[start : start + SAMPLES_RESAMPLED] - seconds[0]) / step
        nearest = np.rint(places)
        off = max(off, float(np.abs(places - nearest).max()))
        slots[start : start + SAMPLES_RESAMPLED] = nearest
    return slots, off


def _missing(path: Path, seconds: Array, steps: Array, gaps: NDArray[np.intp], ordinary: float) -> int:
    """Number of samples missing in the gaps."""
    if gaps.size == 0:
        return 0
    long = gaps[steps[gaps] > LONGEST_GAP * ordinary]
    if long.size:
        k = long[0]
        more = f" It is the first of {long.size}." if long.size > 1 else ""
        raise LogTimeError(
            f"{path}: no samples for {steps[k]:.4g} s from t = {seconds[k]:.6g} s, {steps[k] / ordinary:.0f} steps of "
            f"{ordinary:.4g} s; at most {LONGEST_GAP:.0f} steps are filled.{more}",
            where=float(seconds[k]),
            found=float(steps[k]),
            limit=LONGEST_GAP * ordinary,
            advice="Keep a part without it with `time_range`, or split the log there.",
        )
    missing = int(np.maximum(np.rint(steps[gaps] / ordinary) - 1, 1).sum())
    samples = seconds.size + missing
    if missing > MISSING_LIMIT * samples:
        raise LogTimeError(
            f"{path}: {missing} samples are missing in {gaps.size} short gaps, {100 * missing / samples:.2g} % of "
            f"the log; at most {100 * MISSING_LIMIT:g} % are filled.",
            where=path,
            found=missing / samples,
            limit=MISSING_LIMIT,
            advice="Keep a part without them with `time_range`, or leave `time` out and give `rate_hz` if the samples "
            "are regular and only their stamps are not.",
        )
    return missing


def interpolate(base: TimeBase, values: Array, kind: Literal["position", "torque"], out: Array) -> None:
    """Interpolate samples at the stamps to the grid.

    Positions are smooth and take a cubic spline; torques have edges (dry friction, limits) and take the monotone
    cubic of Fritsch and Butland (1984), SIAM J. Scientific and Statistical Computing 5(2), which does not overshoot.

    Args:
        base: stamps (m,) and grid (n,).
        values: (m,).
        kind: of the values.
        out: (n,), written.
    """
    for start in range(0, base.t.size, SAMPLES_RESAMPLED):
        stop = min(start + SAMPLES_RESAMPLED, base.t.size)
        low, high = around(base, start, stop)
        out[start:stop] = curve(base, values[low:high], low, kind)(base.t[start:stop])


def around(base: TimeBase, start: int, stop: int) -> tuple[int, int]:
    """First stamp and one past the last that grid points start..stop are interpolated from."""
    low = max(int(np.searchsorted(base.stamps, base.t[start])) - _MARGIN, 0)
    high = int(np.searchsorted(base.stamps, base.t[stop - 1])) + _MARGIN
    return low, min(high, base.stamps.size)


def curve(base: TimeBase, values: Array, low: int, kind: Literal["position", "torque"]) -> Callable[[Array], Array]:
    """Interpolant of samples at the stamps from `low` on, each channel along the last axis."""
    kinds = {"position": CubicSpline, "torque": PchipInterpolator}
    made: Callable[[Array], Array] = kinds[kind](base.stamps[low : low + values.shape[-1]], values, axis=-1)
    return made
