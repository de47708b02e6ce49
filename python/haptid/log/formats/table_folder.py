"""A folder of tables of one recording, a file for each signal, as `position.csv` and `torque.csv`.

A file of one column is one channel, `q1`; those of others are `position.q1`, or `position[1]` without a header. A file
of one column that has the samples of several joints in turn is `position[1]`, ... too. Files without headers that all
begin with a column of times are joined by these: `time`, and `pos` or `pos[1]`, ... of `pos.txt`; so are files with
headers that all have times, where these differ; what differs and cannot be joined is refused. A path with one `*`,
`run1_*.csv`, stands for the files of one recording among others; what they have in its place are the names of their
signals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import LogFileError
from haptid.log.formats.folders import DUMP, is_pattern, matched_files, table_files
from haptid.log.formats.sniff import RawChannel, check_members
from haptid.log.merging import SAME_TIMES
from haptid.log.request import Request
from haptid.log.stamps import FEWEST_SAMPLES

# A file of fewer bytes may be a note, and is read to see whether it is a table.
_SMALL = 2**16
# Most joints whose samples follow each other in one column; and the share of the steps from sample to sample that the
# steps from a joint's sample to its next one are below, in the median.
_MOST_JOINTS, _IN_TURN = 64, 0.5
# The channel of the times that files have in common; share of the usual span that those of a file cover; share of the
# rows of each file that its times have in common with all others': where there are fewer, rows of one file alone are
# kept, and their channels are merged by time; and share of a step by which equal times differ at most.
_TIME, _COVERED, _COMMON, _SAME = "time", 0.5, 0.98, SAME_TIMES

if TYPE_CHECKING:
    from haptid.log.file_format import Format


@dataclass(frozen=True)
class _File:
    """A table of the folder.

    Attributes:
        stem: name of its signal.
        channels: names of its columns, by their names in the folder.
        joints: whose samples follow each other in its only column; 1 where it is one channel.
        times: its first column, by which it is joined to the others, (n,): that of the rows before the times stop to
            grow, as where a recorder filled its buffer with the last one; None where files are joined row by row.
    """

    path: Path
    kind: Format
    stem: str
    channels: dict[str, str]
    joints: int = 1
    times: Array | None = None

    def columns(self, wanted: Sequence[str]) -> dict[str, RawChannel]:
        """The wanted channels, each (n,)."""
        asked = {name: own for own, name in self.channels.items() if own in wanted}
        found = self.kind.columns(self.path, list(asked)) if asked and self.joints == 1 else {}
        made = {asked[name]: column for name, column in found.items()}
        if self.joints > 1 and any(own in wanted for own in self.channels):
            (inside,) = set(self.channels.values())
            rows = self.kind.columns(self.path, [inside])[inside].reshape(-1, self.joints)
            made |= {own: rows[:, k] for k, own in enumerate(self.channels) if own in wanted}
        return made


def names(folder: Path) -> list[str]:
    """Channels of all files; what is no table, as a note beside them, is passed over."""
    files = _files(folder)
    found = [_TIME] * bool(files and files[0].times is not None) + [own for file in files for own in file.channels]
    check_members(folder, len(found), "channels")
    return found


def units(folder: Path) -> dict[str, str]:
    """Units that the files state."""
    return {
        own: stated[name]
        for file in _files(folder)
        for stated in (file.kind.units(file.path),)
        for own, name in file.channels.items()
        if name in stated
    }


def columns(folder: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels, each (n,)."""
    found: dict[str, RawChannel] = {}
    files = _files(folder)
    if files and files[0].times is not None:
        found = _by_time(files, wanted, request)
        used = {file.path for file in files}
        if others := [file.path.name for file in _tables(folder) if file.path not in used]:
            request.notes.append(f"without times of this recording, and left out: {', '.join(others)}")
    else:
        _refuse_other_times(folder, [file for file in files if any(own in wanted for own in file.channels)])
        for file in files:
            found |= file.columns(wanted)
    return {name: found[name] for name in wanted if name in found}


def _refuse_other_times(folder: Path, files: Sequence[_File]) -> None:
    """Refuse files that would be taken row by row, and whose times say that their rows do not belong together.

    Raises:
        LogFileError: times of two of them differ, or the times of one do not grow.
    """
    timed: list[tuple[_File, Array]] = []
    for file in files if len(files) > 1 else ():
        if len(file.channels) < 2:
            continue
        if own := _time_of(file):
            timed.append((file, file.columns([own])[own].astype(np.float64)))
        elif "column[1]" in file.channels.values() and (first := _with_first_times(file)) and first.times is not None:
            timed.append((file, first.times))
    timed = [(file, t) for file, t in timed if t.size >= FEWEST_SAMPLES]  # no notes, as the time of the start
    for other, t in timed[1:]:
        own_times = timed[0][1]
        if _same(t, own_times):
            continue
        ranges = " and ".join(
            f"{named.path.relative_to(folder) if named.path.is_relative_to(folder) else named.path.name} from "
            f"{times[0]:.9g} to {times[-1]:.9g} ({times.size} rows)"
            for named, times in [timed[0], (other, t)]
        )
        lacking = [file.path.name for file in files if all(file is not named for named, _ in timed)]
        raise LogFileError(
            f"{folder}: times of files differ, {ranges}, and they cannot be joined by them: "
            + (f"{', '.join(lacking)} has none." if lacking else "they fall, or have most of their spans apart."),
            where=str(other.path),
            found=(float(t[0]), float(t[-1])),
            limit=(float(own_times[0]), float(own_times[-1])),
            advice="Give all files times of one clock, in one unit; where rows belong together, remove the times from "
            "all files but one; of several recordings, name one.",
        )


def _time_of(file: _File) -> str:
    """Its channel that is called a time; empty where there is none. Ticks may be those of an encoder."""
    from haptid.log.survey.names import is_time  # which knows the formats

    return next((own for own, name in file.channels.items() if is_time(name) and not name.endswith("ticks")), "")


def _same(t: Array, first: Array) -> bool:
    """Whether two files have the same times, but for a small share of a step."""
    return t.size == first.size and np.allclose(t, first, rtol=0.0, atol=_SAME * _step(first), equal_nan=True)


def _files(folder: Path) -> list[_File]:
    """Each file with its channels."""
    found = list(_tables(folder))
    if timed := _timed(found):
        return timed
    alone = [file for file in found if list(file.channels) == [file.stem]]
    if len(alone) < 2:
        return found
    samples = {file.path: next(iter(file.columns(list(file.channels)).values())) for file in alone}
    rows = min(column.size for column in samples.values())
    return [_in_turn(file, samples[file.path], rows) if file.path in samples else file for file in found]


def _timed(files: Sequence[_File]) -> list[_File]:
    """Files that are joined by times of one recording; none where not most of the tables are.

    Files without headers whose first columns are times; or files with headers that all have times, where these differ:
    else rows belong together as they are. Of the others some are of another clock, and some are notes, as the time of
    the start.
    """
    tables = [file for file in files if len(file.channels) > 1]
    if len(tables) < 2:
        return []
    if all("column[1]" in file.channels.values() for file in tables):
        made = [timed for file in tables if (timed := _with_first_times(file)) is not None]
    else:
        named = [_time_of(file) for file in tables]
        if not all(named):
            return []
        made = [timed for file, own in zip(tables, named, strict=True) if (timed := _with_times(file, own)) is not None]
        first, *others = [file.times for file in made if file.times is not None] or [np.empty(0)]
        if all(_same(t, first) for t in others):
            return []
    ends = np.array([file.times[[0, -1]] for file in made if file.times is not None])
    if len(made) < 2:
        return []
    begin, end = np.median(ends, axis=0)
    common = np.minimum(ends[:, 1], end) - np.maximum(ends[:, 0], begin)
    near = common > _COVERED * (end - begin)
    return [file for file, own in zip(made, near, strict=True) if own] if 2 * near.sum() > len(tables) else []


def _step(t: Array) -> float:
    return abs(float(np.median(np.diff(t)))) if t.size > 1 else 0.0


def _with_first_times(file: _File) -> _File | None:
    """A file without a header, with its first column as times; None where it is none."""
    inside = list(file.channels.values())
    inside = inside[1:] if file.path.name == DUMP and len(inside) > 2 else inside  # its first column counts
    own = inside[1:]
    names = [file.stem] if len(own) == 1 else [f"{file.stem}[{k}]" for k in range(1, len(own) + 1)]
    return _with_times(replace(file, channels={_TIME: inside[0], **dict(zip(names, own, strict=True))}), _TIME)


def _with_times(file: _File, time: str) -> _File | None:
    """A file with one of its channels as times; None where these do not grow."""
    inside = file.channels[time]
    t = file.kind.columns(file.path, [inside])[inside].astype(np.float64)
    grown = 1 + int(np.argmin(np.append(np.diff(t) > 0, False)))
    if grown < 2 or (t[grown:] != t[-1]).any() or t[grown - 1] != t[-1]:
        return None
    return replace(file, channels={own: name for own, name in file.channels.items() if own != time}, times=t[:grown])


def _by_time(files: Sequence[_File], wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """Channels on the rows whose times all files have, or where these are few, on those of each, NaN in the others."""
    times = [file.times for file in files if file.times is not None]
    common = times[0]
    for t in times[1:]:
        common = common[np.isin(common, t)]
    longest = max(t.size for t in times)
    few = common.size < _COMMON * longest
    common = np.unique(np.concatenate(times)) if few else common
    found: dict[str, RawChannel] = {_TIME: common}
    stopped = 0
    for file, t in zip(files, times, strict=True):
        own, at = np.isin(t, common), np.isin(common, t)
        for name, column in file.columns(wanted).items():
            stopped = max(stopped, column.size - t.size)
            made = np.full(common.size, np.nan)
            made[at] = column[: t.size][own]
            found[name] = made
    rows = "those of each" if few else f"{common.size} of {longest} that all have"
    repeated = f"; up to {stopped} rows at the end repeat the last time: left out" if stopped else ""
    request.notes.append(f"each file has its times: joined by them, rows are {rows}{repeated}")
    return found


def _in_turn(file: _File, column: RawChannel, rows: int) -> _File:
    """A file of one column, as samples of several joints in turn where its rows are a multiple of the shortest file's.

    The same would be true of a signal of a higher rate, whose samples change little from one to the next.
    """
    joints = column.size // max(rows, 1)
    if not (1 < joints <= _MOST_JOINTS and joints * rows == column.size):
        return file
    steps, turns = (float(np.nanmedian(np.abs(column[k:] - column[:-k]))) for k in (1, joints))
    if not turns < _IN_TURN * steps:
        return file
    (inside,) = file.channels.values()
    return replace(file, channels={f"{file.stem}[{k}]": inside for k in range(1, joints + 1)}, joints=joints)


def _tables(folder: Path) -> Iterator[_File]:
    """Each file as a table."""
    from haptid.log.file_format import format_of  # which names this module among the formats

    files = matched_files(folder) if is_pattern(folder) else [(_stem(file), file) for file in table_files(folder)]
    for stem, file in files:
        kind = format_of(file)
        try:
            inside = kind.names(file)
            if file.stat().st_size < _SMALL:
                kind.columns(file, inside)
        except LogFileError:
            continue
        named: Callable[[str], str] = _name_of(stem, inside)
        yield _File(file, kind, stem, {named(name): name for name in inside})


def _stem(file: Path) -> str:
    """Name of a file's signal: of a dump that of its folder, without the direction of its port."""
    return file.parent.name.partition(":")[0] if file.name == DUMP else file.stem


def _name_of(stem: str, inside: Sequence[str]) -> Callable[[str], str]:
    if len(inside) == 1:
        return lambda _: stem
    if all(name.startswith("column[") for name in inside):
        return lambda name: stem + name.removeprefix("column")
    return lambda name: f"{stem}.{name}"
