"""Checks of a log's raw channels, in the unit of the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid.errors import LogDataError
from haptid.log.units import PERIODS

if TYPE_CHECKING:
    from haptid.log.formats.sniff import RawChannel
    from haptid.log.log import Signal

# Largest magnitude of a sample in any unit: a larger one comes from damaged bytes, and its powers overflow.
_LARGEST = 1e30
# Smallest range of a channel that varies, and largest value, SI: powers of others underflow or overflow.
_LEAST_SI, _LARGEST_SI = 1e-30, 1e12
# A step is a jump if it is longer than JUMP times the 99.9 % quantile of the steps,
JUMP = 50.0
# and than this many times the smallest step (a coarse encoder moves by whole counts),
JUMP_COUNTS = 20.0
# and than this, rad or m. The largest JUMPS_ASIDE steps, which may be jumps, are excluded from the quantile.
JUMP_SI = 1e-3
JUMPS_ASIDE = 4
# Steps that are computed at a time.
SAMPLES_CHECKED = 2**14
# Steps above which the quantile is estimated from every second one, every third one, ...
SAMPLED = 2**16
# Smallest range of a counter that wraps.
SMALLEST_PERIOD = 2.0**10
# A torque is saturated if it stays at its extreme for this many samples in a row, for this share of the log,
HELD_SAMPLES = 5
HELD_SHARE = 0.01
# and if the level next to the extreme is rarer than this share of it: at the crest of a coarse but unclipped sine
# the next level is taken at least sqrt(2) - 1 = 0.41 times as often as the extreme.
NEXT_SHARE = 0.25
# A torque at each of its extremes and at both for these shares of the log is one that was switched between them.
RELAY_EACH, RELAY_BOTH = 0.1, 0.98
# Torques that are never negative, and all come nearer to zero than this share of their largest, may have no sign.
NEAR_ZERO = 0.05
# Samples of a value that is far from those before and after it, at most: a damaged row, and no turn of a sensor.
SPIKE = 3
# Such moments that are listed, at most.
SPIKES = 20
# Points at which two channels are compared before they are compared everywhere.
PROBES = 64


def usable(column: RawChannel) -> NDArray[np.bool_]:
    """Where a column holds a finite number not beyond `LARGEST`."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.abs(column) < _LARGEST)


def all_usable(column: RawChannel) -> bool:
    """Whether every sample is `usable`, from the extremes alone, without a mask of all samples."""
    return column.size == 0 or bool(column.min() > -_LARGEST and column.max() < _LARGEST)


def lengths(path: Path, columns: Mapping[str, RawChannel]) -> int:
    """The common number of samples."""
    (first, column), *others = columns.items()
    for name, other in others:
        if other.size != column.size:
            raise unequal_lengths(path, first, column.size, name, other.size)
    return column.size


def refuse_nonfinite(path: Path, name: str, column: RawChannel, stamps: Array) -> None:
    """Refuse NaN and infinities."""
    if column.dtype.kind != "f" or all_usable(column):
        return
    bad = ~usable(column)
    first = int(np.argmax(bad))
    raise non_finite(path, name, int(np.count_nonzero(bad)), first, float(stamps[first]))


def check_range(path: Path, name: str, column: RawChannel, quantity: str, ok: bool, si: float) -> str | None:
    """Refuse a channel whose range cannot be that of a motion; returns a note where it is constant and allowed to be.

    Args:
        path, name, column, quantity: file and channel, in the file's unit.
        ok: whether it may be constant.
        si: factor to SI.

    Raises:
        LogDataError: it is constant, or varies by less than LEAST_SI or reaches beyond LARGEST_SI.
    """
    low, high = float(column.min()), float(column.max())
    if low != high:
        span, largest = abs(si) * (high - low), abs(si) * max(-low, high)
        if not (span >= _LEAST_SI and largest <= _LARGEST_SI):
            raise LogDataError(
                f"{path}: {quantity} channel {name!r} varies by {span:.3g} and reaches {largest:.3g} in SI units; its "
                f"range must be at least {_LEAST_SI:g}, its values at most {_LARGEST_SI:g}.",
                where=name,
                found=(span, largest),
                limit=(_LEAST_SI, _LARGEST_SI),
                advice="Check its unit and its gain.",
            )
        return None
    if not ok:
        raise LogDataError(
            f"{path}: {quantity} channel {name!r} is {column[0]:.6g} in every sample: it is not connected, or nothing "
            "moved.",
            where=name,
            found=float(column[0]),
            advice="Map the connected channel, or give its signal `constant_ok = true` if it is constant on purpose.",
        )
    return f"{quantity} channel {name!r} is {column[0]:.6g} in every sample, as allowed"


def identical(path: Path, columns: Mapping[str, RawChannel]) -> None:
    """Refuse two channels that are equal in every sample and not constant."""
    for (name, column), (other, rival) in combinations(columns.items(), 2):
        probe = slice(None, None, max(1, column.size // PROBES))
        if (
            np.array_equal(column[probe], rival[probe])
            and np.array_equal(column, rival)
            and column.min() != column.max()
        ):
            raise identical_channels(path, name, other)


def period(signal: Signal, largest: float) -> float | None:
    """Period of a wrapped channel in its own unit; None where the unit has none.

    Args:
        signal: the positions.
        largest: the longest step, in their unit.
    """
    if signal.period is not None:
        return signal.period
    if signal.unit == "counts":
        return max(SMALLEST_PERIOD, float(2.0 ** np.rint(np.log2(largest)))) if largest > 0 else None
    return PERIODS.get(signal.unit)


# A channel of no more values than this, told apart at this many in its range, stands between steps of its encoder.
_LEVELS, _FINE = 8, 1e6


def wrap_period(column: Array, signal: Signal, largest: float) -> tuple[float, int, int] | None:
    """Period by which a channel jumps, the first sample after a jump, and the number of jumps; None where it does not.

    The period is that of the unit, or the channel's own range, as of a drive's register of -12.5 to 12.5 rad.

    Args:
        column: (m,), in the unit of the file.
        signal: the positions.
        largest: the longest step.
    """
    span = float(np.ptp(column))
    for turn in (period(signal, largest), span):
        if turn is None or not 0 < 0.5 * turn <= largest:
            continue
        steps = np.diff(column)
        size = np.abs(steps)
        wraps = size >= 0.5 * turn
        usual = float(size.max(where=~wraps, initial=0.0))
        at = np.flatnonzero(wraps)
        if usual > turn / 8:
            continue
        if turn != span and abs(largest - turn) <= 2 * usual + 1e-3 * turn:
            return turn, int(at[0]) + 1, at.size
        ends = at.size > 1 and size[at].min() >= span - 2 * usual  # from one end to the other, again and again
        if ends and np.median(np.diff(at)) > SPIKE and np.unique(np.rint(column * (_FINE / span))).size > _LEVELS:
            own = size[at] + size[np.clip(at + 1, 0, size.size - 1)]  # the motion goes on, against the jump
            return _round(float(np.median(own)), 0.5 * usual), int(at[0]) + 1, at.size
    return None


def _round(value: float, error: float) -> float:
    """The number of the fewest digits that is within an error of a value."""
    rounded = (float(f"{value:.{digits}g}") for digits in range(1, 8))
    return next((number for number in rounded if abs(number - value) <= error), value)


def jumps(
    path: Path, name: str, column: Array, stamps: Array, signal: Signal, si: float, gaps: NDArray[np.intp]
) -> None:
    """Refuse a position with jumps, or one that wraps and is not to be unwrapped.

    Args:
        path, name: of the file and of the channel.
        column: (m,), in the unit of the file.
        stamps: (m,), s.
        signal: the positions.
        si: rad or m in one of that unit.
        gaps: samples before a gap in time, over which a position may move by more.
    """
    if gaps.size:
        across = column[gaps + 1] - column[gaps]
        column = column - wrap_offset(gaps + 1, np.cumsum(across), 0, column.size)
    k, largest, sample = _steps(column)
    if found := wrap_period(column, signal, largest):
        turn, first, count = found
        own = "" if turn == PERIODS.get(signal.unit) else f" and `period = {turn:g}`"
        raise LogDataError(
            f"{path}: position channel {name!r} jumps by its whole period of {turn:.6g} {signal.unit} at t = "
            f"{stamps[first]:.6g} s ({count} times in the log): it is wrapped.",
            where=(name, float(stamps[first])),
            found=turn,
            advice=f"Unwrap it before saving, or give its signal `unwrap = true`{own}.",
        )
    usual = _usual(sample)
    if largest > JUMP * usual and largest * abs(si) > JUMP_SI:
        steps = np.abs(np.diff(column))
        smallest = float(steps.min(where=steps > 0, initial=np.inf))
        if largest > JUMP_COUNTS * smallest:
            cause, advice = _cause_of_jump(column, stamps, max(JUMP * usual, JUMP_SI / abs(si)))
            raise LogDataError(
                f"{path}: position channel {name!r} jumps by {largest:.6g} {signal.unit} in one sample at t = "
                f"{stamps[k + 1]:.6g} s, where 99.9 % of its steps are below {usual:.3g} {signal.unit}: {cause}.",
                where=(name, float(stamps[k + 1])),
                found=largest,
                limit=usual,
                advice=advice,
            )


def _cause_of_jump(column: Array, stamps: Array, limit: float) -> tuple[str, str]:
    """What a position's jumps are, and what to do.

    Args:
        limit: length of a step from which it is a jump.
    """
    ranges = _damaged(column, stamps, limit)
    if not 0 < len(ranges) <= SPIKES:
        general = "Keep a part without it with `time_range`, or leave the moment out with `exclude` if the position "
        return "lost counts, or two recordings in one", f"{general}comes back."
    shown = ", ".join(f"[{low:.9g}, {high:.9g}]" for low, high in ranges)
    advice = f"Give this log `exclude = [{shown}]`."
    if ranges[0][0] == stamps[0]:
        return "the first rows are of another moment, as of an earlier run", advice
    rows = "a damaged row" if len(ranges) == 1 else f"damaged rows at {len(ranges)} moments"
    return f"{rows}, as the position comes back", advice


def _damaged(column: Array, stamps: Array, limit: float) -> list[tuple[float, float]]:
    """Ranges of time around few samples that are far from their neighbours, s; none where a jump does not come back.

    The first samples have no neighbours before them.
    """
    at = np.flatnonzero(np.abs(np.diff(column)) > limit)
    edges, made = 0.5 * (stamps[1:] + stamps[:-1]), list[tuple[float, float]]()
    if at.size % 2 and at[0] < SPIKE:
        made, at = [(float(stamps[0]), float(edges[at[0]]))], at[1:]
    there, back = at[::2], at[1::2]
    if there.size != back.size or (back - there > SPIKE).any():
        return []
    if (np.abs(column[back + 1] - column[there]) > limit).any():
        return []
    return [*made, *zip(edges[there].tolist(), edges[back].tolist(), strict=True)]


def refuse_lost_counts(
    path: Path, name: str, column: Array, stamps: Array, si: float, left_out: NDArray[np.bool_], gaps: NDArray[np.intp]
) -> None:
    """Refuse a position that jumps in a part that is left out, and does not come back there: all later ones are wrong.

    Args:
        path, name: of the file and of the channel.
        column: (m,), in the unit of the file, with the parts.
        stamps: (m,), s.
        si: rad or m in one of that unit.
        left_out: (m,), whether a sample is in such a part.
        gaps: samples before a gap in time, over which a position may move by more.
    """
    steps = np.diff(column)
    inside = left_out[1:] | left_out[:-1]
    if not inside.any() or inside.all():
        return
    limit = max(JUMP * _usual(np.abs(steps[~inside])), JUMP_SI / abs(si))
    steps[gaps] = 0.0
    jumped = np.where(inside & (np.abs(steps) > limit), steps, 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    for start, stop in edges.reshape(-1, 2):
        away = float(jumped[start:stop].sum())
        if abs(away) > limit and not left_out[start] and not left_out[stop]:  # samples before and after it are used
            raise LogDataError(
                f"{path}: position channel {name!r} jumps in the part that is left out from t = {stamps[start]:.6g} to "
                f"{stamps[stop]:.6g} s and stays {away:.4g} away: its counts are lost from there on.",
                where=(name, float(stamps[start])),
                found=away,
                limit=limit,
                advice="List the log twice, with a `time_range` before and one after it, and correct the second one's "
                "`offset`, or let `[calibration]` estimate it with `each_log`.",
            )


def _usual(sample: Array) -> float:
    """The 99.9 % quantile of the lengths of steps, without the few largest."""
    rank = max(min(int(0.999 * (sample.size - 1)), sample.size - 1 - JUMPS_ASIDE), 0)
    return float(np.partition(sample, rank)[rank])


def _steps(column: Array) -> tuple[int, float, Array]:
    """Place and length of a column's longest step, and a sample of its steps; piece by piece."""
    every = max(1, (column.size - 1) // SAMPLED)
    piece = every * max(1, SAMPLES_CHECKED // every)
    sample = np.empty(-(-(column.size - 1) // every))
    room, at, largest = np.empty(min(piece, column.size - 1)), 0, -1.0
    for start in range(0, column.size - 1, piece):
        steps = room[: min(piece, column.size - 1 - start)]
        np.subtract(column[start + 1 : start + 1 + steps.size], column[start : start + steps.size], out=steps)
        np.abs(steps, out=steps)
        k = int(np.argmax(steps))
        if steps[k] > largest:
            at, largest = start + k, float(steps[k])
        few = steps[::every]
        sample[start // every : start // every + few.size] = few
    return at, largest, sample


def find_wraps(column: Array, signal: Signal) -> tuple[NDArray[np.intp], Array]:
    """Samples at which a wrapped channel jumps, and the offset to subtract from each of them on, each (jumps,)."""
    steps = np.diff(column)
    turn = period(signal, float(np.abs(steps).max()))
    if turn is None:
        return np.empty(0, np.intp), np.empty(0)
    whole = np.rint(np.divide(steps, turn, out=steps), out=steps)
    before = np.flatnonzero(whole)
    return before + 1, np.cumsum(whole[before]) * turn


def wrap_offset(at: NDArray[np.intp], shift: Array, low: int, high: int) -> Array:
    """Offset by `find_wraps` to subtract from samples low..high, (high - low,)."""
    return np.asarray(np.append(0.0, shift)[np.searchsorted(at, np.arange(low, high), side="right")])


def unwrapped(column: Array, signal: Signal) -> tuple[Array, int]:
    """The column unwrapped, (m,), and the number of jumps."""
    at, shift = find_wraps(column, signal)
    return (column - wrap_offset(at, shift, 0, column.size) if at.size else column), at.size


def saturated(path: Path, name: str, column: Array, bits: NDArray[np.uint8], signal: Signal) -> str | None:
    """Refuse a torque that saturates at its extreme; returns a note instead where that is allowed.

    A coarse torque also repeats its extreme, see `NEXT_SHARE`; so does one at rest, which is not counted. One that is
    switched between two levels, as by a relay, has no other values.

    Args:
        path, name: of the file and of the channel.
        column: (m,), in the unit of the file.
        bits: whether its position changed from each sample to the next (any position, where they are not in
            pairs), packed, (m - 1,).
        signal: the torques.
    """
    extremes = [float(x(column)) for x in (np.min, np.max)]
    shares = [np.count_nonzero(column == extreme) / column.size for extreme in extremes]
    if extremes[0] < extremes[1] and min(shares) > RELAY_EACH and sum(shares) > RELAY_BOTH:
        both = f"{extremes[0]:.6g} and {extremes[1]:.6g} {signal.unit}"
        return f"torque channel {name!r} alternates between {both}, as of a relay: taken as the torque that acted"
    for extreme, sign in ((float(column.max()), 1.0), (float(column.min()), -1.0)):
        at = column == extreme
        level = int(np.count_nonzero(at))
        if level <= HELD_SHARE * column.size or level == column.size:
            continue
        neighbour = column.max(where=~at, initial=-np.inf) if sign > 0 else column.min(where=~at, initial=np.inf)
        if np.count_nonzero(column == neighbour) >= NEXT_SHARE * level:
            continue
        moving = np.unpackbits(bits, count=column.size - 1).view(bool)
        share = _held(at, moving) / column.size
        if share > HELD_SHARE:
            if not signal.allow_saturation:
                raise _unknown_torque(path, name, extreme, signal.unit, share)
            return (
                f"torque channel {name!r} is saturated at {extreme:.6g} {signal.unit} for "
                f"{100 * share:.2g} % of the samples, as allowed"
            )
    return None


def _unknown_torque(path: Path, name: str, extreme: float, unit: str, share: float) -> LogDataError:
    """Error of a torque that stays at its extreme during motion: a drive at its limit, or, at zero, a dead channel."""
    extreme = extreme or 0.0  # not -0
    if extreme:
        why, remedy = "it is saturated, and the actual torque there is unknown", "Record a slower motion"
    else:
        why = "it shows one direction only, or is dead there, and the actual torque there is unknown"
        remedy = "Check its wiring and whether it was recorded with its sign"
    return LogDataError(
        f"{path}: torque channel {name!r} stays exactly at its extreme {extreme:.6g} {unit} for {100 * share:.2g} % of "
        f"the samples (limit {100 * HELD_SHARE:g} %): {why}.",
        where=name,
        found=share,
        limit=HELD_SHARE,
        advice=f"{remedy}, leave these parts out with `exclude`, or give `allow_saturation = true` if the command is "
        "the torque that acted.",
    )


def _held(at: NDArray[np.bool_], moving: NDArray[np.bool_]) -> int:
    """Number of samples in runs of at least `HELD_SAMPLES` with motion."""
    edges = np.flatnonzero(np.diff(at, prepend=False, append=False))
    begin, end = edges[::2], edges[1::2]
    moves = np.flatnonzero(moving)  # the sample before each move
    moved = np.searchsorted(moves, end - 1) > np.searchsorted(moves, begin)
    counts = (end - begin >= HELD_SAMPLES) & moved
    return int((end - begin)[counts].sum())


def non_finite(path: Path, name: str, count: int, index: int, time: float | None) -> LogDataError:
    """Error of samples that are not finite, the first at an index and, where it is known, a time, s."""
    when = "" if time is None else f" (t = {time:.6g} s)"
    samples = "1 sample" if count == 1 else f"{count} samples"
    return LogDataError(
        f"{path}: channel {name!r} is missing, infinite or beyond {_LARGEST:g} at {samples}, first at sample "
        f"{index}{when}.",
        where=(name, index),
        found=count,
        advice="Delete these rows of the file."
        if time is None
        else "Use `time_range` to keep a part without them, or repair the log.",
    )


def unequal_lengths(path: Path, first: str, size: int, name: str, other: int) -> LogDataError:
    """Error of two channels with different numbers of samples."""
    return LogDataError(
        f"{path}: {first} has {size} samples and {name} has {other}, {abs(size - other)} "
        f"{'more' if other > size else 'fewer'}.",
        where=(first, name),
        found=(size, other),
        advice="All mapped channels must be sampled together: bring them to one time base first.",
    )


def identical_channels(path: Path, name: str, other: str) -> LogDataError:
    """Error of two channels that are equal."""
    return LogDataError(
        f"{path}: channels {name!r} and {other!r} are equal in every sample: one was recorded in place of the other.",
        where=(name, other),
        advice="Map two different channels.",
    )


def without_sign(ranges: Sequence[tuple[float, float]]) -> str | None:
    """A note where several torques may be magnitudes: never negative, and near zero at times, as where a sign changes.

    Args:
        ranges: of the torque channels, each (low, high).
    """
    varying = [(low, high) for low, high in ranges if low != high]
    if len(varying) < 2 or not all(0 <= low <= NEAR_ZERO * high for low, high in varying):
        return None
    return (
        f"all {len(varying)} torque channels are never negative and come near zero: if they are magnitudes, as some "
        "servos give their current and load, no model fits them; record them with their sign"
    )
