"""What is wrong with samples: each check takes a raw channel, in the unit of the file."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid.errors import (
    DeadChannelError,
    IdenticalChannelsError,
    NonFiniteError,
    PositionJumpError,
    RepeatedStampError,
    SaturatedTorqueError,
    UnequalChannelsError,
    WrappedPositionError,
)
from haptid.log.formats.content import Column, all_usable, usable
from haptid.log.log import Signal
from haptid.log.units import PERIODS

# A step is a jump if it is longer than this many of the steps that only one in a thousand exceeds,
JUMP = 50.0
# and than this many of the smallest ones (a coarse encoder moves by whole counts),
JUMP_COUNTS = 20.0
# and than this many rad or m. A few steps may be jumps, so the largest JUMPS_ASIDE never count as usual.
JUMP_SI = 1e-3
JUMPS_ASIDE = 4
# Steps that are made at a time.
PIECE = 2**14
# From that many steps on, every other one, or third, ... tells what is usual.
SAMPLED = 2**16
# Counters that wrap have at least this many bits.
SMALLEST_PERIOD = 2.0**10
# A torque is saturated if it stays at its extreme for so many samples in a row, for this share of the log,
HELD_SAMPLES = 5
HELD_SHARE = 0.01
# and if it takes the value next to the extreme this much more rarely: at the crest of a coarse but unclipped
# sine the next level is taken at least sqrt(2) - 1 = 0.41 times as often as the extreme.
NEXT_SHARE = 0.25
# Points at which two channels are compared before they are compared everywhere.
PROBES = 64


def lengths(path: Path, columns: Mapping[str, Column]) -> int:
    """The common number of samples."""
    (first, column), *others = columns.items()
    for name, other in others:
        if other.size != column.size:
            raise UnequalChannelsError(path, first, column.size, name, other.size)
    return column.size


def finite(path: Path, name: str, column: Column, stamps: Array) -> None:
    """Refuse NaN and infinities."""
    if column.dtype.kind != "f" or all_usable(column):
        return
    bad = ~usable(column)
    first = int(np.argmax(bad))
    raise NonFiniteError(path, name, int(np.count_nonzero(bad)), first, float(stamps[first]))


def repeats(path: Path, columns: Mapping[str, Column], stamps: Array, repeated: NDArray[np.intp]) -> None:
    """Refuse equal stamps on samples that differ."""
    for name, column in columns.items():
        differing = repeated[column[repeated] != column[repeated - 1]]
        if differing.size:
            first = int(differing[0])
            raise RepeatedStampError(path, repeated.size, stamps.size, first, float(stamps[first]), name)


def constant(path: Path, name: str, column: Column, quantity: str, ok: bool) -> str | None:
    """Refuse a channel that never changes, unless it is meant to; then say so."""
    if column.min() != column.max():
        return None
    if not ok:
        raise DeadChannelError(path, name, float(column[0]), quantity)
    return f"{quantity} channel {name!r} is {column[0]:.6g} in every sample, as allowed"


def identical(path: Path, columns: Mapping[str, Column]) -> None:
    """Refuse two channels that are equal in every sample and not constant."""
    for (name, column), (other, rival) in combinations(columns.items(), 2):
        probe = slice(None, None, max(1, column.size // PROBES))
        if (
            np.array_equal(column[probe], rival[probe])
            and np.array_equal(column, rival)
            and column.min() != column.max()
        ):
            raise IdenticalChannelsError(path, name, other)


def period(signal: Signal, largest: float) -> float | None:
    """The jump of a wrapped channel in its own unit; None where the unit has none.

    Args:
        signal: the positions.
        largest: the longest step, in their unit.
    """
    if signal.period is not None:
        return signal.period
    if signal.unit == "counts":
        return max(SMALLEST_PERIOD, float(2.0 ** np.rint(np.log2(largest)))) if largest > 0 else None
    return PERIODS.get(signal.unit)


def jumps(path: Path, name: str, column: Array, stamps: Array, signal: Signal, si: float) -> None:
    """Refuse a position that leaps.

    Args:
        path, name: of the file and of the channel.
        column: (m,), in the unit of the file.
        stamps: (m,), s.
        signal: the positions.
        si: rad or m in one of that unit.
    """
    k, largest, sample = _steps(column)
    turn = period(signal, largest)
    if turn is not None and largest >= 0.5 * turn:
        steps = np.abs(np.diff(column))
        wraps = steps >= 0.5 * turn
        usual = float(steps.max(where=~wraps, initial=0.0))
        if usual <= turn / 8 and abs(largest - turn) <= 2 * usual + 1e-3 * turn:
            first = int(np.argmax(wraps)) + 1
            count = int(np.count_nonzero(wraps))
            raise WrappedPositionError(path, name, float(stamps[first]), turn, signal.unit, count)
    rank = max(min(int(0.999 * (sample.size - 1)), sample.size - 1 - JUMPS_ASIDE), 0)
    usual = float(np.partition(sample, rank)[rank])
    if largest > JUMP * usual and largest * abs(si) > JUMP_SI:
        steps = np.abs(np.diff(column))
        smallest = float(steps.min(where=steps > 0, initial=np.inf))
        if largest > JUMP_COUNTS * smallest:
            raise PositionJumpError(path, name, float(stamps[k + 1]), largest, signal.unit, usual)


def _steps(column: Array) -> tuple[int, float, Array]:
    """Where the longest step of a column is, its length, and steps that tell what is usual; piece by piece."""
    every = max(1, (column.size - 1) // SAMPLED)
    piece = every * max(1, PIECE // every)
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


def turns(column: Array, signal: Signal) -> tuple[NDArray[np.intp], Array]:
    """Samples at which a wrapped channel jumps, and what must be taken off from each of them on, each (jumps,)."""
    steps = np.diff(column)
    turn = period(signal, float(np.abs(steps).max()))
    if turn is None:
        return np.empty(0, np.intp), np.empty(0)
    whole = np.rint(np.divide(steps, turn, out=steps), out=steps)
    before = np.flatnonzero(whole)
    return before + 1, np.cumsum(whole[before]) * turn


def taken_off(at: NDArray[np.intp], shift: Array, low: int, high: int) -> Array:
    """What `turns` says must be taken off samples low..high, (high - low,)."""
    return np.asarray(np.append(0.0, shift)[np.searchsorted(at, np.arange(low, high), side="right")])


def unwrapped(column: Array, signal: Signal) -> tuple[Array, int]:
    """The column with whole periods put back, (m,), and the number of jumps."""
    at, shift = turns(column, signal)
    return (column - taken_off(at, shift, 0, column.size) if at.size else column), at.size


def saturated(path: Path, name: str, column: Array, bits: NDArray[np.uint8], signal: Signal) -> str | None:
    """Refuse a torque that was cut off at its extreme, unless that is allowed; then say so.

    A coarse torque also repeats its extreme, see `NEXT_SHARE`, and so does one at rest, which does not count.

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
        beside = column.max(where=~at, initial=-np.inf) if sign > 0 else column.min(where=~at, initial=np.inf)
        if np.count_nonzero(column == beside) >= NEXT_SHARE * level:
            continue
        moving = np.unpackbits(bits, count=column.size - 1).view(bool)
        share = _held(at, moving) / column.size
        if share > HELD_SHARE:
            if not signal.allow_saturation:
                raise SaturatedTorqueError(path, name, extreme, signal.unit, share, HELD_SHARE)
            return (
                f"torque channel {name!r} is saturated at {extreme:.6g} {signal.unit} for "
                f"{100 * share:.2g} % of the samples, as allowed"
            )
    return None


def _held(at: NDArray[np.bool_], moving: NDArray[np.bool_]) -> int:
    """Number of samples in runs of at least `HELD_SAMPLES` during which something moves."""
    edges = np.flatnonzero(np.diff(at, prepend=False, append=False))
    begin, end = edges[::2], edges[1::2]
    moves = np.flatnonzero(moving)  # the sample before each move
    moved = np.searchsorted(moves, end - 1) > np.searchsorted(moves, begin)
    counts = (end - begin >= HELD_SAMPLES) & moved
    return int((end - begin)[counts].sum())
