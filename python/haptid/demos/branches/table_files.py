"""The published tables of the branches with our columns, as text and CSV."""

from __future__ import annotations

import csv
from pathlib import Path

from haptid.demos.branches.columns import friction, parameters, posture, sweeps
from haptid.demos.branches.finding import Results
from haptid.uncertainty.quantities import aligned


def write_tables(found: Results, folder: Path) -> None:
    """One table of parameters for each branch; friction test, sweeps and posture beside them."""
    tables = {Path(one.branch.table).stem: parameters(one) for one in found.found.values()}
    tables |= {"friction": friction(found), "sweeps": sweeps(found), "posture": posture(found)}
    for name, cells in tables.items():
        (folder / f"{name}.txt").write_text("\n".join(aligned(cells)) + "\n", encoding="utf-8")
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(cells)
