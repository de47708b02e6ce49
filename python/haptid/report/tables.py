"""Values as tables that a person reads in a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from haptid.device.toml.summary import summary_lines
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.symbolic import Regroupings
from haptid.errors import RegroupingError
from haptid.estimation import Parameter
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.targets import targets
from haptid.study.identify import Identification, Run
from haptid.validation.validation import Validation


def show_identification(console: Console, found: Identification) -> None:
    """Parameters, errors, notes."""
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
        "Rows in grey: the deviation is over half the value. Groupings: result.json, or `haptid model`.",
        style="dim",
    )
    console.print(error_table(found.runs, found.model.device.torque_rows))
    searched = found.projection.notes if found.projection else ()
    for note in (*found.proposal.reasons, *found.estimate.notes, *searched):
        console.print(f"- {note}")
    console.print(f"\n{verdict(found)}")


def searched_table(projection: VariableProjection) -> Table:
    """Constants that the torque is not linear in."""
    table = Table(title="Searched constants", title_justify="left", box=None, pad_edge=False)
    for heading in ("", "value", "95 % interval", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right", no_wrap=True)
    for c in projection.constants:
        ends = " .. ".join(f"{end:.3g}" for end in c.interval)
        table.add_row(c.name, f"{c.value:.4g}", ends, c.unit, style=None if c.bounded else "dim")
    return table


def parameter_table(title: str, parameters: Sequence[Parameter]) -> Table:
    """Parameters with their honest intervals; the textbook deviation beside them."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("", "value", "95 % interval", "sd %", "textbook %", "prior", "unit"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right", no_wrap=True)
    for p in parameters:
        table.add_row(*parameter_cells(p), style="dim" if p.relative_se > 50 else None)
    return table


def parameter_cells(p: Parameter) -> list[str]:
    """One row of the table, as many digits as the deviation allows; no deviation of a value that is strained."""
    low, high = (with_digits(end, p.se) for end in p.interval)
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
    """Two digits of a percentage, as far as anyone cares."""
    percent = 100 * part / abs(whole) if whole else float("inf")
    return f"{percent:#.2g}".rstrip(".") if percent < 99.5 else ("> 100" if percent < 1000 else "> 1000")


def with_digits(value: float, se: float) -> str:
    """A figure to two digits of its deviation."""
    if not (se > 0 and abs(value) < 1e6 and se > 1e-9):
        return f"{value:.6g}"
    decimals = 1
    while decimals < 12 and 10.0**-decimals * 10 > se:
        decimals += 1
    return f"{value:.{decimals}f}"


def error_table(runs: tuple[Run, ...], row: str) -> Table:
    """Relative error by log and motor."""
    motors = [m.name for m in runs[0].observation.motors]
    table = Table(title="\nRelative error of the torque, %", title_justify="left", box=None, pad_edge=False)
    table.add_column("log")
    table.add_column("rows")
    table.add_column("all", justify="right")
    for motor in motors if len(motors) > 1 else ():
        table.add_column(f"{row} {motor}", justify="right")
    for run in runs:
        for validation in (run.direct, *run.unseen):
            if validation is not None:
                table.add_row(run.entry.path, *error_cells(validation, len(motors)))
    return table


def error_cells(validation: Validation, motors: int) -> list[str | Text]:
    """Which rows, all motors, each motor."""
    kind = Text("of the fit") if validation.seen else Text("unseen", style="bold")
    each = [f"{m.relative:.2f}" for m in validation.motors] if motors > 1 else []
    return [kind, f"{validation.relative:.2f}", *each]


def verdict(found: Identification) -> str:
    """One sentence: what the model is good for, judged on unseen rows."""
    if not found.unseen:
        return "No unseen rows: this fit is not validated. Give the study a log with role 'validate', or a [holdout]."
    worst = max(v.relative for v in found.unseen)
    text = f"On rows that its fit had not seen the model misses {worst:.2f} % of the torque at worst."
    if found.meets_criteria is None:
        return text
    limit = found.study.largest_error
    return f"{text} The study allows {limit:g} %: {'met' if found.meets_criteria else 'not met'}."


def show_model(console: Console, model: DynamicModel) -> None:
    """Tree, loops, motors, terms, base parameters and regroupings."""
    for line in summary_lines(model.device):
        console.print(line, highlight=False, markup=False)
    base, exact = model.base, exact_regroupings(model)
    table = Table(
        title=f"\n{len(base)} base parameters of {len(base.standard)}",
        title_justify="left",
        box=None,
        pad_edge=False,
    )
    table.add_column("parameter")
    table.add_column("unit")
    table.add_column("regroups", overflow="fold")
    found = base.groupings if isinstance(exact, str) else exact.formulas
    for name, unit, grouping in zip(base.names, base.units, found, strict=True):
        table.add_row(name, unit, grouping)
    console.print(table)
    if isinstance(exact, str):
        console.print(f"\nGroupings hold at these lengths only: {exact}", highlight=False, soft_wrap=True)
    elif exact.symbols:
        console.print(f"\nWith {', '.join(f'{s.name} = {s.value:.6g}' for s in exact.symbols)}", highlight=False)
    if base.no_effect:
        console.print(f"\nWithout effect: {' '.join(base.no_effect)}")
    console.print(
        f"\nRank: least independent column kept {base.gap[0]:.1e}, most independent dropped {base.gap[1]:.1e} "
        f"(relative, limit {base.tolerance:.0e})" + ("" if base.is_clear else "  - NOT CLEAR: check the geometry"),
        highlight=False,
    )


def exact_regroupings(model: DynamicModel) -> Regroupings | str:
    """Regroupings with the lengths as symbols, or the sentence that says why there are none."""
    try:
        return model.regroupings
    except RegroupingError as error:
        return str(error)


def model_values(model: DynamicModel) -> dict[str, Any]:
    """What `haptid model --json` prints."""
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
    }
