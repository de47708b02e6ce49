"""Tables of a device's model for a terminal; `haptid model` loads nothing else of this room."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from haptid.device.toml.summary import summary_lines
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.near_special import NEAR_ANGLE
from haptid.dynamics.symbolic import Regroupings
from haptid.errors import RegroupingError

# Least width of a column whose cells may be broken, characters.
_NARROW = 7
Row = Sequence[str | Text]


class _FullTable(Table):
    """A table that breaks the cells of a terminal too narrow for it, in place of losing columns."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        widths = [max(cell_len(str(cell)) for cell in (c.header, *c.cells)) for c in self.columns]
        least = sum(w if c.no_wrap else min(w, _NARROW) for w, c in zip(widths, self.columns, strict=True))
        if least + 2 * len(widths) > options.max_width:
            for column in self.columns:
                column.no_wrap = False
        return super().__rich_console__(console, options)


def table(title: str, headings: Sequence[str], rows: Iterable[tuple[Row, bool]], left: Sequence[str] = ()) -> Table:
    """A table without lines.

    Args:
        title: above it.
        headings: of the columns.
        rows: cells of each row, and whether the row is printed in grey.
        left: headings of the columns that are flush left, after the first one; the others are flush right.
    """
    table = _FullTable(title=title or None, title_justify="left", box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        flush = k == 0 or heading in left
        table.add_column(heading, justify="left" if flush else "right", overflow="fold", no_wrap=not flush)
    for cells, grey in rows:
        table.add_row(*cells, style="dim" if grey else None)
    return table


def show_model(console: Console, model: DynamicModel) -> None:
    """Print tree, loops, motors, terms, base parameters and regroupings of a device."""
    for line in summary_lines(model.device):
        console.print(line, highlight=False, markup=False)
    base, exact = model.base, exact_regroupings(model)
    groupings = base.groupings if isinstance(exact, str) else exact.formulas
    rows = [(cells, False) for cells in zip(base.names, base.units, groupings, strict=True)]
    headings = ("parameter", "unit", "regroups")
    console.print(table(f"\n{len(base)} base parameters of {len(base.standard)}", headings, rows, left=headings))
    if isinstance(exact, str):
        console.print(f"\nRegroupings are valid for these lengths only: {exact}", highlight=False, soft_wrap=True)
    elif exact.symbols:
        console.print(f"\nWith {', '.join(f'{s.name} = {s.value:.6g}' for s in exact.symbols)}", highlight=False)
    if base.no_effect:
        console.print(f"\nWithout effect on the torque: {' '.join(base.no_effect)}")
    console.print(
        f"\nRank: least independent column kept {base.gap[0]:.1e}, most independent dropped {base.gap[1]:.1e} "
        f"(relative, limit {base.tolerance:.0e})" + ("" if base.is_clear else "  - NOT CLEAR: check the geometry"),
        highlight=False,
    )
    if model.only_by_rounding:
        console.print(
            f"\nOnly through the description's rounding: {' '.join(model.only_by_rounding)}. Axes there are within "
            f"{NEAR_ANGLE:g} rad of parallel or of a right angle; with exact angles these parameters have no effect of "
            "their own, and no motion determines them. Write such angles as pi/2, or import with --snap.",
            highlight=False,
            soft_wrap=True,
        )


def exact_regroupings(model: DynamicModel) -> Regroupings | str:
    """Symbolic regroupings, or the reason why there are none."""
    try:
        return model.regroupings
    except RegroupingError as error:
        return str(error)


def model_values(model: DynamicModel) -> dict[str, Any]:
    """Values that `haptid model --json` prints."""
    base, exact = model.base, exact_regroupings(model)
    rows = [
        {"name": name, "unit": unit, "grouping": dict(zip(base.standard, row.tolist(), strict=True))}
        for name, unit, row in zip(base.names, base.units, base.regrouping, strict=True)
    ]
    if not isinstance(exact, str):
        for row, formula, latex, exactly in zip(rows, exact.formulas, exact.latex, exact.texts, strict=True):
            row |= {"formula": formula, "latex": latex, "exact": dict(exactly)}
    return {
        "device": model.device.name,
        "relations": list(model.device.closure.relations),
        "closure_error": model.device.closure.error,
        "base_parameters": rows,
        "symbols": {} if isinstance(exact, str) else {symbol.name: symbol.value for symbol in exact.symbols},
        "notes": [exact] if isinstance(exact, str) else [],
        "no_effect": list(base.no_effect),
        "tolerance": base.tolerance,
        "gap": list(base.gap),
        "only_by_rounding": list(model.only_by_rounding),
    }
