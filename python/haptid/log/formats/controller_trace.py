"""Traces that tools of controllers save: TwinCAT Scope as text, CODESYS (ctrlX, MOVIRUN, ...) as text or XML.

Variables, or groups of them, have times of their own. They become one table with a column `time`: that of all groups
where it is one, else every time of any group, with empty cells, which is read as a table of several sources is.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import field
from itertools import islice
from pathlib import Path
from xml.parsers import expat

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.numerals import whole_number
from haptid.errors import LogFileError
from haptid.log.formats.encoding import encoding_of, opened_text
from haptid.log.formats.sniff import Budget, RawChannel, check_members, collect, corrupt, opened_file
from haptid.log.request import Request

_KIND = "trace"
TIME = "time"
# Bytes that show the kind of a trace, and lines of a header at most.
HEAD, _HEADER = 2**14, 60
# CODESYS writes in `Flags` of its text how fine the times are.
_MILLISECONDS, _MICROSECONDS = 16, 32
_BLOCK = 2**20
_SCOPE = re.compile(r'"?Name"?(?P<separator>[\t;:, ]).*\r?\n"?File"?(?P=separator)')
_BRACKETS = re.compile(r"[\[(](?P<inside>[^\[\]()]*)[\])]")


@dataclass
class _Group:
    """Variables with common times.

    Attributes:
        times: of the samples, (n,), in `unit`.
        values: of each variable, (n,).
        units: that are stated, by variable.
        unit: of the times; empty where it is not stated.
    """

    times: Array
    values: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    unit: str = ""


def is_trace(head: bytes) -> bool:
    """Whether a file with these first bytes is such a trace."""
    return _reader(head) is not None


def names(path: Path) -> list[str]:
    """The time, and every variable."""
    return [TIME, *(name for group in _groups(path) for name in group.values)]


def units(path: Path) -> dict[str, str]:
    """Units that the file states."""
    groups = _groups(path)
    stated = {name: unit for group in groups for name, unit in group.units.items() if unit}
    return stated | ({TIME: groups[0].unit} if groups[0].unit else {})


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted variables, each (n,) float64; NaN at times of other groups."""
    groups = _groups(path)
    grid, joined = groups[0].times, len(groups) > 1
    if joined:
        grid = np.unique(np.concatenate([group.times for group in groups]))
        request.notes.append(f"{len(groups)} groups of variables have times of their own: joined by them")

    def on_grid() -> Iterator[tuple[str, RawChannel]]:
        yield TIME, grid
        for group in groups:
            at = np.searchsorted(grid, group.times) if joined else slice(None)
            for name, values in group.values.items():
                if name in wanted:
                    column = np.full(grid.size, np.nan)
                    column[at] = values
                    yield name, column

    made = dict(on_grid())
    return collect(wanted, ((name, made[name]) for name in dict.fromkeys(wanted) if name in made))


def _groups(path: Path) -> list[_Group]:
    """All groups, those of equal times together, in the file's order; names that are repeated are numbered.

    Raises:
        LogFileError: it is damaged, or has no samples.
    """
    with opened_file(path, _KIND):
        with path.open("rb") as file:
            reader = _reader(file.read(HEAD))
        if reader is None:
            raise LogFileError(
                f"{path} is not a trace of TwinCAT or CODESYS.",
                where=path,
                advice="Export it as CSV, with a header of names and a column of times.",
            )
        Budget(path).take(_KIND, 8 * path.stat().st_size)
        found = [group for group in reader(path) if group.times.size]
    if not found:
        raise LogFileError(
            f"{path} is a trace without samples.",
            where=path,
            advice="Record, stop, and save the trace with its data, not its configuration alone.",
        )
    check_members(path, sum(len(group.values) for group in found), "variables")
    return _merged(found)


def _merged(found: list[_Group]) -> list[_Group]:
    merged: list[_Group] = []
    taken: dict[str, int] = {TIME: 1}
    for group in found:
        same = next((other for other in merged if np.array_equal(other.times, group.times, equal_nan=True)), None)
        if same is None:
            same = _Group(group.times, unit=group.unit)
            merged.append(same)
        for name, values in group.values.items():
            taken[name] = taken.get(name, 0) + 1
            own = name if taken[name] == 1 else f"{name} ({taken[name]})"
            same.values[own] = values
            same.units[own] = group.units.get(name, "")
    return merged


def _reader(head: bytes) -> Callable[[Path], Iterator[_Group]] | None:
    """The function that reads a file with this head; None where it is no trace."""
    text = head.decode(encoding_of(head), errors="replace")
    if _SCOPE.match(text):
        return _scope
    if text.startswith("[key]; [value]"):
        return _codesys_text
    if text.lstrip().startswith(("<?xml", "<Trace")) and "<Trace" in text:
        return _codesys_xml
    return None


def _scope(path: Path) -> Iterator[_Group]:
    """TwinCAT Scope: two blocks of labelled lines, then groups of columns, of which the first has the times."""
    with opened_text(path) as file:
        first = file.readline()
        match = _SCOPE.match(first + file.readline())
        separator = match["separator"] if match else "\t"
        lines = csv.reader(file, delimiter=separator)
        ahead = (row for row in lines if any(cell.strip() for cell in row))
        header = next((row for row in islice(ahead, _HEADER) if row[0].strip() == "Name"), [])
        labels: dict[str, list[str]] = {}
        rows: list[list[str]] = []
        for row in islice(ahead, _HEADER):
            if _is_number(row[0]) or not row[0].strip():
                rows.append(row)
                break
            labels[_BRACKETS.sub("", row[0]).strip()] = row
        starts = [k for k, name in enumerate(header) if name.strip() == "Name"]
        rows.extend(row for row in lines if len(row) > 1)
    if rows and separator == " " and len(header) > len(rows[0]):
        raise LogFileError(
            f"{path}: cells are separated by blanks, and names have blanks too ({len(header)} cells in the header, "
            f"{len(rows[0])} below).",
            where=path,
            advice="Export it with tabs or semicolons.",
        )
    scale = labels.get("SampleTime", [""])[0]
    unit = match["inside"] if (match := _BRACKETS.search(scale)) else "ms"
    stated = labels.get("Unit", [])
    for start, end in zip(starts, [*starts[1:], len(header)], strict=True):
        own = [row for row in rows if len(row) > start and row[start].strip()]
        group = _Group(_column(own, start), unit=unit)
        for k in range(start + 1, end):
            name = header[k].strip() or f"column {k + 1}"
            group.values[name] = _column(own, k)
            group.units[name] = stated[k].split("(")[0].strip() if k < len(stated) else ""
        yield group


def _column(rows: list[list[str]], k: int) -> Array:
    return np.array([float(row[k].replace(",", ".")) if k < len(row) and row[k].strip() else np.nan for row in rows])


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _codesys_text(path: Path) -> Iterator[_Group]:
    """CODESYS as text: lines `key; value`; below `N.Data` lines `; time; value` of variable N."""
    unit, name, data = "", "", False
    times: list[float] = []
    values: list[float] = []
    with opened_text(path) as file:
        for line in file:
            key, _, rest = line.strip().partition(";")
            if data and not key and rest:
                time, _, value = rest.partition(";")
                times.append(float(time))
                values.append(_value(value))
                continue
            if times:
                yield _Group(np.array(times), {name: np.array(values)}, unit=unit)
                times, values = [], []
            data = key.endswith(".Data")
            if key == "Flags" and (flags := whole_number(rest)) is not None:
                unit = "us" if flags & _MICROSECONDS else "ms" if flags & _MILLISECONDS else ""
            elif key.endswith(".Variable"):
                name = rest.strip()
    if times:
        yield _Group(np.array(times), {name: np.array(values)}, unit=unit)


def _value(cell: str) -> float:
    """A number, or a truth value as 0 or 1."""
    cell = cell.strip()
    return {"TRUE": 1.0, "FALSE": 0.0}.get(cell.upper(), np.nan) if cell[:1].isalpha() else float(cell)


def _codesys_xml(path: Path) -> Iterator[_Group]:
    """CODESYS as XML: `<TraceVariable VarName="..."><Values>...</Values><Timestamps>...</Timestamps>`."""
    found = _Xml(path).run()
    for name, times, values in found.variables:
        count = min(times.size, values.size)
        yield _Group(times[:count], {name: values[:count]}, unit="us" if found.micro else "ms")


class _Xml:
    """The variables of a trace in XML; all else of it is passed over.

    Attributes:
        variables: name, times and values of each.
        micro: whether times are in microseconds.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.name, self.tag, self.asked = path, "", "", False
        self.text: list[str] = []
        self.parts: dict[str, Array] = {}
        self.variables: list[tuple[str, Array, Array]] = []
        self.micro = False

    def run(self) -> _Xml:
        parser = expat.ParserCreate()
        parser.buffer_text = True
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = self._characters, self._doctype
        with self.path.open("rb") as file:
            while block := file.read(_BLOCK):
                parser.Parse(block, False)
        parser.Parse(b"", True)
        return self

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self.tag, self.text = tag, []
        self.asked = attributes.get("Name") == "MicroSeconds"
        if tag == "TraceVariable":
            self.name, self.parts = attributes.get("VarName", ""), {}

    def _characters(self, text: str) -> None:
        if self.asked or self.tag in ("Values", "Timestamps"):
            self.text.append(text)

    def _end(self, tag: str) -> None:
        if self.asked:
            self.micro, self.asked = "".join(self.text).strip().lower() == "true", False
        if tag in ("Values", "Timestamps"):
            cells = "".join(self.text).split(",")
            self.parts[tag] = np.array([_value(cell) for cell in cells if cell.strip()])
        elif tag == "TraceVariable" and len(self.parts) == 2:
            self.variables.append((self.name, self.parts["Timestamps"], self.parts["Values"]))
        self.tag = ""

    def _doctype(self, *_: object) -> None:
        raise corrupt(self.path, _KIND, "it has a DTD, which can define entities")
