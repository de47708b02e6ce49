"""Rows over which the clock of the stamps stood still while the joints moved on, and their times."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array

# A step below this share of the usual one is of a clock that stands. From this number of consecutive ones on it is no
# jitter: of stamps in random order one step in four is as short. In the mean the steps are shorter: a burst of rows
# that are taken at five times the rate is none.
_STANDS, _ROWS, _MEAN = 0.3, 20, 0.1
# Rows before and after, in lengths of the run, in which longer steps make up for it, as of rows that were held up; and
# the share of the time lost that they make up for at least.
_AROUND, _LATE, _MADE_UP = 3, 1.5, 0.5
# Mean movement over so many rows, as noise moves from one row to the next, and the share of that beside the run from
# which on the joints moved on.
_APART, _MOVED = 10, 0.3


def running_times(seconds: Array, positions: Callable[[], Iterable[Array]]) -> tuple[Array, list[str]]:
    """Times with the usual step where the clock stopped, and a sentence; as they are where it never did.

    Args:
        seconds: of the rows, (n,), not decreasing.
        positions: give the channels one after the other, each (n,).
    """
    steps = np.diff(seconds)
    usual = float(np.median(steps)) if steps.size else 0.0
    if usual <= 0:
        return seconds, []
    edges = np.flatnonzero(np.diff(steps < _STANDS * usual, prepend=False, append=False))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if b - a >= _ROWS]
    runs = [(a, b) for a, b in runs if seconds[b] - seconds[a] < _MEAN * usual * (b - a)]
    runs = [(a, b) for a, b in runs if not _made_up(steps, a, b, usual)]
    moved = _moved_on(positions, runs)
    runs = [run for run, on in zip(runs, moved, strict=True) if on]
    if not runs:
        return seconds, []
    rows, first = sum(b - a for a, b in runs), float(seconds[runs[0][0]])
    for a, b in runs:
        steps[a:b] = usual
    times = np.concatenate((seconds[:1], seconds[0] + np.cumsum(steps)))
    lost = float(times[-1] - seconds[-1])
    return times, [
        f"the clock of the stamps stands still over {rows} rows, first at t = {first:.6g} s, and never catches up, "
        f"while the joints move on: these are taken as {usual:.4g} s apart, and the last one is {lost:.4g} s later"
    ]


def _made_up(steps: Array, a: int, b: int, usual: float) -> bool:
    """Whether longer steps beside a run make up for it: rows were held up, or written in blocks."""
    reach = _AROUND * (b - a) + _ROWS
    beside = np.concatenate((steps[max(0, a - reach) : a], steps[b : b + reach]))
    lost = (b - a) * usual - float(steps[a:b].sum())
    return float((beside[beside > _LATE * usual] - usual).sum()) > _MADE_UP * lost


def _moved_on(positions: Callable[[], Iterable[Array]], runs: list[tuple[int, int]]) -> NDArray[np.bool_]:
    """Whether the joints that move beside each run move in it too, (runs,)."""
    inside, beside = np.zeros(len(runs)), np.zeros(len(runs))
    for channel in positions() if runs else ():
        far = np.abs(channel[_APART:] - channel[:-_APART]) / (float(np.ptp(channel)) or 1.0)
        for k, (a, b) in enumerate(runs):
            before = far[max(0, 2 * a - b) : max(0, a - _APART + 1)]
            around = np.concatenate((before, far[b : 2 * b - a - _APART + 1]))
            inside[k] += far[a : b - _APART + 1].mean()
            beside[k] += around.mean() if around.size else 0.0
    return (inside > _MOVED * beside) & (inside > 0)
