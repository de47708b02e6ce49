"""Text tables with a channel in each row: its name, if any, and then its samples."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from haptid.log.formats.encoding import opened_text, opened_utf8, text_of
from haptid.log.formats.sniff import RawChannel, collect, corrupt, opened_file

_KIND = "text"
# Bytes of the first row that are looked at, least samples, and least samples for every row.
_HEAD, _LEAST, _FLAT = 2**16, 100, 5
_MOST_ROWS = 1000
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?nan", re.IGNORECASE | re.ASCII)


def is_transposed(path: Path) -> bool:
    """Whether a text file has far fewer rows than columns, all numbers but for a name at the start of each row."""
    with opened_file(path, _KIND), opened_utf8(path) as file:
        head = file.read(_HEAD)
        if b"\0" in head or head.count(b"\n") > len(head) // (2 * _LEAST):
            return False
        rest = file.read(2**20)
        lines = (head + rest).count(b"\n")
        while rest and lines <= _MOST_ROWS:
            rest = file.read(2**20)
            lines += rest.count(b"\n")
        size = file.seek(0, io.SEEK_END)
    first = next(
        (line for line in head.split(b"\n") if line.strip() and not line.lstrip().startswith((b"#", b"%"))), b""
    )
    cells = _cells(text_of(first))[:-1]
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in cells)
    share = len(first) / max(1, len(cells))
    columns = size / max(1, lines) / max(1.0, share)
    return lines <= _MOST_ROWS and numbers >= max(_LEAST // 2, len(cells) - 2) and columns >= max(_LEAST, _FLAT * lines)


def names(path: Path) -> list[str]:
    """Names of the rows; `column[1..n]` where they have none."""
    with opened_file(path, _KIND):
        return [name for name, _ in _rows(path)]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted rows, each (n,) float64; an empty cell is NaN.

    Raises:
        LogFileError: a cell is no number.
    """
    with opened_file(path, _KIND):
        return collect(wanted, ((name, _values(path, name, cells)) for name, cells in _rows(path) if name in wanted))


def _rows(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Name and cells of every row."""
    with opened_text(path) as file:
        count = 0
        for line in file:
            if not line.strip() or line.lstrip().startswith(("#", "%")):
                continue
            cells, count = _cells(line), count + 1
            named = bool(cells[0]) and not _NUMBER.fullmatch(cells[0])
            yield (cells[0], cells[1:]) if named else (f"column[{count}]", cells)


def _cells(line: str) -> list[str]:
    """Cells of a row, separated by commas, semicolons, tabs or blanks, without quotes."""
    line = line.strip()
    separator = next((mark for mark in (";", "\t", ",") if mark in line), None)
    cells = [cell.strip().strip('"') for cell in line.split(separator)]
    if separator in (";", "\t"):  # decimal commas
        cells = [cell.replace(",", ".", 1) for cell in cells]
    return cells[:-1] if cells and not cells[-1] else cells


def _values(path: Path, name: str, cells: list[str]) -> RawChannel:
    try:
        return np.array([cell or "nan" for cell in cells], dtype=float)
    except ValueError:
        wrong = next((k, cell) for k, cell in enumerate(cells, 1) if cell and not _NUMBER.fullmatch(cell))
        raise corrupt(path, _KIND, f"sample {wrong[0]} of {name} is {wrong[1][:40]!r}, not a number") from None
