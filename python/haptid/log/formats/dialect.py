"""Dialect of a text log: separator, decimal mark, header, and where its rows begin."""

from __future__ import annotations

import csv
import re
from collections import Counter
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from haptid._internal.late import dataclass
from haptid._internal.numerals import whole_number
from haptid.log.formats import headers
from haptid.log.formats.dates import DATE
from haptid.log.formats.encoding import encoding_of, opened_utf8
from haptid.log.formats.headers import across, fitting_header, is_number, labview_header, numbered, two_levels
from haptid.log.formats.lines import MATRIX_NAME
from haptid.log.formats.sniff import empty, require
from haptid.log.units import known_unit

KIND = "CSV"
SEPARATORS = (",", "\t", ";", " ")
# Lines that tell the dialect.
SNIFFED = 200
# Samples begin below a line of names, or at this number of adjacent lines of numbers: settings have numbers too.
_ROWS_TOGETHER = 3
HEAD_BYTES = 2**20
COMMENT = re.compile(r"\s*[#%]")
_UNIT = re.compile(r"[\[(](?P<unit>[^\[\]()\d][^\[\]()]*)[\])]\s*$")
# The name and the bracket before the first row of a matrix as MATLAB writes it.
_OPENED = re.compile(rf"^(?:{MATRIX_NAME})?\[*")
# Cells without a number, as pyarrow takes them.
MISSING = frozenset({"", "#N/A", "#N/A N/A", "#NA", "-1.#IND", "-1.#QNAN", "-NaN", "-nan", "1.#IND", "1.#QNAN"}) | {
    *("N/A", "NA", "NULL", "NaN", "n/a", "nan", "null")
}


@dataclass(frozen=True)
class Dialect:
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


def dialect_of(path: Path) -> Dialect:
    """The dialect of a file, which is found once for its content: a table of many columns is asked for by parts."""
    state = path.stat()
    return _found(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=64)  # a folder of tables is one log, of which each file is asked for several times
def _found(path: Path, _changed: int, _size: int) -> Dialect:
    """Find the separator, the decimal mark, the header, and rows above and below it that are no samples."""
    require(path, KIND, "text", "UTF-16 text")
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
    rows = [cells_of(texts[k], separator) for k in filled]
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
    if separator == " " and first and (spaced := headers.spaced_names(texts[filled[head]], width)):
        rows[head] = spaced
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
        if spanned := across(header, rows[first:]):
            header = spanned
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
    dated = frozenset(k for k, cell in enumerate(rows[first] if first < len(rows) else []) if DATE.fullmatch(cell))
    begin = offset + sum(map(len, lines[:start]))
    return Dialect(separator, decimal, named, start, begin, units, tuple(stated), dated)


def _without_header(
    texts: list[str], first: int, rows: list[list[str]], separator: str, width: int, stated: list[str]
) -> tuple[list[str], int]:
    """Names of the columns of rows without a header, from a comment or by number, and the line at which rows start."""
    commented = next((k for k in reversed(range(first)) if COMMENT.match(texts[k]) and texts[k].strip("#% \t")), None)
    if commented is not None:
        text = COMMENT.sub("", texts[commented], count=1)
        cells = cells_of(text, separator)
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
        rows = [cells_of(text, separator) for text in texts]
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


def cells_of(text: str, separator: str) -> list[str]:
    """Cells of a line; none where one of them is too long for a number or a name."""
    if separator == " ":
        text = " ".join(bare(text).split())
    with suppress(csv.Error):
        return [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]
    return []


def bare(text: str, named: bool = True) -> str:
    """A row of numbers without the brackets and the semicolon of a matrix as MATLAB writes it, `A = [ 0 1;`.

    Args:
        text: the row.
        named: whether the matrix may have a name there, as before its first row.
    """
    inner = (_OPENED.sub("", text.strip()) if named else text.strip().lstrip("[")).rstrip(";]")
    return text if inner.strip("0123456789+-.eE \t") else inner
