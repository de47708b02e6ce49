"""Checks of a log: raw channels in the unit of the file, and positions against the joints of a device."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid.errors import LogDataError, LogMismatchError
from haptid.log.units import PERIODS, scale

if TYPE_CHECKING:
    from haptid.log.formats.sniff import RawChannel
    from haptid.log.log import Log, Signal

_Range = tuple[float, float]

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
# Points at which two channels are compared before they are compared everywhere.
PROBES = 64
# A joint without limits that covers more than this is assumed to be in degrees, rad.
MOST_TURNS = 4 * math.pi
# A single joint without limits, a pendulum or a wheel, may turn so far, and so may one whose limits are a whole turn.
MOST_ALONE = 20 * math.pi
# So is one this many times beyond its limits, if the angle read as degrees fits them.
BEYOND = 2.0
# Joints that cover less than this are assumed to be in radians, deg; so small a motion identifies nothing anyway.
LEAST_SPAN_DEG = 3.0
# With limits: joints that cover less than this share of their range, if 57.3 times more still fits.
LEAST_SHARE = 0.02
# Share of its range by which a position may exceed its limits: stops are soft, and zeros are not exact.
SLACK = 0.05


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
            advice="Map the connected channel, or give its signal constant_ok=True if it is constant on purpose.",
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
        if at.size > 1 and size[at].min() >= span - 2 * usual:  # from one end to the other, again and again
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
    rank = max(min(int(0.999 * (sample.size - 1)), sample.size - 1 - JUMPS_ASIDE), 0)
    usual = float(np.partition(sample, rank)[rank])
    if largest > JUMP * usual and largest * abs(si) > JUMP_SI:
        steps = np.abs(np.diff(column))
        smallest = float(steps.min(where=steps > 0, initial=np.inf))
        if largest > JUMP_COUNTS * smallest:
            raise LogDataError(
                f"{path}: position channel {name!r} jumps by {largest:.6g} {signal.unit} in one sample at t = "
                f"{stamps[k + 1]:.6g} s, where 99.9 % of its steps are below {usual:.3g} {signal.unit}: lost counts, "
                "or two recordings in one.",
                where=(name, float(stamps[k + 1])),
                found=largest,
                limit=usual,
                advice="Keep a part without it with `time_range`, or leave the moment out with `exclude` if the "
                "position comes back.",
            )


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

    A coarse torque also repeats its extreme, see `NEXT_SHARE`; so does one at rest, which is not counted.

    Args:
        path, name: of the file and of the channel.
        column: (m,), in the unit of the file.
        bits: whether its position changed from each sample to the next (any position, where they are not in
            pairs), packed, (m - 1,).
        signal: the torques.
    """
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
                raise LogDataError(
                    f"{path}: torque channel {name!r} stays exactly at its extreme {extreme:.6g} {signal.unit} for "
                    f"{100 * share:.2g} % of the samples (limit {100 * HELD_SHARE:g} %): it is saturated, and the "
                    "actual torque there is unknown.",
                    where=name,
                    found=share,
                    limit=HELD_SHARE,
                    advice="Record a slower motion, leave these parts out with `exclude`, or give `allow_saturation = "
                    "true` if the command is the torque that acted.",
                )
            return (
                f"torque channel {name!r} is saturated at {extreme:.6g} {signal.unit} for "
                f"{100 * share:.2g} % of the samples, as allowed"
            )
    return None


def _held(at: NDArray[np.bool_], moving: NDArray[np.bool_]) -> int:
    """Number of samples in runs of at least `HELD_SAMPLES` with motion."""
    edges = np.flatnonzero(np.diff(at, prepend=False, append=False))
    begin, end = edges[::2], edges[1::2]
    moves = np.flatnonzero(moving)  # the sample before each move
    moved = np.searchsorted(moves, end - 1) > np.searchsorted(moves, begin)
    counts = (end - begin >= HELD_SAMPLES) & moved
    return int((end - begin)[counts].sum())


def check_against(
    log: Log, position_ranges: Sequence[_Range | None], prismatic: Sequence[bool], names: Sequence[str]
) -> tuple[str, ...]:
    """Compare positions with the limits of their joints, to find wrong units and swapped channels.

    Only joint-side positions can be compared; a log of the motor side passes.

    Args:
        log: the recording.
        position_ranges: limits of each position channel's joint, rad or m; None where unknown.
        prismatic: whether each joint is prismatic.
        names: of the joints.

    Returns:
        A note for each joint outside its limits for no such cause, and for a single joint that turns.

    Raises:
        LogMismatchError: an angle in radians that is plausible only as degrees, angles in degrees that are plausible
            only as radians, or two channels, each within the other's limits and not its own.
    """
    count = len(log.channels.position.channels)
    if log.channels.position.side != "joint" or not len(position_ranges) == len(prismatic) == len(names) == count:
        return ()
    spans = list(log.spans)
    angles = [k for k in range(count) if not prismatic[k]]
    own = log.channels.position.each_unit
    _check_kinds(own, prismatic, names)
    degrees = [k for k in angles if own[k] == "deg"]
    if degrees:
        _check_radians(degrees, spans, position_ranges, names)
    else:
        usual = float(np.median([spans[k][1] - spans[k][0] for k in angles])) if angles else 0.0
        for k in angles:
            if position_ranges[k] is None and usual < 2 * math.pi:  # one joint turns, the others are no degrees
                continue
            limits = position_ranges[k]
            whole = len(angles) == 1 if limits is None else limits[1] - limits[0] > 2 * math.pi - SLACK
            if whole and spans[k][1] - spans[k][0] < MOST_ALONE:
                continue
            _check_degrees(names[k], log.channels.position.channels[k], spans[k], position_ranges[k])
    _check_swapped(log, spans, position_ranges, prismatic, names)
    turned = tuple(
        f"joint {names[k]} turns {(spans[k][1] - spans[k][0]) / (2 * math.pi):.1f} times; "
        "if it does not, its unit is wrong"
        for k in angles
        if len(angles) == 1 and position_ranges[k] is None and spans[k][1] - spans[k][0] > MOST_TURNS
    )
    return turned + tuple(
        f"joint {name} runs from {low:.4g} to {high:.4g}, outside its limits {limits[0]:.4g} .. {limits[1]:.4g}"
        for name, (low, high), limits in zip(names, spans, position_ranges, strict=True)
        if limits is not None and not _inside((low, high), limits)
    )


def _check_kinds(own: Sequence[str], prismatic: Sequence[bool], names: Sequence[str]) -> None:
    """Refuse an angle in a unit of length, and a length in a unit of angle; SI's own of either are the same figures."""
    fitting = ", ".join('"mm"' if straight else '"deg"' for straight in prismatic)
    for unit, straight, name in zip(own, prismatic, names, strict=True):
        wanted = "m" if straight else "rad"
        si, factor = scale(unit, "position")
        if si not in (wanted, "counts") and factor != 1.0:
            raise LogMismatchError(
                f"the position of joint {name} is in {unit!r}, and the joint is "
                f"{'prismatic' if straight else 'revolute'}.",
                where=name,
                found=unit,
                limit=wanted,
                advice=f"Write one unit for each channel: unit = [{fitting}].",
            )


def _inside(span: _Range, limits: _Range) -> bool:
    slack = SLACK * (limits[1] - limits[0])
    return limits[0] - slack <= span[0] and span[1] <= limits[1] + slack


def _times(span: _Range, factor: float) -> _Range:
    return span[0] * factor, span[1] * factor


def _check_degrees(name: str, channel: str, span: _Range, limits: _Range | None) -> None:
    low, high = span
    if limits is None:
        if high - low > MOST_TURNS:
            raise _degrees(name, channel, low, high, None)
        return
    furthest = max(abs(limits[0]), abs(limits[1]))
    beyond = max(abs(low), abs(high)) > BEYOND * furthest
    if beyond and _inside(_times(span, math.pi / 180), limits):
        raise _degrees(name, channel, low, high, limits)


def _check_radians(
    angles: Sequence[int], spans: Sequence[_Range], ranges: Sequence[_Range | None], names: Sequence[str]
) -> None:
    def small(k: int) -> bool:
        limits, (low, high) = ranges[k], spans[k]
        if limits is None:
            return math.degrees(high - low) < LEAST_SPAN_DEG
        fits = _inside(_times(spans[k], 180 / math.pi), limits)
        return fits and high - low < LEAST_SHARE * (limits[1] - limits[0])

    if angles and all(small(k) for k in angles):
        widest = max(angles, key=lambda k: spans[k][1] - spans[k][0])
        span = math.degrees(spans[widest][1] - spans[widest][0])
        limits = ranges[widest]
        limit = LEAST_SPAN_DEG if limits is None else math.degrees(LEAST_SHARE * (limits[1] - limits[0]))
        raise LogMismatchError(
            f"with unit 'deg' no joint moves more than {span:.3g} deg (joint {names[widest]}), below {limit:g} deg; "
            "as radians the motion would be plausible.",
            where=names[widest],
            found=span,
            limit=limit,
            advice="Give the position signal unit='rad'; if the motion really is this small, unit='rad' with "
            "gain=pi/180.",
        )


def _check_swapped(
    log: Log,
    spans: Sequence[_Range],
    ranges: Sequence[_Range | None],
    prismatic: Sequence[bool],
    names: Sequence[str],
) -> None:
    channels = log.channels.position.channels
    for k, (span, limits) in enumerate(zip(spans, ranges, strict=True)):
        if limits is None or _inside(span, limits):
            continue
        for j, (other, others) in enumerate(zip(spans, ranges, strict=True)):
            if j == k or others is None or prismatic[j] != prismatic[k]:
                continue
            if _inside(other, limits) and _inside(span, others):
                reach = _furthest(span, limits)
                raise LogMismatchError(
                    f"joint {names[k]} (channel {channels[k]!r}) reaches {reach:.4g}, outside its limits "
                    f"{limits[0]:.4g} .. {limits[1]:.4g}, while channel {channels[j]!r} of joint {names[j]} is within "
                    "them, and the other way round.",
                    where=(names[k], names[j]),
                    found=reach,
                    limit=limits,
                    advice="Exchange the two channels, or correct the limits.",
                )


def _furthest(span: _Range, limits: _Range) -> float:
    """The end of a span that is further from the middle of the limits."""
    return max(span, key=lambda end: abs(end - 0.5 * (limits[0] + limits[1])))


def _degrees(name: str, channel: str, low: float, high: float, limits: _Range | None) -> LogMismatchError:
    """Error of an angle in radians that is plausible only as degrees."""
    why = f"{(high - low) / (2 * math.pi):.1f} turns"
    if limits:
        why = f"far beyond its limits {limits[0]:.4g} .. {limits[1]:.4g} rad"
    return LogMismatchError(
        f"joint {name} (channel {channel!r}) runs from {low:.4g} to {high:.4g} rad, {why}; divided by 57.3 it would be "
        "plausible.",
        where=name,
        found=(low, high),
        limit=limits,
        advice="Give the position signal unit='deg', or correct the joint's limits."
        if limits
        else "Give the position signal unit='deg', or, if it turns so far, give the joint limits in the device file.",
    )


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
        f"{path}: {first} has {size} samples and {name} has {other}.",
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
