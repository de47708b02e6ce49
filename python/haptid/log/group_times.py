"""Groups of one file that have times of their own (HDF5, TDMS, MAT, NPZ), on the rows of the positions' times."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import LogTimeError
from haptid.log import stamps, units
from haptid.log.checks import all_usable
from haptid.log.file_format import Format
from haptid.log.formats.sniff import RawChannel, channel_list, group_of
from haptid.log.log import Channels
from haptid.log.merging import LATEST, SAME_TIMES, Stream, at_stamps
from haptid.log.stamp_parts import fraction_unit, sum_of, with_parts, with_sums

# Share of the positions' span that another clock covers at least, and share of the other clock's own span that lies in
# it: two units of time differ by a thousand, and a recorder that runs on before and after the positions by less.
_COVERED, _INSIDE = 0.5, 0.01
# Share of the rows that have a value of each group, at least.
_KEPT = 0.5
# A group whose sampling period is above this multiple of the positions' one, and above this, s, is refused: samples
# 0.1 s apart do not show motion above 5 Hz.
_SLOWER, _SLOW = 10.0, 0.1
# Names of the fraction of whole seconds beside it.
_FRACTION = re.compile(r"(?i:nano|micro|milli|[num]secs?$)[^.]*$")


@dataclass(frozen=True, eq=False)
class _Clock:
    """Times of a group.

    Attributes:
        name: of the channel.
        raw: as they are in the file, (rows,).
        unit: "s", "ms", "us" or "ns".
    """

    name: str
    raw: RawChannel
    unit: str

    def begin(self, path: Path) -> Fraction:
        """The first time, s."""
        if not all_usable(self.raw[:1]):
            stamps.since_first(path, self.name, self.raw.copy(), 1.0)  # which says so
        return Fraction(self.raw[0].item()) * Fraction(1, round(1 / units.scale(self.unit, "time")[1]))

    def seconds(self, path: Path) -> Array:
        """Times from the first one on, (rows,), s."""
        return stamps.since_first(path, self.name, self.raw.copy(), units.scale(self.unit, "time")[1])


def on_rows_of_positions(
    path: Path, kind: Format, channels: Channels, columns: Mapping[str, RawChannel], notes: list[str]
) -> dict[str, RawChannel]:
    """Columns on the rows of the positions' times: those of groups with other times are merged by these.

    Groups whose times equal those of the positions stay row by row, and so do those without times; where these have
    other rows, the columns are returned as they are.

    Args:
        path, kind: of the file.
        channels: which of them are what; with a time.
        columns: of the file, (rows of each,).
        notes: appended to.

    Raises:
        LogDataError: a group's time is missing.
        LogTimeError: a group's times fall or stand still, have too little in common with those of the positions, or
            are too far apart.
    """
    assert channels.time is not None
    rows = columns[channels.time].size
    if any(columns[name].size != rows for name in channels.position.channels) or rows == 0:
        return dict(columns)
    time, own = _clocks(path, kind, channels, columns)
    if any(column.size != rows and name not in own for name, column in columns.items()):
        return dict(columns)
    groups: dict[tuple[str, bytes], list[str]] = {}
    for name, clock in own.items():
        groups.setdefault((clock.unit, clock.raw.tobytes()), []).append(name)
    out, keep = dict(columns), np.ones(rows, bool)
    for names in groups.values():
        clock = own[names[0]]
        if not _same(path, time, clock):
            at, theirs = _in_common(path, time, clock, names, channels)
            stream = Stream("", theirs, None, {name: columns[name] for name in names})
            found, usable, sentence = at_stamps(channels.merge, at, theirs, stream)
            if usable.mean() < _KEPT:
                raise LogTimeError(
                    f"{path}: {int(usable.sum())} of {rows} rows have a value of {channel_list(names, 8)} near them by "
                    f"{clock.name!r} (limit {100 * _KEPT:.0f} %).",
                    where=clock.name,
                    found=float(usable.mean()),
                    limit=_KEPT,
                    advice="Record them together, or name the part that has both, in a file of its own.",
                )
            out |= found
            keep &= usable
            notes.append(f"{sentence}, by {clock.name} in {clock.unit}")
    return {name: column[keep] for name, column in out.items()} if not keep.all() else out


def refuse_other_times(path: Path, kind: Format, channels: Channels, columns: Mapping[str, RawChannel]) -> None:
    """Refuse a file whose groups have times that differ, where only rows can be read.

    Args:
        path, kind, channels: as for `on_rows_of_positions`.
        columns: with the times; of the others only names and sizes matter.

    Raises:
        LogTimeError: they differ.
    """
    time, own = _clocks(path, kind, channels, columns)
    for name, clock in own.items():
        if not _same(path, time, clock):
            raise LogTimeError(
                f"{path}: {name} has times of its own, {clock.name!r}, which are not those of {time.name!r}; an opened "
                "log is read row by row.",
                where=clock.name,
                advice="Read it with read_log (files below 64 MiB are), or save all channels at the same times.",
            )


def _clocks(
    path: Path, kind: Format, channels: Channels, columns: Mapping[str, RawChannel]
) -> tuple[_Clock, dict[str, _Clock]]:
    """Times of the positions, and those of columns in other groups, or of other lengths, by the columns' names."""
    time = str(channels.time)
    clock = _Clock(time, columns[time], channels.time_unit)
    asked = [
        name
        for name, column in columns.items()
        if name != time
        and (
            column.size != clock.raw.size
            or (kind.groups and (group_of(name) != group_of(time) or time.endswith("@time")))
        )
    ]
    if not asked:
        return clock, {}
    from haptid.log.survey.names import is_time  # slow to import, and few logs need it

    names = kind.names(path)
    every = [t for t in names if (is_time(t) or _FRACTION.search(t)) and t not in channels.sources[1:]]
    near = {name: _beside(name, time, every, names) for name in asked}
    read = kind.columns(path, list(dict.fromkeys(t for found in near.values() for t in found)))
    stated = kind.units(path)
    own = {}
    for name, found in near.items():
        fit = {t: read[t] for t in found if t in read and read[t].size == columns[name].size}
        if fit and (best := _best(fit, time)):
            raw = with_sums([best], fit)[best]
            own[name] = _Clock(best, raw, _unit(best, raw, stated, clock))
    return clock, own


def _beside(name: str, time: str, every: Sequence[str], names: Sequence[str]) -> list[str]:
    """Names of times of a column: the counterpart of the positions' time in its group first."""
    inside = [t for t in every if "." in name and t.rpartition(".")[0] == group_of(name)]
    parts = with_parts([time])
    twins = [f"{group_of(name)}.{part.rpartition('.')[2]}" for part in parts]
    twin = time
    for part, other in zip(parts, twins, strict=True):
        twin = twin.replace(part, other)
    own = [f"{name}@time"] if f"{name}@time" in names else []
    first = own if time.endswith("@time") else [twin] if "." in name and set(twins) <= set(names) else []
    return list(dict.fromkeys([*first, *inside, *own]))


def _best(fit: Mapping[str, RawChannel], time: str) -> str:
    """The first of times that is the positions' time by its name, or grows; a sum of two that make one; else any."""
    last = time.rpartition(".")[2]
    found = [t for t in fit if t.rpartition(".")[2] == last or t.endswith("]")]  # of a sum
    clear = [t for t in fit if not t.lower().endswith(("tick", "ticks"))]  # of an encoder
    found += [t for t in clear if _grows(fit[t])]
    for one, other in permutations(clear, 2) if not found else ():
        if unit := fraction_unit(fit[one], fit[other]):
            return sum_of(one, other, unit)
    return next(iter([*found, *(t for t in clear if not _FRACTION.search(t))]), "")


def _grows(raw: RawChannel) -> bool:
    grown = raw[1:] > raw[:-1]
    return all_usable(raw) and bool((raw[1:] >= raw[:-1]).all()) and int(grown.sum()) * stamps.COARSEST > raw.size


def _unit(name: str, raw: RawChannel, stated: Mapping[str, str], positions: _Clock) -> str:
    """Unit of a group's times: as stated, or as its name says; else that of the positions'.

    Where both groups say the same of their times, a unit that was given for the positions' holds for both.
    """
    from haptid.log.survey.names import time_unit, unit_apart  # slow to import, and few logs need it

    def said(of: str) -> str:
        for unit in (stated.get(of, ""), unit_apart(of)[1], time_unit(of)):
            known = units.readings(unit, "time") if unit else []
            if known:
                return known[0]
        return ""

    if name.endswith("@time") or " [s] + " in name:
        return "ns"
    if (own := said(name)) and own != said(positions.name):
        return own
    if raw.dtype.kind in "iu" and raw.size and raw[0] > 1e17:
        return "ns"
    return positions.unit


def _same(path: Path, time: _Clock, own: _Clock) -> bool:
    """Whether two clocks have the same times, but for a small share of a step."""
    if own.raw.size != time.raw.size:
        return False
    if own.unit == time.unit and np.array_equal(own.raw, time.raw):
        return True
    apart = float(own.begin(path) - time.begin(path))
    with np.errstate(invalid="ignore", over="ignore"):
        seconds = time.seconds(path)
        far = np.abs(own.seconds(path) - seconds + apart)
        return bool((far <= SAME_TIMES * abs(float(np.median(np.diff(seconds))))).all())


def _in_common(
    path: Path, time: _Clock, own: _Clock, names: Sequence[str], channels: Channels
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Times of the positions and of a group, ns from the first of the positions, once they can be joined."""
    advice = (
        "Where its rows are those of the positions, leave `time` out and give `rate_hz`; else export times that grow, "
        "or split the file."
    )
    seconds, theirs = time.seconds(path), own.seconds(path)
    for clock, t in ((time, seconds), (own, theirs)):
        stamps.check_order(path, clock.name, t, advice)
    stamps.checked(path, time.name, seconds, 0.0)  # of another unit than was given, perhaps
    stamps.check_length(path, theirs.size)
    stamps.check_repeats(path, own.name, theirs, advice)
    apart = own.begin(path) - time.begin(path)
    first, last = float(apart), float(apart) + float(theirs[-1])
    common = min(float(seconds[-1]), last) - max(0.0, first)
    which = f"the times of {channel_list(names, 8)}, {own.name!r} in {own.unit},"
    if common <= 0 or last > LATEST or common < max(_COVERED * float(seconds[-1]), _INSIDE * float(theirs[-1])):
        has = f"{common:.4g} s" if common > 0 else "no time"
        raise LogTimeError(
            f"{path}: {which} run from {first:.6g} to {last:.6g} s after the first of the positions, {time.name!r} in "
            f"{time.unit}, which last {float(seconds[-1]):.6g} s: the clocks have {has} in common (limit "
            f"{100 * _COVERED:.0f} % of the positions', {100 * _INSIDE:.0f} % of the other's).",
            where=own.name,
            found=max(common, 0.0),
            limit=_COVERED * float(seconds[-1]),
            advice="Say the unit of times in their names (`time_ms`) or in an attribute `units`, and count both from "
            "the same start; where rows belong together, leave `time` out and give `rate_hz`.",
        )
    step, usual = (float(np.median(np.diff(t))) for t in (theirs, seconds))
    if step > max(_SLOW, _SLOWER * usual) and not (channels.merge.largest_gap or 0.0) >= step:
        raise LogTimeError(
            f"{path}: {which} are {step:.4g} s apart, and those of the positions {usual:.4g} s (limit "
            f"{max(_SLOW, _SLOWER * usual):.4g} s).",
            where=own.name,
            found=step,
            limit=max(_SLOW, _SLOWER * usual),
            advice="Say the unit of times in their names (`time_ms`) or in an attribute `units`; where samples are so "
            f"far apart, give `largest_gap` of {step:.2g} s or more.",
        )
    begin = round(apart * 10**9)
    return np.rint(1e9 * seconds).astype(np.int64), np.rint(1e9 * theirs).astype(np.int64) + begin
