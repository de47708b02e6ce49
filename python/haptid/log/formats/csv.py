"""Text logs: a header, then rows of numbers, separated by commas, semicolons, tabs or blanks; sniffed."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid.errors import LogError, LogFileError
from haptid.log.formats.arrow import numbers
from haptid.log.formats.dates import DATE, DayOrder, nanoseconds
from haptid.log.formats.dialect import KIND, MISSING, Dialect, bare, cells_of, dialect_of
from haptid.log.formats.encoding import opened_text, opened_utf8, text_of
from haptid.log.formats.headers import NUMBER
from haptid.log.formats.lines import BLOCK_BYTES, Collapsed, Part, Without, blocks
from haptid.log.formats.sniff import RawChannel, check_members, corrupt, empty, opened_file, repeated_name
from haptid.log.request import Request

# Of a block without pyarrow.
BLOCK_ROWS = 2**14
_DAY = 86_400 * 10**9
# Texts of a column that are told.
_TEXTS = 3


def units(path: Path) -> dict[str, str]:
    """Units that the header states."""
    with opened_file(path, KIND):
        dialect = dialect_of(path)
    return {name: unit for name, unit in zip(dialect.names, dialect.units, strict=True) if unit}


def names(path: Path) -> list[str]:
    """Names of the columns."""
    with opened_file(path, KIND):
        return list(dialect_of(path).names)


def texts(path: Path, wanted: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Texts of columns that are no numbers, the first three different ones of each; empty cells are none."""
    with opened_file(path, KIND):
        dialect = dialect_of(path)
    chosen = [(name, dialect.names.index(name)) for name in wanted if name in dialect.names]
    found: dict[str, dict[str, None]] = {name: {} for name, _ in chosen}
    as_text = replace(dialect, dated=frozenset(k for _, k in chosen))
    try:
        for batch in _batches(path, as_text, [str(k) for _, k in chosen], _end(path, dialect)[0]) if chosen else ():
            for own, cells in zip(found.values(), batch, strict=True):
                if len(own) < _TEXTS:
                    own |= dict.fromkeys(str(cell).strip() for cell in np.unique(cells.astype(str)))
    except ValueError:
        return {}
    return {name: tuple(text for text in own if text)[:_TEXTS] for name, own in found.items()}


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted columns that exist in the file, each (n,) float64; a missing cell is NaN.

    Dates and times are seconds since the first of them, which is noted.

    The dialect is noted where it is not the usual one: commas, points and a header. A last line with too few cells, as
    of a recorder that was stopped, is dropped with a note.

    Raises:
        LogFileError: a line has more or fewer cells than the header, or a cell of a
            wanted column is not a number.
    """
    with opened_file(path, KIND):
        dialect = dialect_of(path)
    check_members(path, len(dialect.names), "columns")
    indices = {name: dialect.names.index(name) for name in wanted if name in dialect.names}
    for name in wanted:
        if name not in indices and f"{name} (1)" in dialect.names:
            raise repeated_name(path, name, f"Give one of them: {name} (1), {name} (2), ...")
    if not indices:
        return {}
    request.notes.extend(dialect.stated)
    bound = _row_bound(path, dialect)
    out = dict(zip(indices, np.empty((len(indices), bound)), strict=True))
    stop, cells = _end(path, dialect)
    dated = [name for name, k in indices.items() if k in dialect.dated]
    request.notes.extend(f"{name} holds dates or times of day: read as seconds since the first one" for name in dated)
    if cells:
        request.notes.append(
            f"the last line has {cells} cells of {len(dialect.names)}, as where a recording was stopped: dropped"
        )
    include = [str(k) for k in indices.values()]
    try:
        row = _fill(path, out, lambda: _batches(path, dialect, include, stop), dated)
    except ValueError as error:  # pyarrow's own are of this class too
        again = _again(path, dialect, stop)
        fault = error
        try:
            row = _fill(path, out, lambda: _batches(path, dialect, include, stop, again), dated) if again else -1
        except ValueError as other:
            row, fault = -1, other
        if row < 0:
            raise _fault(path, dialect, indices, again) or corrupt(path, KIND, str(fault)) from fault
        request.notes.append(
            "lines above the samples come again among them, as where a recorder was restarted: left out"
        )
    return {name: column[:row] for name, column in out.items()}


def _fill(path: Path, out: dict[str, Array], batches: Callable[[], Iterator[list[Array]]], dated: Sequence[str]) -> int:
    """Put the rows into the columns, dates as seconds; how many rows there are.

    Where late dates tell that the month is first, the rows are read once more.

    Raises:
        LogFileError: whether the day or the month is first is not known, and matters.
        ValueError: a line has more or fewer cells than the header, or a cell is no number or date.
    """
    orders = {name: DayOrder() for name in dated}
    row = _filled(out, batches(), orders)
    settled = [order.settled(path, name) for name, order in orders.items()]
    if all(settled):
        return row
    return _filled(out, batches(), {name: DayOrder(order.month_first) for name, order in orders.items()})


def _filled(out: dict[str, Array], batches: Iterator[list[Array]], orders: Mapping[str, DayOrder]) -> int:
    row, clocks = 0, {name: _Clock(order) for name, order in orders.items()}
    for batch in batches:
        for (name, column), part in zip(out.items(), batch, strict=True):
            column[row : row + len(part)] = clocks[name].seconds(part) if name in clocks else part
        row += len(batch[0])
    return row


def _again(path: Path, dialect: Dialect, stop: int) -> frozenset[bytes]:
    """The lines above the samples, where one of them comes again among these; none where none does."""
    with opened_utf8(path) as file:
        above = frozenset(line.strip() for line in file.read(dialect.start).splitlines() if line.strip())
        rest = Without(io.BufferedReader(Part(file, stop)), above)
        while above and not rest.count and rest.read(BLOCK_BYTES):
            pass
    return above if above and rest.count else frozenset()


class _Clock:
    """Seconds since the first of a column's dates; times of day run on past midnight."""

    def __init__(self, order: DayOrder) -> None:
        self.order = order
        self.first: int | None = None
        self.last = 0

    def seconds(self, cells: NDArray[Any]) -> Array:
        """Of the cells of a block, (n,), s.

        Raises:
            ValueError: a cell is no date.
        """
        made = np.full(len(cells), np.nan)
        for k, cell in enumerate(cells):
            if cell is None or cell in MISSING:
                continue
            now = nanoseconds(cell.strip(), self.order)
            while now < self.last - _DAY // 2 and now < _DAY * 10_000:  # no date
                now += _DAY
            self.first = now if self.first is None else self.first
            self.last = now
            made[k] = (now - self.first) * 1e-9
        return made


def _end(path: Path, dialect: Dialect) -> tuple[int, int]:
    """Byte at which the rows end, and cells of a last line that has too few and is left out; 0 for none."""
    with opened_utf8(path) as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(dialect.start, size - BLOCK_BYTES))
        block = file.read().rstrip()
    line = re.split(rb"[\r\n]", block)[-1]
    if len(line) == len(block):  # the only row, or no row at all
        return size, 0
    cells = len(cells_of(text_of(line), dialect.separator))
    if not 0 < cells < len(dialect.names):
        return size, 0
    return max(dialect.start, size - BLOCK_BYTES) + len(block) - len(line), cells


def _batches(
    path: Path, dialect: Dialect, include: list[str], stop: int, skipped: frozenset[bytes] = frozenset()
) -> Iterator[list[Array]]:
    """The wanted columns up to a byte, without some lines, block by block.

    They are selected by number, so that odd names cannot matter.
    By pyarrow where it is installed, which is some twenty times as fast as the standard library.
    """
    with opened_utf8(path) as whole:
        size = whole.seek(0, io.SEEK_END)
        whole.seek(dialect.start)
        file = whole if stop == size else io.BufferedReader(Part(whole, stop))
        file = io.BufferedReader(Without(file, skipped)) if skipped else file
        source = io.BufferedReader(Collapsed(file)) if dialect.separator == " " else file
        try:
            import pyarrow as pa
            from pyarrow import csv as arrow
        except ModuleNotFoundError:
            yield from _plain_batches(source, dialect, [int(k) for k in include])
            return
        for block in blocks(source):
            table = arrow.read_csv(
                pa.BufferReader(block),
                read_options=arrow.ReadOptions(
                    column_names=[str(k) for k in range(len(dialect.names))],
                    block_size=len(block),
                    use_threads=False,
                ),
                parse_options=arrow.ParseOptions(delimiter=dialect.separator),
                convert_options=arrow.ConvertOptions(
                    column_types={k: pa.string() if int(k) in dialect.dated else pa.float64() for k in include},
                    include_columns=include,
                    decimal_point=dialect.decimal,
                    check_utf8=False,
                ),
            )
            yield from ([numbers(column) for column in batch.columns] for batch in table.to_batches())


def _plain_batches(source: IO[bytes], dialect: Dialect, include: list[int]) -> Iterator[list[Array]]:
    """The same by the standard library.

    Raises:
        ValueError: a line has more or fewer cells than the header, or a cell is not a number.
    """
    lines = io.TextIOWrapper(source, "utf-8", "replace", newline="")
    try:
        rows = (row for row in csv.reader(lines, delimiter=dialect.separator) if row)
        while block := list(islice(rows, BLOCK_ROWS)):
            if any(len(row) != len(dialect.names) for row in block):
                raise ValueError("a line has another number of cells than the header")
            yield [
                np.array([row[k] if k in dialect.dated else _value(row[k], dialect.decimal) for row in block])
                for k in include
            ]
    finally:
        lines.detach()  # the caller closes the file


def _value(cell: str, decimal: str) -> float:
    """A number, NaN where it is missing; as pyarrow reads it."""
    return float("nan") if cell in MISSING else float(cell.strip().replace(decimal, "."))


def _row_bound(path: Path, dialect: Dialect) -> int:
    """Upper bound of the number of rows: blank lines are counted too.

    Raises:
        LogFileError: a header without rows.
    """
    newlines, returns, blank, last = 0, 0, True, b""
    with opened_utf8(path) as file:
        file.seek(dialect.start)
        while block := file.read(BLOCK_BYTES):
            newlines += block.count(b"\n")
            returns += block.count(b"\r") if not newlines else 0
            blank = blank and not block.strip()
            last = block[-1:]
    if blank:
        raise empty(path, "a header and no rows")
    return max(newlines, returns) + (last not in b"\r\n")


def _fault(path: Path, dialect: Dialect, indices: dict[str, int], skipped: frozenset[bytes]) -> LogError | None:
    """Error of the first line that does not match the header; a slow search, made only after a failure."""
    width = len(dialect.names)
    above = [cells_of(text_of(line), dialect.separator) for line in skipped]
    with opened_text(path) as file:
        blanks = dialect.separator == " "
        single = (" ".join(bare(line, named=k == dialect.lines).split()) for k, line in enumerate(file))
        rows = csv.reader(single if blanks else file, delimiter=dialect.separator)
        while True:
            first = rows.line_num + 1
            try:
                row = next(rows, None)
            except csv.Error as error:  # a cell of more than 131 072 characters
                return LogFileError(
                    f"{path}, line {first}: a cell cannot be read ({error}).",
                    where=first,
                    found=str(error),
                    advice="A quotation mark that is opened there and not closed is the likely cause: delete it.",
                )
            if row is None:
                return None
            line = rows.line_num
            if line <= dialect.lines or not row or (above and [cell.strip() for cell in row] in above):
                continue
            if len(row) != width:
                return _ragged(path, line, len(row), width)
            for name, k in indices.items():
                cell = row[k].strip()
                number = cell if dialect.decimal == "." else cell.replace(",", ".")
                right = DATE.fullmatch(cell) if k in dialect.dated else NUMBER.fullmatch(number)
                if cell not in MISSING and not right:
                    what = "date and time" if k in dialect.dated else "number"
                    return LogFileError(
                        f"{path}, line {line}: {name} is `{cell[:40]}`, not a {what}.",
                        where=(line, name),
                        found=cell,
                        advice="Correct the cell, or end the log before it; decimal commas require semicolons or tabs "
                        "as separators.",
                    )
            if sum(map(len, row)) + width > BLOCK_BYTES:
                return LogFileError(
                    f"{path}, line {line}: it has more than {BLOCK_BYTES >> 10} KiB, so it is no row of a log.",
                    where=line,
                    limit=BLOCK_BYTES,
                    advice="Export the channels of the motion alone.",
                )


def _ragged(path: Path, line: int, got: int, wanted: int) -> LogFileError:
    """Error of a line with more or fewer cells than the header."""
    return LogFileError(
        f"{path}, line {line}: {got} cells where the header has {wanted}.",
        where=line,
        found=got,
        limit=wanted,
        advice="Correct this line; the separator is that of the header.",
    )
