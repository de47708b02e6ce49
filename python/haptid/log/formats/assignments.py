"""Variables of a controller as text of IEC 61131-3: `q : ARRAY[1..9] OF REAL := [0.1, 8(0.0)];`, `q[1] := 0.1;`.

Arrays of two dimensions are matrices, an array of structs, `arm[1].q := 0.1`, is a channel for each member. Variables
of one value are settings, and no channels; nor are arrays of texts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.bounded_files import LOG_UNPACKED
from haptid._internal.numerals import whole_number
from haptid.log.formats.encoding import encoding_of, opened_text
from haptid.log.formats.sniff import Budget, RawChannel, addresses, check_members, collect, opened_file

_KIND = "text of variables"
# An element's index is below; one of a matrix or of an array of arrays has several.
_MOST_ELEMENTS = 2**31
# Lines at the top of the file of which most assign a value.
_LINES = 5
_ASSIGNED = re.compile(
    r"\s*(?P<name>[A-Za-z_][\w.]*)(?:(?P<index>(?:\[[\d,\s]+\])+)(?P<member>\.[A-Za-z_][\w.]*)?)?\s*"
    r"(?P<type>:(?!=)[^=]*?)?:=\s*(?P<value>.*)",
    re.DOTALL,
)
_BOUNDS = re.compile(r"(-?\d{1,9})\s*\.\.\s*(-?\d{1,9})(?!\d)")
# A number, also as `REAL#0.1`, or followed by itself in hexadecimal, `0.75F16#-C000000H-7`; `3(0.0)` is three of them.
# No two parts in a row take the same characters, so that the time does not grow as a power of the length.
_DECIMAL = r"(?P<number>[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)"
_HEXADECIMAL = r"(?:(?:[A-Za-z]\d*)?#[+-]?[0-9A-Fa-f]+(?:H[+-]?[0-9A-Fa-f]+)?)?"
_VALUE = re.compile(r"(?:(?P<times>\d{1,18})\s*\(\s*)?(?:[A-Za-z]+#)?" + _DECIMAL + _HEXADECIMAL + r"(?:\s*\))?")


def is_assignments(head: bytes) -> bool:
    """Whether a text with these first bytes assigns values to variables."""
    text = head.decode(encoding_of(head), errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith(("(*", "//"))][:_LINES]
    found = sum(bool(_ASSIGNED.match(line)) for line in lines)
    return found > 0 and 2 * found > len(lines)


def names(path: Path) -> list[str]:
    """Names of the arrays, those of a matrix with numbers."""
    found = [channel for name, array in _arrays(path).items() for channel in addresses(name, array.shape)]
    check_members(path, len(found), "variables")
    return found


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted arrays that the file has, each (n,) float64."""

    def found() -> Iterator[tuple[str, RawChannel]]:
        for name, array in _arrays(path).items():
            yield from ((own, array[at]) for own, at in addresses(name, array.shape).items() if own in wanted)

    return collect(wanted, found())


def _arrays(path: Path) -> dict[str, Array]:
    """Arrays of more than one value, by their names."""
    return _parsed(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=64)  # a folder of such files is one log, of which each file is asked for several times
def _parsed(path: Path, _written: int) -> dict[str, Array]:
    found: dict[str, Array] = {}
    elements: dict[str, dict[tuple[int, ...], float]] = {}
    with opened_file(path, _KIND):
        Budget(path).take(_KIND, 4 * path.stat().st_size)
        for name, index, kind, text in _assignments(path):
            if index and max(index) < _MOST_ELEMENTS:
                elements.setdefault(name, {})[index] = float(_values(text)[0])
            elif not index and "[" in text:
                values = _values(text.strip().rstrip(";").strip().strip("[]"))
                sizes = [int(b) - int(a) + 1 for a, b in _BOUNDS.findall(kind)]
                found[name] = values.reshape(sizes) if np.prod(sizes) == values.size else values
    return {
        name: array
        for name, array in (found | _gathered(elements)).items()
        if array.size > 1 and not np.isnan(array).all()
    }


def _assignments(path: Path) -> Iterator[tuple[str, tuple[int, ...], str, str]]:
    """Name, index, type and value of each assignment; an array runs on to its closing bracket."""
    with opened_text(path) as file:
        for line in file:
            match = _ASSIGNED.match(line)
            if match is None:
                continue
            parts, value = [match["value"]], match["value"]
            if value.lstrip().startswith("["):
                while "]" not in parts[-1] and (more := file.readline()):
                    parts.append(more)
            digits = re.findall(r"\d+", match["index"] or "")
            index = tuple(_MOST_ELEMENTS if (n := whole_number(k)) is None else n for k in digits)
            yield match["name"] + (match["member"] or ""), index, match["type"] or "", "".join(parts)


def _values(text: str) -> Array:
    """The numbers of a list, or the one of an element; one NaN where they are none."""
    cells = [cell for part in text.split(",") if (cell := part.strip(" \r\n\t;"))]
    found = [match for cell in cells if (match := _VALUE.fullmatch(cell))]
    if not found or len(found) < len(cells):
        return np.array([np.nan])
    counts = [int(match["times"] or 1) for match in found]
    if sum(counts) > LOG_UNPACKED.value // 8:
        raise MemoryError
    return np.repeat([float(match["number"]) for match in found], counts)


def _gathered(elements: dict[str, dict[tuple[int, ...], float]]) -> dict[str, Array]:
    """Arrays of elements that were assigned one by one; those that are missing are NaN."""
    made = {}
    for name, values in elements.items():
        if len({len(index) for index in values}) == 1:
            at = np.array(list(values))
            at -= at.min(axis=0)
            if np.prod(at.max(axis=0) + 1.0) <= 4 * len(values):  # no few elements of a large array
                made[name] = np.full(at.max(axis=0) + 1, np.nan)
                made[name][tuple(at.T)] = list(values.values())
    return made
