"""Text logs: a header, then rows of numbers, separated by commas, semicolons, tabs or blanks; sniffed."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.numerals import whole_number
from haptid.errors import LogError, LogFileError
from haptid.log.formats import headers
from haptid.log.formats.arrow import numbers
from haptid.log.formats.encoding import encoding_of, opened_text, opened_utf8, text_of
from haptid.log.formats.headers import NUMBER, fitting_header, is_number, labview_header, numbered, two_levels
from haptid.log.formats.lines import BLOCK_BYTES, Collapsed, Part, Without, blocks
from haptid.log.formats.sniff import RawChannel, check_members, corrupt, empty, opened_file, repeated_name, require
from haptid.log.request import Request
from haptid.log.units import known_unit

_KIND = "CSV"
SEPARATORS = (",", "\t", ";", " ")
# Lines that tell the dialect.
SNIFFED = 200
# Samples begin below a line of names, or at this number of adjacent lines of numbers: settings have numbers too.
_ROWS_TOGETHER = 3
HEAD_BYTES = 2**20
# Of a block without pyarrow.
BLOCK_ROWS = 2**14
COMMENT = re.compile(r"\s*[#%]")
# ISO 8601, and a time of day alone.
_DATE = re.compile(
    r"(?:(?P<date>\d{4}[-/]\d\d[-/]\d\d)[T ])?(?P<hours>\d\d?):(?P<minutes>[0-5]\d):(?P<seconds>[0-5]\d)"
    r"(?:[.,](?P<part>\d{1,9})\d*)?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?",
    re.ASCII,
)
_DAY = 86_400 * 10**9
_UNIT = re.compile(r"[\[(](?P<unit>[^\[\]()\d][^\[\]()]*)[\])]\s*$")
# Cells without a number, as pyarrow takes them.
MISSING = frozenset({"", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN"}) | {
    *("N/A", "NA", "NULL", "NaN", "n/a", "nan", "null")
}


@dataclass(frozen=True)
class _Dialect:
    """Format of a text log.

    Attributes:
        separator: between cells.
        decimal: point or comma.
        names: of the columns, from the header, stripped of blanks.
        lines: number of lines before the first row.
        start: byte at which the rows start.
        units: of each column, as stated in the header or below it; empty where there is none.
        stated: what was found that is not usual, one sentence each.
        dated: numbers of the columns whose first cell is a date and time, or a time of day.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    lines: int
    start: int
    units: tuple[str, ...] = ()
    stated: tuple[str, ...] = ()
    dated: frozenset[int] = frozenset()


def units(path: Path) -> dict[str, str]:
    """Units that the header states."""
    with opened_file(path, _KIND):
        dialect = _dialect(path)
    return {name: unit for name, unit in zip(dialect.names, dialect.units, strict=True) if unit}


def names(path: Path) -> list[str]:
    """Names of the columns."""
    with opened_file(path, _KIND):
        return list(_dialect(path).names)


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted columns that exist in the file, each (n,) float64; a missing cell is NaN.

    Dates and times are seconds since the first of them, which is noted.

    The dialect is noted where it is not the usual one: commas, points and a header. A last line with too few cells, as
    of a recorder that was stopped, is dropped with a note.

    Raises:
        LogFileError: a line has more or fewer cells than the header, or a cell of a
            wanted column is not a number.
    """
    with opened_file(path, _KIND):
        dialect = _dialect(path)
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
        row = _fill(out, _batches(path, dialect, include, stop), dated)
    except ValueError as error:  # pyarrow's own are of this class too
        again = _again(path, dialect, stop)
        fault = error
        try:
            row = _fill(out, _batches(path, dialect, include, stop, again), dated) if again else -1
        except ValueError as other:
            row, fault = -1, other
        if row < 0:
            raise _fault(path, dialect, indices, again) or corrupt(path, _KIND, str(fault)) from fault
        request.notes.append(
            "lines above the samples come again among them, as where a recorder was restarted: left out"
        )
    return {name: column[:row] for name, column in out.items()}


def _fill(out: dict[str, Array], batches: Iterator[list[Array]], dated: Sequence[str]) -> int:
    """Put the rows into the columns, dates as seconds; how many rows there are.

    Raises:
        ValueError: a line has more or fewer cells than the header, or a cell is no number or date.
    """
    row, clocks = 0, {name: _Clock() for name in dated}
    for batch in batches:
        for (name, column), part in zip(out.items(), batch, strict=True):
            column[row : row + len(part)] = clocks[name].seconds(part) if name in clocks else part
        row += len(batch[0])
    return row


def _again(path: Path, dialect: _Dialect, stop: int) -> frozenset[bytes]:
    """The lines above the samples, where one of them comes again among these; none where none does."""
    with opened_utf8(path) as file:
        above = frozenset(line.strip() for line in file.read(dialect.start).splitlines() if line.strip())
        rest = Without(io.BufferedReader(Part(file, stop)), above)
        while above and not rest.count and rest.read(BLOCK_BYTES):
            pass
    return above if above and rest.count else frozenset()


class _Clock:
    """Seconds since the first of a column's dates; times of day run on past midnight."""

    def __init__(self) -> None:
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
            now = _nanoseconds(cell.strip())
            while now < self.last - _DAY // 2 and now < _DAY * 10_000:  # no date
                now += _DAY
            self.first = now if self.first is None else self.first
            self.last = now
            made[k] = (now - self.first) * 1e-9
        return made


def _nanoseconds(cell: str) -> int:
    """Of a date and time since the year 1, or of a time of day since midnight."""
    found = _DATE.fullmatch(cell)
    if found is None:
        raise ValueError(f"{cell} is no date and time")
    days = date(*(int(n) for n in re.split("[-/]", found["date"]))).toordinal() if found["date"] else 0
    zone = found["zone"] or "Z"
    offset = 0 if zone == "Z" else int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[-2:]))
    minutes = (days * 24 + int(found["hours"])) * 60 + int(found["minutes"]) - offset
    return (minutes * 60 + int(found["seconds"])) * 10**9 + int((found["part"] or "0").ljust(9, "0"))


def _end(path: Path, dialect: _Dialect) -> tuple[int, int]:
    """Byte at which the rows end, and cells of a last line that has too few and is left out; 0 for none."""
    with opened_utf8(path) as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(dialect.start, size - BLOCK_BYTES))
        block = file.read().rstrip()
    line = re.split(rb"[\r\n]", block)[-1]
    if len(line) == len(block):  # the only row, or no row at all
        return size, 0
    cells = len(_cells(text_of(line), dialect.separator))
    if not 0 < cells < len(dialect.names):
        return size, 0
    return max(dialect.start, size - BLOCK_BYTES) + len(block) - len(line), cells


def _batches(
    path: Path, dialect: _Dialect, include: list[str], stop: int, skipped: frozenset[bytes] = frozenset()
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


def _plain_batches(source: IO[bytes], dialect: _Dialect, include: list[int]) -> Iterator[list[Array]]:
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


def _dialect(path: Path) -> _Dialect:
    """Find the separator, the decimal mark, the header, and rows above and below it that are no samples."""
    require(path, _KIND, "text", "UTF-16 text")
    with opened_utf8(path) as file:
        raw = file.read(HEAD_BYTES)
        whole = not file.read(1)
    lines = raw.removeprefix(b"\xef\xbb\xbf").splitlines(keepends=True)
    offset = len(raw) - sum(map(len, lines))
    encoding = encoding_of(raw)
    texts = [line.decode(encoding, errors="replace").rstrip("\r\n") for line in lines]
    if not whole and len(texts) > 1:
        del texts[-1]
    below, measured = labview_header(texts)
    filled = [k for k, text in enumerate(texts) if k >= below and text.strip() and not COMMENT.match(text)][:SNIFFED]
    if not filled:
        raise empty(path, "no header and no rows")
    separator, decimal = _separator([texts[k] for k in filled])
    rows = [_cells(texts[k], separator) for k in filled]
    width = _width(rows, decimal)
    samples = [_is_row(row, width, decimal) for row in rows]
    names_only = [len(row) == width and not any(is_number(cell, decimal) for cell in row) for row in rows]
    plain = [samples[k] and all(is_number(cell, decimal) for cell in row) for k, row in enumerate(rows)]
    begins = (
        i
        for i in range(len(rows))
        if samples[i] and (all(samples[i : i + _ROWS_TOGETHER]) or (plain[i] and names_only[i - 1]))
    )
    first = next(begins, 1)
    head = first - 1
    units: tuple[str, ...] = ()
    if head >= 1 and len(rows[head]) == len(rows[head - 1]) == width and _are_units(rows[head]):
        units, head = tuple(_unit(cell) for cell in rows[head]), head - 1
    stated: list[str] = []
    fitting = fitting_header(rows[head], rows[first:], width) if first else None
    if fitting is None:
        header, start = _without_header(
            texts, filled[first % len(rows)], rows[first:] or rows, separator, width, stated
        )
        if first:
            stated.append(f"the line above the samples has {len(rows[head])} cells where they have {width}: not used")
    else:
        header, start = fitting, filled[first - 1] + 1
        if head > 0 and (joined := two_levels(rows[head - 1], header)):
            header, head = joined, head - 1
            stated.append("the header has two lines: names are those of both, such as " + header[-1])
        if head > 0:
            stated.append(f"{head} lines before the header are not used")
    if units:
        stated.append("the line below the header is taken as units")
    elif measured:
        units = tuple((measured + [""] * len(header))[: len(header)])
    else:
        units = tuple(_unit(match["unit"]) if (match := _UNIT.search(cell)) else "" for cell in header)
    if separator == " " or decimal == ",":
        words = {" ": "blanks", "\t": "tabs", ";": "semicolons", ",": "commas"}
        stated.append(
            f"cells are separated by {words[separator]}, with decimal {'commas' * (decimal == ',') or 'points'}"
        )
    named = numbered([cell or f"column {k}" for k, cell in enumerate(header, 1)], stated)
    dated = frozenset(k for k, cell in enumerate(rows[first] if first < len(rows) else []) if _DATE.fullmatch(cell))
    begin = offset + sum(map(len, lines[:start]))
    return _Dialect(separator, decimal, named, start, begin, units, tuple(stated), dated)


def _without_header(
    texts: list[str], first: int, rows: list[list[str]], separator: str, width: int, stated: list[str]
) -> tuple[list[str], int]:
    """Names of the columns of rows without a header, from a comment or by number, and the line at which rows start."""
    commented = next((k for k in reversed(range(first)) if COMMENT.match(texts[k]) and texts[k].strip("#% \t")), None)
    if commented is not None:
        text = COMMENT.sub("", texts[commented], count=1)
        cells = _cells(text, separator)
        if len(cells) == width and not all(is_number(cell, ".") for cell in cells):
            return cells, first
        if names := headers.blank_names(text, width):
            return names, first
    if len(rows) > 1 and width > 1 and [whole_number(cell) for cell in rows[0]] == list(range(width)):
        stated.append("the first line counts the columns from 0: it is taken as the header")
        return rows[0], first + 1
    stated.append(f"there is no header: columns are named column[1..{width}]")
    return [f"column[{k}]" for k in range(1, width + 1)], first


def _separator(texts: list[str]) -> tuple[str, str]:
    """The separator and the decimal mark by which the lines have most numbers, in rows of one width."""

    def numbers(choice: tuple[str, str]) -> tuple[bool, int]:
        separator, decimal = choice
        rows = [_cells(text, separator) for text in texts]
        width = _width(rows, decimal)
        first = next((k for k, row in enumerate(rows) if _is_row(row, width, decimal)), len(rows))
        found = sum(is_number(cell, decimal) for row in rows if len(row) == width for cell in row)
        headed = first == 0 or fitting_header(rows[first - 1], rows[first:], width) is not None
        return headed and found > 0, found * (2 if width > 1 else 1)

    there = [any(separator in text for text in texts) for separator in SEPARATORS]
    absent = there.index(False) if False in there else -1  # all absent ones give the same rows
    separators = [separator for k, separator in enumerate(SEPARATORS) if there[k] or k == absent]
    choices = [(separator, decimal) for separator in separators for decimal in ".," if separator + decimal != ",,"]
    return max(choices, key=numbers)


def _width(rows: list[list[str]], decimal: str) -> int:
    """The usual number of cells of the lines with numbers; of the header where there are none."""
    counts = Counter(len(row) for row in rows[1:] or rows if any(is_number(cell, decimal) for cell in row))
    return counts.most_common(1)[0][0] if counts else len(rows[0])


def _is_row(row: list[str], width: int, decimal: str) -> bool:
    """Whether a line holds samples: numbers in most of its cells that are not empty, or in as many as usual."""
    filled = [cell for cell in row if cell not in MISSING]
    found = sum(is_number(cell, decimal) for cell in filled)
    return len(row) == width and (2 * found > len(filled) or (found > 0 and 2 * found == len(filled)) or not filled)


def _are_units(cells: list[str]) -> bool:
    """Whether the cells of a line are units: at least half are known, and none is a number."""
    known = sum(known_unit(_unit(cell)) is not None for cell in cells)
    return 2 * known >= len(cells) and not any(is_number(cell, ".") for cell in cells)


def _unit(cell: str) -> str:
    return cell.strip().strip("[](){}").strip()


def _cells(text: str, separator: str) -> list[str]:
    """Cells of a line; none where one of them is too long for a number or a name."""
    if separator == " ":
        text = " ".join(text.split())
    with suppress(csv.Error):
        return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]
    return []


def _row_bound(path: Path, dialect: _Dialect) -> int:
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


def _fault(path: Path, dialect: _Dialect, indices: dict[str, int], skipped: frozenset[bytes]) -> LogError | None:
    """Error of the first line that does not match the header; a slow search, made only after a failure."""
    width = len(dialect.names)
    above = [_cells(text_of(line), dialect.separator) for line in skipped]
    with opened_text(path) as file:
        blanks = dialect.separator == " "
        rows = csv.reader((" ".join(line.split()) for line in file) if blanks else file, delimiter=dialect.separator)
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
                right = _DATE.fullmatch(cell) if k in dialect.dated else NUMBER.fullmatch(number)
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
