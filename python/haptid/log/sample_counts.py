"""Sampling periods between the rows of a log, counted by the motion itself.

A recorder that polls a device, or takes messages from a queue, writes a sample twice where one is late and leaves one
out where two have come; its stamps, or the numbers of its rows, say when rows were written and not when samples were
taken. The device itself samples regularly, so the true steps are whole periods: 0, 1, 2, ... Where the positions move
fast enough, the step of all channels over their speed says which.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import running_mean
from haptid.log.spectrum import lattice_step

# Steps that a speed is the mean of, pass by pass: first of all steps, then of those that counted one.
_WIDTHS = (101, 101, 25)
WIDEST_MEAN = max(_WIDTHS)
# Standard error of a step, periods, below which its count is clear; distance from a whole number that is near it.
_CLEAR, _NEAR = 0.1, 0.25
# Least share of the steps that must be clear, and of the clear ones that must be near whole numbers.
_MANY, _WHOLE = 0.2, 0.97
# Least share of steps of one period around a step.
_SINGLE = 0.3
# Share of the rows counted as an earlier sample that repeat it in some channels alone, from which on an encoder sticks.
_STICKS = 0.1
# Longest step that is counted, periods.
LONGEST_COUNT = 20
# A step that differs between channels by more than this many standard deviations of their noise, and by more than this
# share of itself, is none of time alone.
_UNLIKE, _SHARE = 5.0, 0.3


@dataclass(frozen=True, eq=False)
class StepCounts:
    """Whole sampling periods from each row to the next.

    Attributes:
        periods: (rows - 1,).
        resolved: where the motion is fast enough to resolve a step, (rows - 1,); 1 elsewhere.
        clear: where it leaves no doubt, (rows - 1,).
    """

    periods: NDArray[np.intp]
    resolved: NDArray[np.bool_]
    clear: NDArray[np.bool_]


def count_steps(positions: Iterable[Array], spans: Iterable[tuple[int, int]], rows: int) -> StepCounts | None:
    """Steps counted by the motion; None where they are not whole periods, or the motion is too slow to tell.

    Args:
        positions: channels, each (rows,), in any unit, unwrapped.
        spans: rows of each segment.
        rows: of the log.
    """
    channels = list(positions)
    made = StepCounts(np.ones(rows - 1, dtype=np.intp), *(np.zeros(rows - 1, dtype=bool) for _ in range(2)))
    resolved = moved = whole = 0
    for a, b in spans:
        if b - a < WIDEST_MEAN:
            continue
        own, part = [channel[a:b] for channel in channels], slice(a, b - 1)
        rounding = [lattice_step(channel[: 1 << 16]) / np.sqrt(6) for channel in own]
        x, before = np.ones(b - a - 1), (np.zeros(0), 0)
        for width in _WIDTHS:
            assumed = np.rint(x)
            if width == before[1] and np.array_equal(assumed, before[0]):
                continue  # the same again
            x, made.resolved[part], alike = _steps(own, rounding, assumed, width)
            before = assumed, width
        made.clear[part] = made.resolved[part] & alike & (np.abs(x - np.rint(x)) < _NEAR)
        made.periods[part] = np.rint(x).astype(np.intp)
        counted_here = made.resolved[part] & alike
        moves = made.periods[part] > 0  # of a rest between moves, zero periods are as clear as of a repeated row
        resolved, moved = resolved + int(counted_here.sum()), moved + int((counted_here & moves).sum())
        whole += int((made.clear[part] & moves).sum())
    told = resolved > _MANY * (rows - 1) and whole > _WHOLE * moved
    return made if told and not _sticks(channels, made) else None


def _sticks(channels: list[Array], made: StepCounts) -> bool:
    """Whether many rows that are counted as an earlier sample are that in some channels and not in others.

    So it is of an encoder that sticks; a row that a recorder repeats is repeated in all channels.
    """
    earlier = made.clear & (made.periods == 0)
    same = np.array([np.diff(channel)[earlier] == 0 for channel in channels])
    return bool(earlier.any() and (same.any(axis=0) & ~same.all(axis=0)).mean() > _STICKS)


def _steps(
    channels: list[Array], rounding: list[float], assumed: Array, width: int
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Each step in periods, (rows - 1,), where the motion resolves it, and where all channels say the same.

    Args:
        channels: each (rows,).
        rounding: of a step of each channel by its encoder's resolution, as a standard deviation.
        assumed: periods of each step, (rows - 1,).
        width: steps that a speed is the mean of.
    """
    one = (assumed == 1).astype(float)
    single = running_mean(one, width)
    information, moment, power = (np.zeros(len(assumed)) for _ in range(3))
    moved = 0
    for channel, least in zip(channels, rounding, strict=True):
        step = np.diff(channel)
        speed = running_mean(one * step, width) / np.maximum(single, 1 / width)
        off = np.abs(step - speed * assumed)
        noise = max(1.4826 * float(np.median(off)), least)
        if noise > 0:
            speed, step = speed / noise, step / noise
            information += speed**2
            moment += speed * step
            power += step**2
            moved += 1
    with np.errstate(divide="ignore", invalid="ignore"):
        x = moment / information
        unlike = np.sqrt(np.maximum(power - x * moment, 0.0) / max(moved, 1))
        alike = unlike < np.maximum(_UNLIKE, _SHARE * np.sqrt(power / max(moved, 1)))
        resolved = (information > _CLEAR**-2) & (x > -_NEAR) & (x < LONGEST_COUNT) & (single > _SINGLE)
    return np.where(resolved, x, 1.0), resolved, alike
