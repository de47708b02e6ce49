"""Tables for a terminal: parameters, nonlinear constants, torque errors, and the model of a device."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from haptid.device.toml.summary import summary_lines
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.near_special import NEAR_ANGLE
from haptid.dynamics.symbolic import Regroupings
from haptid.errors import RegroupingError
from haptid.estimation import Parameter
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.targets import targets
from haptid.report.source import criterion
from haptid.study.identify import Identification, Run
from haptid.validation.validation import Validation

Row = Sequence[str | Text]


def table(title: str, headings: Sequence[str], rows: Iterable[tuple[Row, bool]], left: Sequence[str] = ()) -> Table:
    """A table without lines.

    Args:
        title: above it.
        headings: of the columns.
        rows: cells of each row, and whether the row is printed in grey.
        left: headings of the columns that are flush left, after the first one; the others are flush right.
    """
    made = Table(title=title or None, title_justify="left", box=None, pad_edge=False)
    for k, heading in enumerate(headings):
        flush = k == 0 or heading in left
        made.add_column(heading, justify="left" if flush else "right", overflow="fold", no_wrap=not flush)
    for cells, grey in rows:
        made.add_row(*cells, style="dim" if grey else None)
    return made


def show_identification(console: Console, found: Identification) -> None:
    """Print parameters, errors and notes of an identification."""
    observation = found.estimate.observation
    raw, scaled = observation.condition
    console.print(f"\n{found.study.name}: {found.model.device.name}", style="bold")
    console.print(
        f"{observation.rows} rows, {len(observation.base)} base parameters of "
        f"{len(found.model.device.parameters.names)}, condition {raw:.4g} raw, {scaled:.4g} with unit columns, "
        f"{found.estimate.method.name}\n",
        highlight=False,
    )
    console.print(parameter_table("Base parameters", found.estimate.parameters))
    if found.model.device.targets:
        console.print(parameter_table("Targets", targets(found.estimate).parameters))
    if found.projection:
        console.print(searched_table(found.projection))
    console.print(
        "Grey rows: the standard error exceeds half the value. Regroupings: result.json, or `haptid model`.",
        style="dim",
    )
    console.print(error_table(found.runs, found.model.device.torque_rows))
    searched = found.projection.notes if found.projection else ()
    for note in (*found.proposal.reasons, *found.estimate.notes, *searched, found.use.reason):
        console.print(f"- {note}")
    console.print(f"\n{criterion(found)}")


def searched_table(projection: VariableProjection) -> Table:
    """Nonlinear constants with their 95 % intervals; grey where the log does not bound them."""
    rows = [
        ([c.name, f"{c.value:.4g}", " .. ".join(f"{end:.3g}" for end in c.conf_int()), c.unit], not c.bounded)
        for c in projection.constants
    ]
    return table("Nonlinear constants", ("", "value", "95 % interval", "unit"), rows, left=("unit",))


def parameter_table(title: str, parameters: Sequence[Parameter]) -> Table:
    """Parameters with their 95 % intervals, relative standard errors and classical ones."""
    headings = ("", "value", "95 % interval", "std err %", "classical %", "prior", "unit")
    return table(title, headings, [(parameter_cells(p), p.relative_se > 50) for p in parameters], left=("unit",))


def parameter_cells(p: Parameter) -> list[str]:
    """One row of the table, to two digits of the standard error; none for a value constrained outside its interval."""
    low, high = (with_digits(end, p.se) for end in p.conf_int())
    return [
        p.name,
        f"{p.value:.4g}" if p.constrained_outside_ci else with_digits(p.value, p.se),
        f"{low} .. {high}",
        "" if p.constrained_outside_ci else short_percent(p.se, p.value),
        "" if p.constrained_outside_ci else short_percent(p.classical_se, p.value),
        "" if p.prior is None else with_digits(p.prior[0], p.se),
        p.unit,
    ]


def short_percent(part: float, whole: float) -> str:
    """A percentage to two digits; above 100 only its order of magnitude."""
    percent = 100 * part / abs(whole) if whole else float("inf")
    return f"{percent:#.2g}".rstrip(".") if percent < 99.5 else ("> 100" if percent < 1000 else "> 1000")


def with_digits(value: float, se: float) -> str:
    """A value to two digits of its standard error."""
    if not (se > 0 and abs(value) < 1e6 and se > 1e-9):
        return f"{value:.6g}"
    decimals = 1
    while decimals < 12 and 10.0**-decimals * 10 > se:
        decimals += 1
    return f"{value:.{decimals}f}"


def error_table(runs: tuple[Run, ...], row: str) -> Table:
    """Relative error by log and motor."""
    motors = [m.name for m in runs[0].observation.motors]
    each = [f"{row} {motor}" for motor in motors] if len(motors) > 1 else []
    validations = [(run.entry.path, v) for run in runs for v in (run.fit_errors, *run.unseen) if v is not None]
    rows = [([path, *cells], False) for path, v in validations for cells in error_lines(v, len(motors))]
    return table("\nRelative error of the torque, %", ("log", "rows", "all", *each), rows, left=("rows",))


def error_lines(validation: Validation, motors: int) -> Iterator[list[str | Text]]:
    """Kind of the rows, error of all motors and of each; then the same on all rows behind the reference filter."""
    own = "of the fit" if validation.seen else "unseen"
    for kind, found in ((Text(own), validation), (Text("unseen, all rows", style="bold"), validation.reference)):
        if found is not None:
            each = [f"{m.relative:.2f}" for m in found.motors] if motors > 1 else []
            yield [kind, f"{found.relative:.2f}", *each]


def show_model(console: Console, model: DynamicModel) -> None:
    """Print tree, loops, motors, terms, base parameters and regroupings of a device."""
    for line in summary_lines(model.device):
        console.print(line, highlight=False, markup=False)
    base, exact = model.base, exact_regroupings(model)
    found = base.groupings if isinstance(exact, str) else exact.formulas
    rows = [(cells, False) for cells in zip(base.names, base.units, found, strict=True)]
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
