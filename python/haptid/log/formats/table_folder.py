"""A folder of tables of one recording, a file for each signal, as `position.csv` and `torque.csv`.

A file of one column is one channel, `q1`; those of others are `position.q1`, or `position[1]` without a header. A file
of one column that has the samples of several joints in turn is `position[1]`, ... too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from haptid.errors import LogFileError
from haptid.log.formats.folders import table_files
from haptid.log.formats.sniff import RawChannel, check_members

# A file of fewer bytes may be a note, and is read to see whether it is a table.
_SMALL = 2**16
# Most joints whose samples follow each other in one column; and the share of the steps from sample to sample that the
# steps from a joint's sample to its next one are below, in the median.
_MOST_JOINTS, _IN_TURN = 64, 0.5

if TYPE_CHECKING:
    from haptid.log.file_format import Format


@dataclass(frozen=True)
class _File:
    """A table of the folder.

    Attributes:
        channels: names of its columns, by their names in the folder.
        joints: whose samples follow each other in its only column; 1 where it is one channel.
    """

    path: Path
    kind: Format
    channels: dict[str, str]
    joints: int = 1

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
    found = [own for file in _files(folder) for own in file.channels]
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


def columns(folder: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels, each (n,)."""
    found: dict[str, RawChannel] = {}
    for file in _files(folder):
        found |= file.columns(wanted)
    return {name: found[name] for name in wanted if name in found}


def _files(folder: Path) -> list[_File]:
    """Each file with its channels."""
    found = list(_tables(folder))
    alone = [file for file in found if list(file.channels) == [file.path.stem]]
    if len(alone) < 2:
        return found
    samples = {file.path: next(iter(file.columns(list(file.channels)).values())) for file in alone}
    rows = min(column.size for column in samples.values())
    return [_in_turn(file, samples[file.path], rows) if file.path in samples else file for file in found]


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
    return _File(file.path, file.kind, {f"{file.path.stem}[{k}]": inside for k in range(1, joints + 1)}, joints)


def _tables(folder: Path) -> Iterator[_File]:
    """Each file as a table."""
    from haptid.log.file_format import format_of  # which names this module among the formats

    for file in table_files(folder):
        kind = format_of(file)
        try:
            inside = kind.names(file)
            if file.stat().st_size < _SMALL:
                kind.columns(file, inside)
        except LogFileError:
            continue
        named: Callable[[str], str] = _name_of(file.stem, inside)
        yield _File(file, kind, {named(name): name for name in inside})


def _name_of(stem: str, inside: Sequence[str]) -> Callable[[str], str]:
    if len(inside) == 1:
        return lambda _: stem
    if all(name.startswith("column[") for name in inside):
        return lambda name: stem + name.removeprefix("column")
    return lambda name: f"{stem}.{name}"
