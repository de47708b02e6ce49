"""CSV with lists in its cells, `"[0.1, 0.2]"`, or with a row for each joint, whose name or number is in a column.

Lists become a channel for each element, `position[1]`, or `position[shoulder]` where a list of names is beside them, of
which each row may have its own; rows of joints become one row, with channels `position[shoulder]`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid.errors import LogFileError
from haptid.log.formats.encoding import encoding_of, opened_text
from haptid.log.formats.headers import is_number
from haptid.log.formats.lines import MATRIX_NAME
from haptid.log.formats.sniff import Budget, RawChannel, array_columns, array_names, opened_file
from haptid.log.request import Request

_KIND = "text table"
_SEPARATORS = (",", ";", "\t")
# Rows at the top of a file that tell it, and share of them that have the form.
_ROWS, _SHARE = 200, 0.9
# Numbers in one or two brackets, or of a tuple in quotes, as Python, NumPy and pandas print them.
_LIST = re.compile(
    r'"?(?:(?:np\.|numpy\.)?(?:array|tensor)\()?\[{1,2}(?P<numbers>[\s\d.,eE+\-naif]*)\]{1,2}\)?"?'
    r'|"\((?P<tuple>[\s\d.,eE+\-naif]*)\)"'
)
# The first row of a matrix as MATLAB writes it, whose rows end with semicolons.
_MATRIX = re.compile(rf"(?:{MATRIX_NAME})?\s*\[[^\]]*$")
# A list of names, and the column that has it.
_NAMES, _QUOTED = re.compile(r"[\[(].*[\])]"), re.compile(r"'([^']*)'|\"([^\"]*)\"")
_NAMING = re.compile(r"(?i)(?:^|[^a-z])names?$")
# Words of the column that says whose row it is, and joints at most.
_WHOSE = re.compile(r"(?i)(?:^|[^a-z])(?:joint|motor|axis|servo|actuator|drive|dof|id|name|names|ids)(?![a-z])")
_FEWEST_CYCLES, _MOST_JOINTS = 3, 32


def is_rearranged(head: bytes) -> bool:
    """Whether a table with these first bytes has lists in its cells, or a row for each joint."""
    text = head.decode(encoding_of(head), errors="replace")
    lines = [line for line in text.splitlines()[:-1] if line.strip() and not line.lstrip().startswith(("#", "%"))]
    lines = lines[: _ROWS + 1]
    if len(lines) < _FEWEST_CYCLES + 1 or _MATRIX.match(lines[0]):
        return False
    header, found = _table(iter(lines))
    if len(header) < 2 or any(is_number(cell, ".") for cell in header):
        return False
    rows = [row for row in found if len(row) == len(header)]
    lists = sum(any(map(_is_list, row)) for row in rows)
    return lists >= _SHARE * len(lines[1:]) or _whose(header, rows) is not None


def _is_list(cell: str) -> bool:
    """Whether a cell has several numbers, or a list of names: of one joint, as a gripper, beside it is one number."""
    return _NAMES.fullmatch(cell) is not None or (len(cell.split()) > 1 and _numbers(cell) is not None)


def names(path: Path) -> list[str]:
    """Names of the columns, with the element or the joint in brackets where there are several."""
    return array_names(path, _arrays(path)[0], "columns")


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels that the file has, each (n,) float64; NaN where a cell is empty."""
    arrays, notes = _arrays(path)
    made = array_columns(wanted, arrays)
    request.notes.extend(notes if made else ())
    return made


def _arrays(path: Path) -> tuple[dict[str, Array], tuple[str, ...]]:
    return _parsed(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _parsed(path: Path, _written: int) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Columns, (rows,) or (rows, elements), of one row for each time, and what is to be said of them."""
    with opened_file(path, _KIND):
        Budget(path).take(_KIND, 4 * path.stat().st_size)
        with opened_text(path) as file:
            header, found = _table(line for line in file if line.strip() and not line.lstrip().startswith(("#", "%")))
            rows = list(found)
    if rows and len(rows[-1]) < len(header):
        del rows[-1]  # a recorder was stopped
    for k, row in enumerate(rows):
        if len(row) != len(header):
            raise _wrong(path, k, f"{len(row)} cells where the header has {len(header)}")
    at = _whose(header, rows[:_ROWS])
    if at is None and (named := _by_names(path, header, rows)):
        return named, ()
    if at is None:
        return {name: _column(path, name, [row[k] for row in rows]) for k, name in enumerate(header)}, ()
    return _by_joint(path, header, rows, at)


def _by_names(path: Path, header: list[str], rows: list[list[str]]) -> dict[str, Array]:
    """Columns with an element for each joint that a list of names beside them has, in each row; none without such."""
    at = next((k for k, name in enumerate(header) if _NAMING.search(name)), None)
    if at is None or not all(_NAMES.fullmatch(row[at]) for row in rows):
        return {}
    texts = [tuple("".join(both) for both in _QUOTED.findall(row[at])) for row in rows]
    joints = list(dict.fromkeys(joint for own in texts for joint in own))
    if not 1 < len(joints) <= _MOST_JOINTS:
        return {}
    place = {joint: k for k, joint in enumerate(joints)}
    made: dict[str, Array] = {}
    for k, name in enumerate(header):
        cells = [_numbers(row[k]) or [] for row in rows]
        if (
            k != at
            and max(map(len, cells)) > 1
            and all(len(x) in (0, len(t)) for x, t in zip(cells, texts, strict=True))
        ):
            table = np.full((len(rows), len(joints)), np.nan)
            for row, numbers, own in zip(table, cells, texts, strict=True):
                row[[place[joint] for joint in own[: len(numbers)]]] = numbers
            made |= {f"{name}[{joint}]": table[:, j] for j, joint in enumerate(joints)}
        elif k != at:
            made[name] = _column(path, name, [row[k] for row in rows])
    return made


def _by_joint(
    path: Path, header: list[str], rows: list[list[str]], at: int
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Columns with a row for each turn of the joints, and one of times, those of the first joint."""
    joints = list(dict.fromkeys(row[at] for row in rows))
    place = {joint: k for k, joint in enumerate(joints)}
    own = np.array([place[row[at]] for row in rows])
    turns = np.cumsum(np.append(0, np.diff(own) <= 0))
    made: dict[str, Array] = {}
    notes = [f"rows are those of {len(joints)} joints in turn ({', '.join(joints[:6])}): one row for each turn"]
    for k, name in enumerate(header):
        values = _column(path, name, [row[k] for row in rows]) if k != at else np.zeros((0, 0))
        if values.ndim > 1:
            continue
        by_joint = np.full((turns[-1] + 1, len(joints)), np.nan)
        by_joint[turns, own] = values
        if k < 2 and (late := _lateness(values, turns)) is not None:
            made[name] = values[np.flatnonzero(np.diff(turns, prepend=-1))]
            more = f"{name} is that of the first of each turn, and the last is {late:.3g} later"
            notes += [more] if late > 0 else []
        else:
            made |= {f"{name}[{joint}]": by_joint[:, j] for j, joint in enumerate(joints)}
    return made, tuple(notes)


def _lateness(values: Array, turns: NDArray[np.intp]) -> float | None:
    """By how much the last row of a turn is later than the first; None where a column is none of times."""
    starts = np.flatnonzero(np.diff(turns, prepend=-1))
    steps, late = np.diff(values[starts]), values[np.append(starts[1:] - 1, len(values) - 1)] - values[starts]
    grows = np.isfinite(values).all() and steps.size and (steps > 0).all() and (late >= 0).all()
    return float(np.median(late)) if grows and np.median(late) < np.median(steps) else None


def _table(lines: Iterator[str]) -> tuple[list[str], Iterator[list[str]]]:
    """The header and the rows of a table; lists are cells of numbers apart by blanks."""
    first = next(lines, "").lstrip("\ufeff")
    separator = max(_SEPARATORS, key=first.count)
    header = [cell.strip() for cell in next(csv.reader([first.rstrip("\r\n")], delimiter=separator), [])]
    made = [name or f"column {k}" for k, name in enumerate(header, 1)]
    rows = csv.reader((_LIST.sub(_in_blanks, line) for line in lines), delimiter=separator)
    return made, ([cell.strip() for cell in row] for row in rows if row)


def _in_blanks(match: re.Match[str]) -> str:
    return " ".join((match["numbers"] or match["tuple"] or "").replace(",", " ").split())


def _numbers(cell: str) -> list[float] | None:
    """The numbers of a cell apart by blanks; None where it has none or something else."""
    parts = cell.split()
    return [float(part) for part in parts] if parts and all(is_number(part, ".") for part in parts) else None


def _whose(header: list[str], rows: Sequence[list[str]] | Iterator[list[str]]) -> int | None:
    """The column that says which joint a row belongs to: a few values, over and over in one order."""
    rows = list(rows)
    for k, name in enumerate(header):
        values = [row[k] for row in rows if len(row) == len(header)]
        joints = list(dict.fromkeys(values))
        few = 1 < len(joints) <= min(_MOST_JOINTS, len(values) // _FEWEST_CYCLES)
        if not (_WHOSE.search(name) and few) or any(map(_NAMES.fullmatch, joints)):
            continue
        follows = {(joints[i - 1], joint) for i, joint in enumerate(joints)}
        if sum(pair in follows for pair in pairwise(values)) >= _SHARE * (len(values) - 1):
            return k
    return None


def _column(path: Path, name: str, cells: list[str]) -> Array:
    """A column of numbers, or of as many in each cell; NaN where all cells are words."""
    found = [_numbers(cell) for cell in cells]
    width = next((len(numbers) for numbers in found if numbers), 0)
    if not width:
        return np.full(len(cells), np.nan)
    made = np.full((len(cells), width), np.nan)
    for k, (numbers, cell) in enumerate(zip(found, cells, strict=True)):
        if numbers is not None and len(numbers) != width:
            raise _wrong(path, k, f"{name} has {len(numbers)} numbers, before it had {width}")
        if numbers is None and cell:
            raise _wrong(path, k, f"{name} is `{cell[:40]}`, not {'a number' if width == 1 else 'numbers'}")
        if numbers is not None:
            made[k] = numbers
    return made[:, 0] if width == 1 else made


def _wrong(path: Path, row: int, found: str) -> LogFileError:
    return LogFileError(
        f"{path}, row {row + 1}: {found}.",
        where=row + 1,
        found=found,
        advice="Correct the row, or end the log before it.",
    )
