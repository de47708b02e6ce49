"""Tables I and II of the paper next to ours, as cells, text and CSV, and all numbers as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from haptid.demos.accuracy import accuracy
from haptid.demos.phantom_configurations.fits import Fit, Fits
from haptid.demos.phantom_configurations.results import Evaluation, Results
from haptid.demos.plan import write_csv, write_text
from haptid.observation.observation import observe
from haptid.report import HandForceData, make_report
from haptid.study import LogEntry, Study
from haptid.study.identify import Identification, Run
from haptid.treatment_choice.propose import Proposal
from haptid.uncertainty.quantities import aligned
from haptid.validation.model_for_use import model_for_use
from haptid.validation.validation import fit_errors

_Columns = Mapping[str, Mapping[str, float]]
_Cells = list[list[str]]


def titles(found: Results, late: bool = False) -> dict[str, str]:
    """Titles of the fits in the tables, by key."""
    first = next(iter(found.fits.values()))
    keys = ["frictionless", "exact", "encoders", "held", *(key for key in first.by if late and key.startswith("late"))]
    return {key: first[key].title.capitalize() for key in keys}


def published(found: Results) -> _Columns:
    """Published parameters by column and target."""
    table = found.demo.parameters
    return {name: dict(zip(table.rows, table.column(name), strict=True)) for name in table.columns}


def ours(found: Results, key: str, si: bool = False) -> _Columns:
    """Parameters of one sort of fit by mounting and target, after those that follow from measured bodies."""
    made = {name: fits[key].targets if si else fits[key].command for name, fits in found.fits.items()}
    prior = {p.name: p.prior[0] for p in next(iter(made.values())).parameters if p.prior is not None}
    columns = {name: dict(zip(one.names, one.value.tolist(), strict=True)) for name, one in made.items()}
    return {found.demo.parameters.columns[0]: prior, **columns}


def truth(found: Results) -> _Columns:
    """True parameters in units of command, by mounting and target."""
    made = {name: (fits["encoders"].command, fits.encoders.beta) for name, fits in found.fits.items()}
    return {name: dict(zip(c.names, (c.C @ beta).tolist(), strict=True)) for name, (c, beta) in made.items()}


def table1(found: Results, columns: _Columns, decimals: int = 4) -> _Cells:
    """Cells in the layout of Table I."""
    bodies = found.demo.parameters.columns[0]
    heads = {bodies: found.demo.bodies, **{key: found.demo.mountings[key] for key in found.fits}}
    rows = {row: row for row in found.demo.parameters.rows}
    return layout(rows, {key: title for key, title in heads.items() if key in columns}, columns, decimals)


def table2(found: Results) -> dict[str, dict[str, dict[str, float]]]:
    """Torque errors by title, mounting and motor, per cent."""
    table, motors = found.demo.errors, found.demo.errors.rows

    def by_motor(values: Any) -> dict[str, float]:
        return dict(zip(motors, values, strict=True))

    made = {"Published": {key: by_motor(table.column(key).tolist()) for key in found.fits}}
    for key, title in titles(found, late=True).items():
        fits = {name: some[key] for name, some in found.fits.items()}
        made[f"{title}, rows clear of reversals"] = {name: by_motor(fit.relative) for name, fit in fits.items()}
        made[f"{title}, all rows"] = {name: by_motor(fit.relative_everywhere) for name, fit in fits.items()}
    return made


def cells2(found: Results, columns: _Columns) -> _Cells:
    """Cells in the layout of Table II."""
    rows = {motor: f"motor {motor}" for motor in found.demo.errors.rows}
    return layout(rows, {key: found.demo.mountings[key] for key in found.fits}, columns, 2)


def error_comparison(found: Results) -> _Cells:
    """Each published error next to those on all rows, the reversals too, and which is smaller."""
    made = table2(found)
    by_key = titles(found)
    ours = {key: made[f"{by_key[key]}, all rows"] for key in ("exact", "encoders")}
    cells = [["mounting", "motor", "published", "exact velocity, all rows", "", "encoders, all rows", ""]]
    for name in found.fits:
        for motor in found.demo.errors.rows:
            theirs = made["Published"][name][motor]
            pairs = [(ours[key][name][motor], ours[key][name][motor] < theirs) for key in ours]
            figures = [text for error, less in pairs for text in (f"{error:.2f}", "better" if less else "worse")]
            cells.append([found.demo.mountings[name], f"motor {motor}", f"{theirs:.2f}", *figures])
    return cells


def layout(rows: Mapping[str, str], heads: Mapping[str, str], columns: _Columns, decimals: int) -> _Cells:
    """Cells with headings; rows and columns by key with a title; missing numbers are blank."""
    cells = [["", *heads.values()]]
    for row, title in rows.items():
        values = [columns[key].get(row, np.nan) for key in heads]
        cells.append([title, *("" if np.isnan(x) else f"{x:.{decimals}f}" for x in values)])
    return cells


def summary(found: Results) -> str:
    """Published torque errors and ours, as text."""
    lines = []
    for title, columns in table2(found).items():
        if not title.endswith("all rows"):
            heading = f"Torque errors on the unseen half, per cent: {title.lower()}"
            lines += [heading, *aligned(cells2(found, columns)), ""]
    return "\n".join(lines)


def write_files(found: Results, folder: Path) -> None:
    """Both tables as text and CSV, and the identification report of the mounting in which a hand pushes."""
    command = [("Published", published(found))]
    command += [(title, ours(found, key)) for key, title in titles(found).items()]
    command.append(("True on the bench", truth(found)))
    blocks = [(f"{title}, units of command", table1(found, columns)) for title, columns in command]
    blocks.append(("Encoders, proposed treatment, SI", table1(found, ours(found, "encoders", True), 6)))
    write_text(folder / "table1.txt", blocks)
    write_csv(folder / "table1.csv", _parameters(found))
    errors = table2(found)
    write_text(folder / "table2.txt", [(f"{title}, per cent", cells2(found, made)) for title, made in errors.items()])
    rows = [
        [title, key, motor, error]
        for title, columns in errors.items()
        for key, motors in columns.items()
        for motor, error in motors.items()
    ]
    write_csv(folder / "table2.csv", [["table", "mounting", "motor", "percent"], *rows])
    key, name = found.demo.hand.mounting, f"{found.demo.hand.experiment}.parquet"
    fits, title = found.fits[key], f"{found.demo.title}: {found.demo.mountings[key]}"
    made = identification(title, f"{key}.parquet", fits["encoders"], fits.proposal)
    hand = HandForceData(name, found.hand.t, found.hand.modelled, measured=found.hand.measured)
    make_report(made, command=f"haptid demo {found.demo.name}", hands=[hand]).write_into(folder)


def identification(title: str, log: str, fit: Fit, proposal: Proposal) -> Identification:
    """A fit of one half of a log, validated on the other, as the identification of a study.

    Args:
        title: of the report.
        log: name of the log.
        fit: of its first half.
        proposal: treatment of both halves, with its reasons.
    """
    made, model = fit.estimate, fit.estimate.model
    first = LogEntry(f"{log}, first half", "identify", None, None)
    second = LogEntry(f"{log}, second half", "validate", None, None)
    study = Study(title, Path(), model.device.name, (first, second), {}, made.method, None, None)
    runs = (
        Run(first, made.observation, fit_errors=fit_errors(made)),
        Run(second, observe(model, fit.unseen), unseen=(fit.validation,)),
    )
    return Identification(study, model, proposal, made, model_for_use(made, wanted="free"), runs)


def _parameters(found: Results) -> list[list[Any]]:
    """One line for each mounting, fit and parameter."""
    lines: list[list[Any]] = [
        ["mounting", "fit", "parameter", "unit", "value", "se", "ci_low", "ci_high", "true", "published", "command"]
    ]
    for key, fits in found.fits.items():
        exact = fits["exact"].targets
        true = dict(zip(exact.names, exact.C @ fits.exact.beta, strict=True))
        for name, fit in fits.by.items():
            for p, command in zip(fit.targets.parameters, fit.command.value.tolist(), strict=True):
                known = found.demo.parameters.figures.get((p.name, key), "")
                lines.append([key, name, p.name, p.unit, p.value, p.se, *p.conf_int(), true[p.name], known, command])
    return lines


def values(found: Results) -> dict[str, Any]:
    """All numbers, as JSON."""
    added = found.tool.parameters
    tool = zip(added.names, added.values.tolist(), added.conf_int().tolist(), strict=True)
    return {
        "mountings": {key: _mounting(found, fits) for key, fits in found.fits.items()},
        "table2": table2(found),
        "published": {name: _evaluation(found, made) for name, made in found.published.items()},
        "comparisons": [
            {
                "first": pair.first,
                "second": pair.second,
                "differ": made.differs,
                "flipped": made.flipped,
                "p": dict(zip(made.names, made.holm.tolist(), strict=True)),
            }
            for pair, made in found.comparisons
        ],
        "hand": {"rms_errors": found.hand.errors, "inside_conf_int": found.hand.inside},
        "tool": {
            name: {"value": value, "conf_int": interval, "true": found.tool_truth.get(name)}
            for name, value, interval in tool
        },
    }


def _mounting(found: Results, fits: Fits) -> dict[str, Any]:
    """Of one mounting: treatment, fits, definiteness and physical consistency."""
    made: dict[str, Any] = {"reasons": fits.proposal.reasons, "fits": {}}
    for key, fit in fits.by.items():
        made["fits"][key] = {
            "title": fit.title,
            "status": fit.estimate.status,
            "condition": fit.estimate.observation.condition,
            "relative_error_percent": fit.relative,
            "relative_error_percent_all_rows": fit.relative_everywhere,
            "parameters": [
                {"name": p.name, "unit": p.unit, "value": p.value, "se": p.se, "conf_int": p.conf_int()}
                for p in fit.targets.parameters
            ],
        }
        if key != "frictionless":
            near = accuracy(fit.targets, fits.encoders, found.demo.stretch.unseen)
            made["fits"][key]["against_truth"] = {
                "errors_percent": dict(zip(near.names, near.errors.tolist(), strict=True)),
                "inside_conf_int": dict(zip(near.names, near.inside.tolist(), strict=True)),
                "torque_percent": near.torque.tolist(),
            }
    made["judged"] = {
        fit: _evaluation(found, one) for (name, fit), one in found.evaluated.items() if name == fits.mounting
    }
    return made


def _evaluation(found: Results, made: Evaluation) -> dict[str, Any]:
    places = zip(found.demo.workspaces, made.definite, strict=True)
    return {
        "definite": {p.name: {"least": d.smallest, "share_failing": d.share, "at": d.at.tolist()} for p, d in places},
        "possible": made.feasible.ok,
        "margin": made.feasible.margin,
        "failing": made.feasible.failing,
    }
