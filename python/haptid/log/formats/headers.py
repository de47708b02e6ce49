"""Headers of text tables: lines of names above rows of numbers."""

from __future__ import annotations

import re
from collections import Counter

NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.IGNORECASE | re.ASCII)
# Lines in which the headers of a LabVIEW measurement end.
_LABVIEW = 100
# The last name of a header, and the first number of the row that follows without an end of line.
_GLUED = re.compile(r"(?P<name>.*[^\d.+-])[+-]?\d+(?:\.\d+)?")

_GAP = re.compile(r"\s{2,}|\t")

# A name of times, which headers have and sentences seldom, with a unit or not.
_TIMES = re.compile(r"(?:t|ts|time|time_?stamp|stamp|sec|seconds|tick|zeit)(?:[_\[(].*)?", re.IGNORECASE)


def blank_names(line: str, width: int) -> list[str] | None:
    """Names that blanks separate, above rows that another mark separates; None where the line may be a sentence."""
    names = line.split()
    header = len(names) == len(set(names)) == width > 1 and any(_TIMES.fullmatch(name) for name in names)
    return names if header else None


def spaced_names(line: str, width: int) -> list[str] | None:
    """Names of several words that two blanks or more separate, above rows of blanks; None where they do not fit."""
    names = _GAP.split(line.strip())
    fits = len(names) == width > 1 and not any(is_number(name, ".") for name in names)
    return names if fits and len(line.split()) != width else None


def fitting_header(header: list[str], rows: list[list[str]], width: int) -> list[str] | None:
    """The header with as many names as rows have cells; None where it is none of theirs.

    A separator at the end of each line makes a cell more, comments of LabVIEW have cells in few rows, numbers of rows
    have no name in tables of R, and a recorder that ends no line after its header has the first row in it. Names may be
    separated by blanks where cells are not.
    """
    if not rows or len(header) == width:
        return header
    if len(header) == 1 and (names := blank_names(header[0], width)):
        return names
    glued = _GLUED.fullmatch(header[width - 1]) if len(header) == 2 * width - 1 else None
    if glued and sum(is_number(cell, ".") for cell in header[width:]) > width // 2:
        return [*header[: width - 1], glued["name"].strip()]
    if len(header) > width:
        return None if any(header[width:]) and header[width:] != ["Comment"] else header[:width]
    regular = [row for row in rows if len(row) == width]
    if not any(cell for row in regular for cell in row[len(header) :]):
        return [*header, *[""] * (width - len(header))]
    counts = [row[0] for row in regular]
    if len(header) == width - 1 and counts == [str(k + int(counts[0] == "1")) for k in range(len(counts))]:
        return ["row", *header]
    return None


def labview_header(texts: list[str]) -> tuple[int, list[str]]:
    """Line below the headers of a LabVIEW measurement, and the units of its columns; line 0 and none of other texts."""
    ends = [k for k, text in enumerate(texts[:_LABVIEW]) if text.startswith("***End_of_Header***")]
    if not ends or not texts[0].startswith("LabVIEW Measurement"):
        return 0, []
    mark = next((text[9] for text in texts[: ends[-1]] if text.startswith("Separator") and len(text) > 9), "\t")
    about = {text.partition(mark)[0]: text.split(mark)[1:] for text in texts[: ends[-1]]}
    time = "s" if "Time" in about.get("X_Dimension", []) else ""
    units = [unit.strip() for unit in about.get("Y_Unit_Label", [])]
    if "Multi" in about.get("X_Columns", []):  # times beside each channel
        return ends[-1] + 1, [unit for own in units for unit in (time, own)]
    return ends[-1] + 1, [time, *units]


def across(header: list[str], rows: list[list[str]]) -> list[str] | None:
    """A header whose names span several columns each, as merged cells; None of others.

    All unnamed columns have numbers, and those with a name before them are several groups of one width.
    """
    wide: list[int] = []
    for k, cell in enumerate(header):
        if not cell and not (
            wide and all(len(row) > k and is_number(row[k].replace(",", "."), ".") for row in rows[:8])
        ):
            return None
        wide = [*wide, 1] if cell else [*wide[:-1], wide[-1] + 1]
    widths = [width for width in wide if width > 1]
    if len(widths) < 2 or len(set(widths)) > 1:
        return None
    return [name for name, width in zip(filter(None, header), wide, strict=True) for _ in range(width)]


def two_levels(upper: list[str], lower: list[str]) -> list[str] | None:
    """Names of a header of two lines, as of tables of groups; None where the lower line alone tells the columns apart.

    A blank in the upper line belongs to the name on its left, as of a cell that spans several columns.
    """
    names = [name for name in lower if name]
    if len(upper) != len(lower) or len(set(names)) == len(names) or any(is_number(cell, ".") for cell in upper):
        return None
    made, group = [], ""
    for above, name in zip(upper, lower, strict=True):
        group = above or group
        made.append(f"{group} {name}".strip())
    return made if len(set(made)) == len(made) else None


def numbered(names: list[str], stated: list[str]) -> tuple[str, ...]:
    """Names, those that several columns have with a number each."""
    repeated = {name: 0 for name, count in Counter(names).items() if count > 1}
    stated.extend(f"{names.count(name)} columns are named {name}: they are {name} (1) and on" for name in repeated)
    made = []
    for name in names:
        if name in repeated:
            repeated[name] += 1
            name = f"{name} ({repeated[name]})"
        made.append(name)
    return tuple(made)


def is_number(cell: str, decimal: str) -> bool:
    if decimal == ",":
        return "." not in cell and bool(NUMBER.fullmatch(cell.replace(",", ".", 1)))
    return bool(NUMBER.fullmatch(cell))
