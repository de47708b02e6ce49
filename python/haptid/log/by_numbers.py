"""Channels that no name tells apart, recognised by their numbers: times grow, and velocities are rates of positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array

# Least correlation of a velocity with the differences of its position; of a position, with the index, that is a time.
_RATES, _LINEAR = 0.9, 0.999
# Share of its steps in which a time may stand still.
_STANDS = 0.01
# Factor within which the steps of two pairs are the same, where one of them is noisy.
_SAME_STEP = 1.3
# Rows from which channels are recognised: the most lively of them.
_ROWS = 20_000
# Share of the largest standard deviation of a block's columns above which a column moves.
_MOVES = 1e-3


@dataclass(frozen=True)
class Recognised:
    """Columns by what they are, numbered from 0.

    Attributes:
        time: of the times; None where there are none.
        positions, velocities: of all joints in order.
        torques: the columns after them that may be torques, in blocks of as many.
        step_s: the sampling period that makes velocities rates of positions, in the unit of the velocities' time.
        correlation: the least one of a velocity with its position's differences.
    """

    time: int | None
    positions: tuple[int, ...]
    velocities: tuple[int, ...]
    torques: tuple[tuple[int, ...], ...]
    step_s: float
    correlation: float


def recognised(columns: Sequence[Array], joints: int = 0) -> Recognised | None:
    """What the columns of a table are, or None where no velocities are the rates of positions.

    Args:
        columns: numbers, (rows,) each.
        joints: how many there are; 0 where not known: then as many as can be.
    """
    table = _busiest(np.column_stack([np.asarray(column, dtype=float) for column in columns]))
    if len(table) < 3 or not np.isfinite(table).all():
        return None
    time = next((k for k in range(table.shape[1]) if is_time(table[:, k])), None)
    rest = [k for k in range(table.shape[1]) if k != time]
    many = [joints] if joints else list(range(len(rest) // 2, 0, -1))
    for n in many:
        pairs = list(_pairs(table, rest, n))
        # Accelerations are rates of velocities, which are then no positions; so are torques in proportion to them, but
        # at another step.
        first = [pair for pair in pairs if not any(pair[0] == other[1] for other in pairs)]
        if first:
            positions, velocities, step, least = first[0]
            alike = [pair for pair in pairs if 1 / _SAME_STEP < pair[2] / step < _SAME_STEP]
            motion = {column for pair in alike for block in pair[:2] for column in block}
            torques = tuple(
                block for block in _blocks(rest, motion, n) if not _accelerates(table, velocities, block, step)
            )
            return Recognised(time, positions, velocities, torques, step, least)
    return None


def rate_by_velocities(positions: Array, velocities: Array) -> float:
    """Sampling rate by which velocities are the rates of positions, (rows, joints) each, Hz; 0 where they are not."""
    found = _rates(_busiest(np.hstack([positions, velocities])), range(positions.shape[1]), positions.shape[1])
    return 1 / found[0] if found else 0.0


def is_time(column: Array) -> bool:
    """Whether a column grows steadily from row to row."""
    steps = np.diff(column)
    if not (steps >= 0).all() or (steps == 0).mean() > _STANDS:
        return False
    return bool(np.corrcoef(column, np.arange(len(column)))[0, 1] > _LINEAR)


def _busiest(table: Array) -> Array:
    """The rows of a long table in which its columns change most."""
    if len(table) <= _ROWS:
        return table
    change = np.abs(np.diff(table, axis=0)) / np.maximum(np.ptp(table, axis=0), np.finfo(float).tiny)
    total = np.concatenate([[0], np.cumsum(change.sum(axis=1))])
    start = int(np.argmax(total[_ROWS - 1 :] - total[: len(total) - _ROWS + 1]))
    return table[start : start + _ROWS]


def _pairs(
    table: Array, rest: Sequence[int], n: int
) -> Iterator[tuple[tuple[int, ...], tuple[int, ...], float, float]]:
    """Blocks of neighbouring columns of which the second are the rates of the first, with step and correlation."""
    for i in range(len(rest) - n + 1):
        for j in (*range(i + n, len(rest) - n + 1), *range(i - n + 1)):
            q, v = rest[i : i + n], rest[j : j + n]
            found = _rates(table[:, [*q, *v]], range(n), n)
            if found:
                yield tuple(q), tuple(v), *found


def _rates(table: Array, own: Sequence[int], n: int) -> tuple[float, float] | None:
    """Step and least correlation, if columns n.. are the rates of columns 0..; None if they are not."""
    spread = table.std(axis=0)
    moving = [k for k in own if spread[k] > _MOVES * spread[:n].max() and spread[n + k] > _MOVES * spread[n:].max()]
    steps, least = [], 1.0
    for k in moving:
        change, v = np.gradient(table[:, k]), table[:, n + k]
        if not change.any():
            return None
        least = min(least, float(np.corrcoef(change, v)[0, 1]))
        if not least > _RATES:
            return None
        steps.append(float(change @ v / (v @ v)))
    if not steps or max(steps) > 1.5 * min(steps):
        return None
    return float(np.median(steps)), least


def _accelerates(table: Array, velocities: Sequence[int], block: Sequence[int], step: float) -> bool:
    """Whether columns are the velocities' rates, noisy as accelerations are, at the same step."""
    for k, own in zip(velocities, block, strict=True):
        change, a = np.gradient(table[:, k]), table[:, own]
        with_it = float(change @ a)
        if with_it <= 0 or not 1 / _SAME_STEP < float(change @ change) / with_it / step < _SAME_STEP:
            return False
    return True


def _blocks(rest: Sequence[int], motion: set[int], n: int) -> tuple[tuple[int, ...], ...]:
    """Neighbouring columns that are no motion, n at a time."""
    found: list[list[int]] = []
    for k in rest:
        if k in motion:
            found.append([])
        elif found and found[-1] and found[-1][-1] == k - 1 and len(found[-1]) < n:
            found[-1].append(k)
        else:
            found.append([k])
    return tuple(tuple(block) for block in found if len(block) == n)
