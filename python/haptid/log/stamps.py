"""Stamps of a log's rows: unit, resolution, order, and rows that were written twice."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import LogTimeError
from haptid.log.checks import all_usable, non_finite, usable

if TYPE_CHECKING:
    from haptid.log.formats.sniff import RawChannel

FEWEST_SAMPLES = 50
# Longest sampling period, s; a longer one almost certainly means stamps in another unit.
SLOWEST = 0.5
# Shortest one: no log has more than a gigahertz. Below the other one, faster than loops and recorders of machines, the
# unit is doubted.
_FASTEST, _DOUBTED = 1e-9, 5e-6
# Share of the rows that follow at once, at most, where rows come in bursts, and pause between these, usual steps.
_IN_BURSTS, _LATER = 0.9, 10.0
# Stamps this many times coarser than the sampling do not give the rate.
COARSEST = 10.0
# Largest distance of the first stamp after a restart from the log's first one, steps. The gap that is put between two
# recordings: the longer one of these seconds and steps.
_RESTART, _PAUSE, _PAUSE_STEPS = 10.0, 1.0, 20.0
# Samples that are looked at together.
_PIECE = 2**16


@dataclass(frozen=True, eq=False)
class Stamps:
    """Stamps of the rows that are kept.

    Attributes:
        repeated: rows whose stamp equals that of the row before, (repeats,).
        seconds: of all rows, not decreasing, (rows,), s.
        fineness: resolution, s.
        notes: what was changed, in sentences.
    """

    repeated: NDArray[np.intp]
    seconds: Array
    fineness: float
    notes: tuple[str, ...] = ()


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
    pieces = [raw[start : start + _PIECE] for start in range(0, raw.size, _PIECE)]
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


def too_fast(steps: Array) -> bool:
    """Whether steps of times, s, are shorter than those of machines' loops and recorders, and no bursts of rows."""
    step, pause = np.quantile(steps, (0.5, _IN_BURSTS))
    return bool(0 < step < _DOUBTED and pause < _LATER * step)


def checked(path: Path, name: str, seconds: Array, fineness: float) -> Stamps:
    """Stamps that are in order, in a plausible unit, and fine enough to give the rate.

    Args:
        path, name: of the file and of the time channel.
        seconds: stamps, (rows,), s.
        fineness: resolution of the stamps, s.

    Raises:
        LogDataError: a stamp is missing.
        LogTimeError: a stamp is earlier than the one before; fewer than `FEWEST_SAMPLES`; a sampling period above
            `SLOWEST`; stamps coarser than `COARSEST` periods.
    """
    check_length(path, seconds.size)
    seconds, notes = _restarted(seconds)
    check_order(path, name, seconds)
    steps = np.diff(seconds[:_PIECE])
    step = float(np.median(steps))
    if step > SLOWEST:
        raise LogTimeError(
            f"{path}: the time channel {name!r} implies a sampling period of {step:.3g} s (maximum {SLOWEST:g} s).",
            where=name,
            found=step,
            limit=SLOWEST,
            advice="Give the channel's `time_unit`: 'ms', 'us' or 'ns'.",
        )
    if 0 < step < _FASTEST:
        raise LogTimeError(
            f"{path}: the time channel {name!r} implies a sampling period of {step:.3g} s (minimum {_FASTEST:g} s).",
            where=name,
            found=step,
            limit=_FASTEST,
            advice="Give the channel's `time_unit` as it was recorded.",
        )
    if too_fast(steps):
        notes += (
            f"the time channel {name!r} implies {1 / step:.3g} Hz, faster than machines are recorded: its "
            "`time_unit` is probably coarser",
        )
    repeated = check_repeats(path, name, seconds)
    return Stamps(repeated, seconds, fineness, notes)


def check_repeats(path: Path, name: str, seconds: Array, advice: str = "") -> NDArray[np.intp]:
    """Rows whose stamp equals that of the row before; stamps of which most do are refused, with this advice."""
    repeated = np.flatnonzero(seconds[1:] == seconds[:-1]) + 1
    if repeated.size > (1 - 1 / COARSEST) * seconds.size:
        raise LogTimeError(
            f"{path}: {repeated.size} of {seconds.size} stamps in {name!r} equal the one before, so that the rate is "
            "unknown.",
            where=name,
            found=repeated.size / seconds.size,
            limit=1 - 1 / COARSEST,
            advice=advice
            or "Stamps are coarser than the sampling (a clock of the epoch in single precision, whole seconds): "
            "leave `time` out and give `rate_hz`.",
        )
    return repeated


def _restarted(seconds: Array) -> tuple[Array, tuple[str, ...]]:
    """Stamps of recordings one after the other in one file, each with times from its start, as one log with pauses.

    Only where each of them begins where the first one does and is long enough for a segment; else they are returned as
    they are.
    """
    if not all_usable(seconds):
        return seconds, ()
    starts = np.flatnonzero(seconds[1:] < seconds[:-1]) + 1
    if not starts.size:
        return seconds, ()
    edges = np.array([0, *starts, seconds.size])
    step = float(np.median(np.abs(np.diff(seconds[: starts[0]])))) if starts[0] > 1 else 0.0
    late = np.abs(seconds[starts] - seconds[0])
    if np.diff(edges).min() < FEWEST_SAMPLES or late.max() > _RESTART * step:
        return seconds, ()
    pause = max(_PAUSE, _PAUSE_STEPS * step)
    made = seconds.copy()
    for start, stop in pairwise(edges[1:]):
        made[start:stop] += made[start - 1] + pause - seconds[start]
    first = int(starts[0])
    return made, (
        f"time restarts at sample {first}, from {seconds[first - 1]:.6g} to {seconds[first]:.6g} s"
        f"{f', and at {starts.size - 1} more places' if starts.size > 1 else ''}: {starts.size + 1} recordings in one "
        f"file, taken as segments of one log, {pause:.3g} s apart",
    )


def check_order(path: Path, name: str, seconds: Array, advice: str = "") -> None:
    """Refuse stamps that are missing, or earlier than the one before, with this advice."""
    if not all_usable(seconds):
        bad = ~usable(seconds)
        raise non_finite(path, name, int(np.count_nonzero(bad)), int(np.argmax(bad)), None)
    back = np.flatnonzero(seconds[1:] < seconds[:-1])
    if back.size:
        k = int(back[0])
        more = f", and at {back.size - 1} more places" if back.size > 1 else ""
        raise LogTimeError(
            f"{path}: time decreases at sample {k + 1} of {name!r}, from {seconds[k]:.9g} to {seconds[k + 1]:.9g} s"
            f"{more}.",
            where=k + 1,
            found=(float(seconds[k]), float(seconds[k + 1])),
            advice=advice
            or "Either the clock was set or restarted, or two recordings are in one file (split them, or keep one "
            "with `time_range`), a counter of the clock overflowed, or rows are out of order; if only the stamps are "
            "wrong, leave `time` out and give `rate_hz`.",
        )
