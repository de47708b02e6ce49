"""Columns of the tables: published, found and true figures by mounting."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from haptid.demos.mountings.finding import Results
from haptid.demos.mountings.fits import Fits
from haptid.demos.tables import layout
from haptid.uncertainty.quantities import aligned

# Fits that the tables show, in their order.
SHOWN = ("exact", "encoders", "held")


def titles(found: Results) -> dict[str, str]:
    """Titles of the fits that the tables show."""
    first = next(iter(found.fits.values()))
    return {key: first[key].title.capitalize() for key in ("frictionless", *SHOWN)}


def published_columns(found: Results) -> dict[str, dict[str, float]]:
    """Published figures by column and target."""
    table = found.demo.parameters
    return {name: dict(zip(table.rows, table.column(name), strict=True)) for name in table.columns}


def ours(found: Results, key: str, si: bool = False) -> dict[str, dict[str, float]]:
    """Figures of one sort of fit by mounting and target, and those that follow from measured bodies."""
    columns = {name: _values(fits, key, si) for name, fits in found.fits.items()}
    first = next(iter(found.fits.values()))[key]
    known = first.targets if si else first.command
    prior = {p.name: p.prior[0] for p in known.parameters if p.prior is not None}
    return {found.demo.parameters.columns[0]: prior, **columns}


def _values(fits: Fits, key: str, si: bool) -> dict[str, float]:
    made = fits[key].targets if si else fits[key].command
    return dict(zip(made.names, made.value.tolist(), strict=True))


def truth(found: Results) -> dict[str, dict[str, float]]:
    """True parameters in units of command, by mounting and target."""
    columns = {}
    for name, fits in found.fits.items():
        made = fits["encoders"].command
        columns[name] = dict(zip(made.names, (made.C @ fits.encoders.beta).tolist(), strict=True))
    return columns


def table1(found: Results, columns: Mapping[str, Mapping[str, float]], decimals: int = 4) -> list[list[str]]:
    """Cells in the paper's layout."""
    named = {key: found.demo.mounting(key).title for key in found.fits}
    heads = {found.demo.parameters.columns[0]: found.demo.bodies, **named}
    rows = {row: {key: columns.get(key, {}).get(row, np.nan) for key in heads} for row in found.demo.parameters.rows}
    return layout(rows, {key: title for key, title in heads.items() if key in columns}, decimals)


def table2(found: Results) -> dict[str, dict[str, dict[str, float]]]:
    """Torque errors by title, mounting and motor, per cent."""
    table, motors = found.demo.errors, found.demo.errors.rows
    made = {"Published": {key: dict(zip(motors, table.column(key).tolist(), strict=True)) for key in found.fits}}
    for key, title in {**titles(found), **late_titles(found)}.items():
        made[f"{title}, rows clear of reversals"] = {
            name: dict(zip(motors, fits[key].relative, strict=True)) for name, fits in found.fits.items()
        }
        made[f"{title}, all rows"] = {
            name: dict(zip(motors, fits[key].relative_everywhere, strict=True)) for name, fits in found.fits.items()
        }
    return made


def late_titles(found: Results) -> dict[str, str]:
    """Titles of the fits with a velocity that is late."""
    first = next(iter(found.fits.values()))
    return {key: fit.title.capitalize() for key, fit in first.by.items() if key.startswith("late")}


def cells2(found: Results, columns: Mapping[str, Mapping[str, float]]) -> list[list[str]]:
    """Cells in the paper's layout."""
    named = {key: found.demo.mounting(key).title for key in found.fits}
    rows = {f"motor {m}": {key: columns[key][m] for key in columns} for m in found.demo.errors.rows}
    return layout(rows, named, 2)


def summary(found: Results) -> str:
    """Published torque errors and ours, as text."""
    lines = []
    for title, columns in table2(found).items():
        if title.endswith("reversals") or title == "Published":
            lines += [
                f"Torque errors on the unseen half, per cent: {title.lower()}",
                *aligned(cells2(found, columns)),
                "",
            ]
    return "\n".join(lines)
