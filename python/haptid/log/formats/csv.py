"""Text logs: one header line, then rows of numbers, separated by commas, semicolons or tabs."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow

from haptid.errors import LogError, LogFileError
from haptid.log.formats.sniff import RawChannel, check_members, corrupt, empty, opened_file, repeated_name, require

_KIND = "CSV"
SEPARATORS = (";", "\t", ",")
HEAD_BYTES = 2**20
# Longer than any row, but short: the reader buffers about forty blocks.
BLOCK_BYTES = 2**19
COMMENT = re.compile(r"\s*[#%]")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE | re.ASCII)
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
MISSING = frozenset(arrow.ConvertOptions().null_values)


@dataclass(frozen=True)
class _Dialect:
    """Format of a text log.

    Attributes:
        separator: between cells.
        decimal: point or comma.
        names: of the columns, from the header, stripped of blanks.
        lines: number of lines before the first row.
        start: byte at which the rows start.
    """

    separator: str
    decimal: str
    names: tuple[str, ...]
    lines: int
    start: int


def names(path: Path) -> list[str]:
    """Names of the columns."""
    with opened_file(path, _KIND):
        return list(dict.fromkeys(_dialect(path).names))


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted columns that exist in the file, each (n,) float64; a missing cell is NaN.

    Raises:
        LogFileError: the first line holds no names, a line has more or fewer cells than the header, or a cell of a
            wanted column is not a number.
    """
    with opened_file(path, _KIND):
        dialect = _dialect(path)
    check_members(path, len(dialect.names), "columns")
    indices = {name: dialect.names.index(name) for name in wanted if name in dialect.names}
    for name in indices:
        if dialect.names.count(name) > 1:
            raise repeated_name(path, name)
    if not indices:
        return {}
    bound = _row_bound(path, dialect)
    out = dict(zip(indices, np.empty((len(indices), bound)), strict=True))
    row = 0
    try:
        for batch in _batches(path, dialect, [str(k) for k in indices.values()]):
            for k, column in enumerate(out.values()):
                column[row : row + batch.num_rows] = batch.column(k).to_numpy(zero_copy_only=False)
            row += batch.num_rows
    except (pa.ArrowInvalid, ValueError) as error:
        raise _fault(path, dialect, indices) or corrupt(path, _KIND, str(error)) from error
    return {name: column[:row] for name, column in out.items()}


def _batches(path: Path, dialect: _Dialect, include: list[str]) -> Iterator[pa.RecordBatch]:
    """The wanted columns block by block, selected by number, so that odd names cannot matter."""
    with path.open("rb") as file:
        file.seek(dialect.start)
        yield from arrow.open_csv(
            file,
            read_options=arrow.ReadOptions(
                column_names=[str(k) for k in range(len(dialect.names))],
                block_size=BLOCK_BYTES,
                use_threads=False,
            ),
            parse_options=arrow.ParseOptions(delimiter=dialect.separator),
            convert_options=arrow.ConvertOptions(
                column_types=dict.fromkeys(include, pa.float64()),
                include_columns=include,
                decimal_point=dialect.decimal,
                check_utf8=False,
            ),
        )


def _dialect(path: Path) -> _Dialect:
    """Find the header, the separator and the decimal mark."""
    require(path, _KIND, "text")
    with path.open("rb") as file:
        raw = file.read(HEAD_BYTES)
        whole = not file.read(1)
    lines = raw.removeprefix(b"\xef\xbb\xbf").splitlines(keepends=True)
    offset = len(raw) - sum(map(len, lines))
    texts = [line.decode("utf-8", errors="replace").rstrip("\r\n") for line in lines]
    if not whole and len(texts) > 1:
        del texts[-1]
    k = next((k for k, text in enumerate(texts) if text.strip() and not COMMENT.match(text)), None)
    commented = next((k for k in reversed(range(len(texts) if k is None else k)) if texts[k].strip()), None)
    if k is not None:
        body = [text for text in texts[k + 1 :] if text.strip()][:200]
        separator, header = _separate(texts[k], body)
        if not all(_NUMBER.fullmatch(cell.replace(",", ".")) for cell in header):
            return _found(header, separator, body, k + 1, offset + sum(map(len, lines[: k + 1])))
        if commented is not None:
            separator, header = _separate(COMMENT.sub("", texts[commented], count=1), [texts[k], *body])
            if len(header) == len(_cells(texts[k], separator)):
                return _found(header, separator, [texts[k], *body], k, offset + sum(map(len, lines[:k])))
        raise LogFileError(
            f"{path} has no header: its first line is `{texts[k][:60]}`.",
            where=path,
            found=texts[k],
            advice="Write the names of the columns in the first line, separated by commas, semicolons or tabs.",
        )
    raise empty(path, "no header and no rows")


def _found(header: list[str], separator: str, body: list[str], lines: int, start: int) -> _Dialect:
    cells = [cell for text in body for cell in _cells(text, separator)]
    comma = separator != "," and any(DECIMAL_COMMA.fullmatch(cell) for cell in cells)
    named = tuple(cell or f"column {k}" for k, cell in enumerate(header, 1))
    return _Dialect(separator, "," if comma else ".", named, lines, start)


def _separate(header: str, body: list[str]) -> tuple[str, list[str]]:
    """The separator that splits header and first rows into equal numbers of cells, and the header's cells."""

    def quality(separator: str) -> tuple[bool, int, int]:
        count = len(_cells(header, separator))
        return count > 1, sum(len(_cells(text, separator)) == count for text in body), count

    separator = max(reversed(SEPARATORS), key=quality)
    return separator, _cells(header, separator)


def _cells(text: str, separator: str) -> list[str]:
    """Cells of a line; none where one of them is too long for a number or a name."""
    with suppress(csv.Error):
        return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]
    return []


def _row_bound(path: Path, dialect: _Dialect) -> int:
    """Upper bound of the number of rows: blank lines are counted too.

    Raises:
        LogFileError: a header without rows.
    """
    newlines, returns, blank, last = 0, 0, True, b""
    with path.open("rb") as file:
        file.seek(dialect.start)
        while block := file.read(BLOCK_BYTES):
            newlines += block.count(b"\n")
            returns += block.count(b"\r") if not newlines else 0
            blank = blank and not block.strip()
            last = block[-1:]
    if blank:
        raise empty(path, "a header and no rows")
    return max(newlines, returns) + (last not in b"\r\n")


def _fault(path: Path, dialect: _Dialect, indices: dict[str, int]) -> LogError | None:
    """Error of the first line that does not match the header; a slow search, made only after a failure."""
    width = len(dialect.names)
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        rows = csv.reader(file, delimiter=dialect.separator)
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
            if line <= dialect.lines or not row:
                continue
            if len(row) != width:
                last = _is_last(rows)
                return _ragged(path, line, len(row), width, last)
            for name, k in indices.items():
                cell = row[k].strip()
                number = cell if dialect.decimal == "." else cell.replace(",", ".")
                if cell not in MISSING and not _NUMBER.fullmatch(number):
                    return LogFileError(
                        f"{path}, line {line}: {name} is `{cell[:40]}`, not a number.",
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


def _is_last(rows: Iterator[list[str]]) -> bool:
    with suppress(csv.Error):
        return next((False for later in rows if later), True)
    return False


def _ragged(path: Path, line: int, got: int, wanted: int, last: bool) -> LogFileError:
    """Error of a line with more or fewer cells than the header."""
    advice = "Correct this line; the separator is that of the header."
    if last:
        advice = "It is the last line, so the recording was cut short: delete this line."
    return LogFileError(
        f"{path}, line {line}: {got} cells where the header has {wanted}.",
        where=line,
        found=got,
        limit=wanted,
        advice=advice,
    )
