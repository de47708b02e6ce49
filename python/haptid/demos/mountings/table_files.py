"""Tables of a device in several mountings, as text and CSV."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from haptid.demos.mountings.columns import cells2, ours, published_columns, table1, table2, titles, truth
from haptid.demos.mountings.finding import Results
from haptid.uncertainty.quantities import aligned


def write_tables(found: Results, folder: Path) -> None:
    """table1 and table2."""
    write_table1(found, folder)
    write_table2(found, folder)


def write_table1(found: Results, folder: Path) -> None:
    """Parameters in the layout of the paper's Table I, and every one with its interval as CSV."""
    blocks = [("Published, units of command", published_columns(found))]
    blocks += [(f"{title}, units of command", ours(found, key)) for key, title in titles(found).items()]
    blocks.append(("True on the bench, units of command", truth(found)))
    text = []
    for title, columns in blocks:
        text += [title, "", *aligned(table1(found, columns)), ""]
    text += ["Encoders, proposed treatment, SI", "", *aligned(table1(found, ours(found, "encoders", True), 6)), ""]
    (folder / "table1.txt").write_text("\n".join(text), encoding="utf-8")
    heads = ["mounting", "fit", "parameter", "unit", "value", "sd", "low", "high", "true", "published", "command"]
    with (folder / "table1.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(heads)
        rows.writerows(_long(found))


def _long(found: Results) -> list[list[Any]]:
    """One line for each mounting, fit and parameter."""
    lines = []
    for key, fits in found.fits.items():
        for name, fit in fits.by.items():
            true = dict(zip(fits["exact"].targets.names, fits["exact"].targets.C @ fits.exact.beta, strict=True))
            command = dict(zip(fit.command.names, fit.command.value.tolist(), strict=True))
            for p in fit.targets.parameters:
                known = found.demo.parameters.figures.get((p.name, key), "")
                lines.append(
                    [key, name, p.name, p.unit, p.value, p.se, *p.interval, true[p.name], known, command[p.name]]
                )
    return lines


def write_table2(found: Results, folder: Path) -> None:
    """Torque errors in the layout of the paper's Table II."""
    text, lines = [], []
    for title, columns in table2(found).items():
        text += [f"{title}, per cent", "", *aligned(cells2(found, columns)), ""]
        for key, figures in columns.items():
            lines += [[title, key, motor, figure] for motor, figure in figures.items()]
    (folder / "table2.txt").write_text("\n".join(text), encoding="utf-8")
    with (folder / "table2.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["table", "mounting", "motor", "percent"])
        rows.writerows(lines)
