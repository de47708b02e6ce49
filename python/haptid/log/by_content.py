"""`Content`: which columns of a table without names are positions, velocities and torques, by their correlations.

A velocity is known by its integral, which is the position but for a straight line: noise and quantisation
have little effect there. Torques are what is left. All of it is a guess for a person to check.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from haptid._internal.late import dataclass
from haptid.log.control_errors import errors_among, smaller_half
from haptid.log.far_off import far_off

# Columns and rows that are used, at most.
_MOST, _ROWS = 64, 20_000
# Least correlation of a column with the integral of its rate, and of two copies of one signal.
_INTEGRAL, _COPY = 0.98, 0.98
# The same of a velocity with the integral of noisy accelerations; share by which the sampling period of these differs.
_NOISY_INTEGRAL, _SAME_PERIOD = 0.8, 0.2
# Joints, and share of them, that tell one period of accelerations whatever it is.
_SEVERAL, _OF_MOST = 3, 0.75
# Least correlation of what a position grows by and what its rate adds up to, over some samples.
_GROWS = 0.5
# Columns among which a pair is by chance, unless its rate comes at most so many columns behind the position, others are
# as far from each other, or the position is in a block of them from the first column on.
_MANY, _NEAR = 8, 3
# Samples over which a row and the sum of its rate are compared.
_LAG = 20
# Correlation by which two copies of a position differ as integrals of one rate.
_EQUAL = 0.01
# Share by which the sizes of two copies differ at most.
_SIZE = 0.1
# Units of one copy in that of another.
_OF_ANGLES = np.array([1.0, np.pi / 180, 180 / np.pi])
# Greatest share by which the steps of a column of times differ, in the median.
_REGULAR = 0.5
# Least change from row to row of the steps of a clock in another unit, by their deviation; velocities are smooth.
_JITTER = 0.5
# Units of times, thousands from the largest to the smallest: s, ms, us, ns.
_UNITS = 3
# Rows of a recording in a table of several, in the mean at least.
_LEAST_RUN = 100
# Ratio of the roughness of two copies above which the rougher one is measured and the other one planned.
_ROUGHER = 2.0


@dataclass(frozen=True)
class Content:
    """Columns of a table by the quantity that they contain.

    Attributes:
        time: a column that grows evenly; empty where there is none.
        positions: in the order of the table.
        rates: of each position.
        torques: as many, of what is left; empty where there are not enough.
        others: further groups of the same size that torques may be.
        accelerations: rates of the rates.
        dt: sampling period by which the rates are those of the positions, s; 0 where no two are.
    """

    time: str = ""
    positions: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()
    torques: tuple[str, ...] = ()
    others: tuple[tuple[str, ...], ...] = ()
    accelerations: tuple[str, ...] = ()
    dt: float = 0.0

    @staticmethod
    def of(columns: Mapping[str, NDArray[np.generic]], clocks: Container[str] = ()) -> Content:
        """From all columns, in the order of the table; those of unequal length or that are no numbers are left out.

        Args:
            columns: by their names.
            clocks: names of those that are known to be times, or parts of times, of whatever steps.
        """
        names = list(columns)[:_MOST]
        size = max((columns[name].size for name in names), default=0)
        names = [name for name in names if columns[name].size == size]
        if size < 100 or not names:
            return Content()
        rows = _of_one_run(np.array([columns[name] for name in names], dtype=np.float64))
        start = max(0, (rows.shape[1] - _ROWS) // 2)
        rows = rows[:, start : start + _ROWS]
        rows = rows[:, ~np.any([far_off(row) for row in rows], axis=0)]
        good = np.flatnonzero(np.isfinite(rows).all(axis=1))
        names, rows = [names[k] for k in good], rows[good]
        linked = _linked(rows)
        steady = [name in clocks or _steady(row) for name, row in zip(names, rows, strict=True)]
        varying = [not steady[k] and np.ptp(row) > 0 for k, row in enumerate(rows)]
        evenly = [row for row, own in zip(rows, steady, strict=True) if own]
        steps = [varying[k] and any(_steps_of(clock, row) for clock in evenly) for k, row in enumerate(rows)]
        # What grows evenly, and has a rate that varies with its steps, is a position that turns on.
        rating = [varies and not step for varies, step in zip(varying, steps, strict=True)]
        steady = [
            own and (name in clocks or not (linked[k][rating] > _INTEGRAL).any())
            for k, (name, own) in enumerate(zip(names, steady, strict=True))
        ]
        signals = [k for k in range(len(rows)) if not steady[k] and not steps[k]]
        moving = [k for k in signals if np.ptp(rows[k]) > 0]
        if len(moving) < 2:
            return Content()
        time = next((k for k in range(len(names)) if steady[k] and _from_zero(rows[k]) and not _counts(rows[k])), None)
        found = _chains(linked[np.ix_(moving, moving)])
        found = {i: j for i, j in found.items() if _grows(rows, moving[i], moving[j])}
        first = signals[0]
        arrays = [name.partition("[")[0] for name in names]
        pairs = {moving[i]: moving[j] for i, j in found.items()}
        if len(moving) > _MANY:
            apart = Counter(j - i for i, j in pairs.items())
            pairs = {i: j for i, j in pairs.items() if i - first < j - i or 0 < j - i <= _NEAR or apart[j - i] > 1}
        own = Counter(arrays[i] for i, j in pairs.items() if arrays[i] == arrays[j] != names[i])
        if own:  # positions and rates are one array
            first = next(k for k in signals if arrays[k] == own.most_common(1)[0][0])
        at, block = _whole_block(pairs, first, linked)
        heads = [k for k in sorted(set(at) - set(at.values())) if k in block or not _scaled(rows, k, at, block)]
        together = len(set(arrays)) > 1 and {arrays[k] for k in heads} == {arrays[first]}
        heads = _measured(rows, heads, at if together else {}, block)
        second = _second_rates(at, heads, len(names))
        used = {*at, *at.values(), *second}
        heads = [k for k in heads if k not in errors_among(rows, heads, heads)]
        if len([k for k in signals if k not in used]) < len(heads):  # a torque that is dead is one all the same
            heads = [k for k in heads if k not in smaller_half(rows, heads)]
        step = _period(rows, [(k, at[k]) for k in heads if {k, at[k]} <= set(moving)])
        heads = _filled(heads, rows, used)
        # Torques of a mechanism that is all inertia are rates of rates too, of another period: taken if nothing else is
        rates = [at.get(k) for k in heads]
        for taken, alone in ((used, False), ({*heads, *(k for k in rates if k is not None)}, True)):
            left = [k for k in moving if k not in taken]
            errors = errors_among(rows, left, heads)
            groups = _left(rows, [k for k in left if k not in errors], heads, taken)
            if not groups and errors < set(left):  # a proportional controller's torques, one of them with a gain of 1
                groups = _left(rows, left, heads, taken)
            again = [group for group in groups if _accelerations(rows, group, rates, step, alone)]
            groups = [group for group in groups if group not in again]
            if groups:
                break
        second = {*second, *(k for group in again for k in group)} - {k for group in groups for k in group}
        groups.sort(key=lambda group: bool(heads) and arrays[group[0]] != arrays[heads[0]])  # the positions' own first

        def named(group: list[int]) -> tuple[str, ...]:
            return tuple(names[k] for k in group)

        return Content(
            names[time] if time is not None else "",
            named(heads),
            tuple(names[at[k]] for k in heads if k in at),
            named(groups[0]) if groups else (),
            tuple(map(named, groups[1:])),
            named(sorted(second)),
            step,
        )


def _left(rows: NDArray[np.float64], left: Sequence[int], heads: Sequence[int], used: set[int]) -> list[list[int]]:
    """Groups as large as that of the positions, of the columns that are left and are no copies of those in use."""
    left = _without_copies(rows, left, heads, used)
    groups = [list(left[k : k + len(heads)]) for k in range(0, len(left), len(heads) or 1)] if heads else []
    if len(groups) > 1:  # joints whose columns stand still at the end of the last one, as those without a sensor
        last = groups[-1]
        while len(last) < len(heads) and last[-1] + 1 < len(rows) and np.ptp(rows[last[-1] + 1]) == 0:
            last.append(last[-1] + 1)
    return [group for group in (_filled(group, rows, used) for group in groups) if len(group) == len(heads)]


def _without_copies(rows: NDArray[np.float64], left: Sequence[int], heads: Sequence[int], used: set[int]) -> list[int]:
    """Columns that are no copies of those in use; one among others that are none is a torque that looks like one.

    Blocks of columns as wide as that of the positions, behind those in use, are taken or left as a whole.
    """
    copies = {k for k in left if _copied(rows, k, used)}
    size, after = len(heads), max(used, default=-1) + 1
    if size > 2 and list(heads) == list(range(heads[0], heads[0] + size)):
        for start in range(after, len(rows) - size + 1, size):
            own = copies & {*range(start, start + size)}
            copies -= own if 2 * len(own) < size else set()
    return [k for k in left if k not in copies]


def _steady(row: NDArray[np.float64]) -> bool:
    """Whether a column grows evenly, as times and row numbers do."""
    steps = np.diff(row)
    middle = float(np.median(steps))
    return middle > 0 and bool((steps >= 0).all()) and float(np.median(np.abs(steps - middle))) < _REGULAR * middle


def _from_zero(row: NDArray[np.float64]) -> bool:
    """Whether a column that grows begins where times may: not before zero by more than it grows."""
    return bool(row[0] >= -(row[-1] - row[0]))


def _steps_of(clock: NDArray[np.float64], row: NDArray[np.float64]) -> bool:
    """Whether a column is the step of a clock before or after each row, in any unit of times.

    In another unit a velocity at 1 kHz is so too, but smooth: seconds whose steps are in ms.
    """
    for pair in (np.stack([clock, row]), np.stack([clock[1:], row[:-1]])):
        grown, sums = _gains(pair, 0, 1)
        gain = float(grown @ sums) / max(float(sums @ sums), np.finfo(float).tiny)
        if gain > 0 and grown @ sums > _NOISY_INTEGRAL * np.linalg.norm(grown) * np.linalg.norm(sums):
            thousands = round(math.log10(gain) / 3)
            jitters = thousands == 0 or np.std(np.diff(row)) > _JITTER * np.std(row)
            if abs(thousands) <= _UNITS and abs(gain / 1000.0**thousands - 1.0) < _SIZE and jitters:
                return True
    return False


def _of_one_run(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rows of the longest of several recordings, where a column of times starts again for each; else all rows."""
    for row in rows:
        again = np.flatnonzero(np.diff(row) < 0) + 1
        if 0 < len(again) < row.size / _LEAST_RUN and np.isfinite(row).all():
            edges = np.array([0, *again, row.size])
            if all(_steady(row[a:b]) for a, b in pairwise(edges) if b - a > 2):
                k = int(np.argmax(np.diff(edges)))
                return rows[:, edges[k] : edges[k + 1]]
    return rows


def _counts(row: NDArray[np.float64]) -> bool:
    """Whether a column numbers the rows: by ones, from 0 or 1."""
    return bool(np.array_equal(np.diff(row), np.ones(len(row) - 1)))


def _straightened(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows without their straight lines, of unit norm; zero where nothing is left."""
    line = np.linspace(-1.0, 1.0, rows.shape[1])
    base = np.linalg.qr(np.stack([np.ones_like(line), line], axis=1))[0]
    made = rows - rows.mean(axis=1, keepdims=True)
    made -= (made @ base) @ base.T
    norm = np.linalg.norm(made, axis=1, keepdims=True)
    return np.asarray(made / np.where(norm > 1e-9 * np.abs(rows).max(axis=1, keepdims=True), norm, np.inf))


def _linked(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Correlation of each row with the integral of each other one, but for straight lines, (rows, rows)."""
    integrals = np.cumsum(rows - rows.mean(axis=1, keepdims=True), axis=1)
    r = _straightened(rows) @ _straightened(integrals).T
    np.fill_diagonal(r, 0.0)
    return np.asarray(r)


def _chains(linked: NDArray[np.float64]) -> dict[int, int]:
    """The velocity row of each position row that has one: each is the other's best by correlation with the integral."""
    made = {}
    for i, r in enumerate(linked):
        j = int(np.argmax(r))
        if r[j] > _INTEGRAL and r[j] > linked[:, j].max() - _EQUAL:
            made[i] = j
    return made


def _grows(rows: NDArray[np.float64], i: int, j: int) -> bool:
    """Whether row i grows by what row j adds up to over some samples: sums of any two slow drifts are alike."""
    grown, sums = _gains(rows, i, j)
    return bool(grown @ sums > _GROWS * np.linalg.norm(grown) * np.linalg.norm(sums))


def _whole_block(at: dict[int, int], first: int, linked: NDArray[np.float64]) -> tuple[dict[int, int], range]:
    """The pairs with those of joints that hardly moved, where positions come first and then, as many, their rates.

    So with those of joints that move alike, or evenly, in short logs, where such columns are anywhere. The columns of
    the block's positions are the second value returned, none where there is no block.
    """
    apart, size = [j - i for i, j in at.items() if j > i], len(linked)
    usual = max(apart, key=apart.count, default=0)
    first = _start(linked, usual, first)
    block = range(first, first + usual)
    if usual < 2 or first + 2 * usual > size or not any(i in block and j == i + usual for i, j in at.items()):
        return at, range(0)
    rates = range(first + usual, first + 2 * usual)
    others = {i: j for i, j in at.items() if i not in block and j not in block and j not in rates}
    # Beside a block, a pair by chance is of columns anywhere: a joint more has its rate beside it, or joints beside it.
    others = {i: j for i, j in others.items() if j == i + 1 or j - i in (others.get(k, k) - k for k in (i - 1, i + 1))}
    return others | {k: k + usual for k in block}, block


def _start(linked: NDArray[np.float64], usual: int, first: int) -> int:
    """First column of as many positions as their rates are columns further: accelerations follow them likewise."""
    apart = np.diagonal(linked, usual)
    if usual < 2 or len(apart) < usual:
        return first
    least = np.lib.stride_tricks.sliding_window_view(apart, usual).min(axis=1)
    return int(np.argmax(least > least.max() - _EQUAL)) if least.max() > _INTEGRAL else first


def _second_rates(at: dict[int, int], heads: list[int], size: int) -> set[int]:
    """Accelerations, one for each rate and as far from it, where that of any is known: others are noisier."""
    rates = [at[k] for k in heads if k in at]
    apart = [at[rate] - rate for rate in rates if rate in at]
    found = {rate + max(apart, key=apart.count) for rate in rates} if apart else set()
    return {k for k in found if 0 <= k < size and k not in heads}


def _measured(rows: NDArray[np.float64], heads: list[int], own: Mapping[int, int], block: Container[int]) -> list[int]:
    """Positions without planned copies of their size, which are smoother; the first ones where none is rougher.

    A copy may be in the other unit of angles.

    Args:
        own: rates of positions in one array: those with different rates, of which none is rougher, move in step.
        block: positions side by side, each as far from its rate: so with them.
    """
    z = _straightened(rows[heads]) if heads else rows
    rough = [float(np.std(np.diff(rows[k], 4)) / max(np.std(rows[k]), np.finfo(float).tiny)) for k in heads]
    size = rows[heads].std(axis=1)
    gone: set[int] = set()
    for a in range(len(heads)):
        for b in range(a + 1, len(heads)):
            alike = z[a] @ z[b] > _COPY and bool(_of_one_size(size[b] / size[a]))
            apart = (own and own.get(heads[a]) != own.get(heads[b])) or (heads[a] in block and heads[b] in block)
            if apart:
                alike = alike and max(rough[a], rough[b]) > _ROUGHER * min(rough[a], rough[b])
            if a not in gone and b not in gone and alike:
                gone.add(a if rough[b] > _ROUGHER * rough[a] else b)
    return [k for a, k in enumerate(heads) if a not in gone]


def _copied(rows: NDArray[np.float64], k: int, used: set[int]) -> bool:
    """Whether a column is one of those that are in use, planned or filtered: of the same size too."""
    z, size = _straightened(rows[[k, *sorted(used)]]), np.std(rows[sorted(used)], axis=1) / np.std(rows[k])
    return bool(((z[1:] @ z[0] > _COPY) & _of_one_size(size)).any())


def _scaled(rows: NDArray[np.float64], k: int, at: Mapping[int, int], block: range) -> bool:
    """Whether a column outside a block of positions is one of its rates in another unit, as a plan's velocity."""
    rates = [at[i] for i in block]
    z = _straightened(rows[[k, *rates]])
    return bool((np.abs(z[1:] @ z[0]) > _COPY).any())


def _of_one_size(ratios: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether ratios of sizes are those of copies, of which one may be in rad and the other one in degrees."""
    return np.asarray((np.abs(ratios[..., None] / _OF_ANGLES - 1.0) < _SIZE).any(axis=-1))


def _filled(group: list[int], rows: NDArray[np.float64], used: set[int]) -> list[int]:
    """A group with the constant columns inside it: a joint that did not move."""
    if not group:
        return group
    inside = range(min(group), max(group) + 1)
    still = [k for k in inside if k not in group and np.ptp(rows[k]) == 0 and k not in used]
    return sorted([*group, *still]) if len(still) <= len(group) else group


def _accelerations(
    rows: NDArray[np.float64], group: list[int], rates: list[int | None], step: float, alone: bool
) -> bool:
    """Whether columns are the rates of the rates, noisy as they are.

    At the same sampling period; or, of three joints on, at any one period that most of them have: accelerations were
    filtered, or computed at another rate, and torques of different links are no one multiple of them. A group that is
    the only one may be torques of equal inertias.
    """
    pairs = [(i, j) for i, j in zip(rates, group, strict=True) if i is not None and np.ptp(rows[j]) > 0]
    if not pairs or not step:
        return False
    gains = [_gains(rows, i, j) for i, j in pairs]
    alike = [float(np.corrcoef(x, c)[0, 1]) for x, c in gains]
    if min(alike) > _NOISY_INTEGRAL and abs(_period(rows, pairs) / step - 1.0) < _SAME_PERIOD:
        return True
    if alone or len(pairs) < _SEVERAL:
        return False
    own = np.array([x @ c / (c @ c) for x, c in gains])
    one = np.mean(np.abs(own - np.median(own)) < _SAME_PERIOD * abs(np.median(own)))
    return bool(np.median(alike) > _NOISY_INTEGRAL and one >= _OF_MOST)


def _period(rows: NDArray[np.float64], pairs: list[tuple[int, int]]) -> float:
    """Sampling period at which the second of each pair is the rate of the first, s; 0 where the pairs disagree."""
    gains = [_gains(rows, i, j) for i, j in pairs]
    found = [float(x @ c / (c @ c)) for x, c in gains if (c != 0).any()]
    middle = float(np.median(found)) if found else 0.0
    return middle if all(abs(one - middle) < _SAME_PERIOD * abs(middle) for one in found) else 0.0


def period_of(
    positions: Sequence[NDArray[np.generic]], rates: Sequence[NDArray[np.generic]], least: float = _NOISY_INTEGRAL
) -> float:
    """Sampling period at which velocities are those of positions, in pairs, s; 0 where they are not, or disagree.

    Args:
        positions, rates: (n,) each.
        least: correlation of each pair, over some samples.
    """
    rows = np.array([*positions, *rates], dtype=np.float64)
    rows = rows[:, np.isfinite(rows).all(axis=0)][:, :_ROWS]
    if rows.shape[1] < 100:
        return 0.0
    count = len(positions)
    pairs = [(k, count + k) for k in range(count) if np.ptp(rows[k]) > 0 and np.ptp(rows[count + k]) > 0]
    alike = [float(np.corrcoef(*_gains(rows, i, j))[0, 1]) for i, j in pairs]
    return _period(rows, pairs) if pairs and min(alike) > least else 0.0


def _gains(rows: NDArray[np.float64], i: int, j: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """By how much row i grows over some samples, and row j adds up to, but for their means; noise becomes no walk.

    The mean of a motion that turns on is as large as it is in the units of time, whatever the rate varies by.
    """
    grown, sums = rows[i, _LAG:] - rows[i, :-_LAG], np.convolve(rows[j] - rows[j].mean(), np.ones(_LAG), "valid")[1:]
    return grown - grown.mean(), sums - sums.mean()
