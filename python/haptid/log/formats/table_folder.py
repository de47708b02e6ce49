"""A folder of tables of one recording, a file for each signal, as `position.csv` and `torque.csv`.

A file of one column is one channel, `q1`; those of others are `position.q1`, or `position[1]` without a header.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from haptid.errors import LogFileError
from haptid.log.formats.folders import table_files
from haptid.log.formats.sniff import RawChannel, check_members

# A file of fewer bytes may be a note, and is read to see whether it is a table.
_SMALL = 2**16

if TYPE_CHECKING:
    from haptid.log.file_format import Format


def names(folder: Path) -> list[str]:
    """Channels of all files; what is no table, as a note beside them, is passed over."""
    found = [own for _, _, channels in _files(folder) for own in channels]
    check_members(folder, len(found), "channels")
    return found


def units(folder: Path) -> dict[str, str]:
    """Units that the files state."""
    return {
        own: stated[name]
        for file, kind, channels in _files(folder)
        for stated in (kind.units(file),)
        for own, name in channels.items()
        if name in stated
    }


def columns(folder: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels, each (n,)."""
    found: dict[str, RawChannel] = {}
    for file, kind, channels in _files(folder):
        asked = {name: own for own, name in channels.items() if own in wanted}
        if asked:
            found |= {asked[name]: column for name, column in kind.columns(file, list(asked)).items()}
    return {name: found[name] for name in wanted if name in found}


def _files(folder: Path) -> Iterator[tuple[Path, Format, dict[str, str]]]:
    """Each file with its format, and its channels: their names here, and in the file."""
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
        yield file, kind, {named(name): name for name in inside}


def _name_of(stem: str, inside: Sequence[str]) -> Callable[[str], str]:
    if len(inside) == 1:
        return lambda _: stem
    if all(name.startswith("column[") for name in inside):
        return lambda name: stem + name.removeprefix("column")
    return lambda name: f"{stem}.{name}"
