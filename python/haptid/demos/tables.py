"""Published tables: figures by row and column, some of them missing."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array

# Columns that are no figures.
WORDS = ("name", "motor", "meaning", "unit")


@dataclass(frozen=True)
class Table:
    """Figures by row and column.

    Attributes:
        rows, columns: names.
        figures: by (row, column); a missing one is absent.
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]
    figures: Mapping[tuple[str, str], float]

    def column(self, name: str) -> Array:
        """The figures of one column, NaN where one is missing, (rows,)."""
        return np.array([self.figures.get((row, name), np.nan) for row in self.rows])


def read_table(path: Path) -> Table:
    """A table from CSV: the first column has the rows' names."""
    with path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    heads = list(lines[0])
    columns = tuple(head for head in heads if head not in WORDS)
    rows = tuple(line[heads[0]] for line in lines)
    cells = {(line[heads[0]], column): line[column] for line in lines for column in columns}
    return Table(rows, columns, {place: float(text) for place, text in cells.items() if text})


def layout(rows: Mapping[str, Mapping[str, float]], columns: Mapping[str, str], decimals: int) -> list[list[str]]:
    """Cells with a heading: rows by name, and columns by their key with a title; missing figures are blank."""
    cells = [["", *columns.values()]]
    for name, figures in rows.items():
        found = [figures.get(key, np.nan) for key in columns]
        cells.append([name, *("" if np.isnan(x) else f"{x:.{decimals}f}" for x in found)])
    return cells


def markdown(cells: list[list[str]]) -> list[str]:
    """A table of cells, the first row its heading; columns of figures to the right."""
    head, *rows = cells
    rule = ["---", *("---:" if all(map(figure, column)) else "---" for column in list(zip(*rows, strict=True))[1:])]
    return [f"| {' | '.join(row)} |" for row in (head, rule, *rows)]


def figure(cell: str) -> bool:
    """Whether a cell begins with a figure, or is blank."""
    return not cell or cell.lstrip("-")[:1].isdigit()
