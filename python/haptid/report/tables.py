"""Tables for a terminal: parameters, nonlinear constants, torque errors, and the model of a device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from haptid.device import Device
from haptid.estimation import BetweenLogs, Parameter
from haptid.estimation.nonlinear import VariableProjection
from haptid.report.model_tables import table
from haptid.report.source import criterion
from haptid.study.identify import Identification, Run
from haptid.treatment_choice.calibration import Calibration
from haptid.uncertainty.figures import with_digits
from haptid.validation.validation import Validation

# Relative standard errors of parameters shown in grey, per cent.
_GREY = 50.0
# Characters of all motors' labels above which the columns of a table have their numbers.
_WIDEST = 120
UNEXCITED = (
    "Not excited: the log does not tell the parameter from zero, and in a motion that takes joints through all poses "
    "one standard error of it is more torque than the log has; or only rounded angles put it into the model. Its "
    "figure in result.json means nothing by itself."
)


def show_identification(console: Console, identification: Identification) -> None:
    """Print parameters, errors and notes of an identification."""
    observation = identification.estimate.observation
    raw, scaled = observation.condition_without(identification.estimate.zero)
    console.print(f"\n{identification.study.name}: {identification.model.device.name}", style="bold")
    console.print(
        f"{observation.rows} rows, {len(observation.base)} base parameters of "
        f"{len(identification.model.device.parameters.names)}, condition {raw:.4g} raw, {scaled:.4g} with unit "
        f"columns, {identification.estimate.method.name}\n",
        highlight=False,
    )
    console.print(parameter_table("Base parameters", identification.estimate.parameters))
    if identification.model.device.targets:
        from haptid.inference.targets import targets  # slow to import, and few devices have some

        console.print(parameter_table("Targets", targets(identification.estimate).parameters))
    if identification.projection:
        console.print(searched_table(identification.projection))
    parameters = identification.estimate.parameters
    grey = any(p.relative_se > _GREY and p.excited for p in parameters)
    console.print(
        f"{'Grey rows: the standard error exceeds half the value. ' if grey else ''}"
        f"{'' if all(p.excited for p in parameters) else f'{UNEXCITED} '}"
        "Regroupings: result.json, or `haptid model`.",
        style="dim",
    )
    if identification.calibration:
        console.print(calibration_table(identification.calibration))
    between = identification.estimate.between_logs
    if between is not None:
        console.print(between_table(between))
    console.print(error_table(identification.runs, identification.model.device.torque_rows))
    if any(run.motors for run in identification.runs):
        console.print(motor_table(identification.runs))
        console.print(law_words(identification.model.device), style="dim")
    searched = identification.projection.notes if identification.projection else ()
    scatter = between.sentences if between else ()
    corrected = identification.calibration.sentences(identification.model) if identification.calibration else ()
    corrected += identification.gimbal.sentences if identification.gimbal else ()
    for note in (
        *identification.proposal.reasons,
        *identification.estimate.notes,
        *corrected,
        *scatter,
        *searched,
        identification.use.reason,
    ):
        console.print(f"- {note}")
    console.print(f"\n{criterion(identification)}")


MOTOR_HEADINGS = ("log", "motor", "measured, rms", "error, rms", "preload, mean", "preload, rms", "unit")


def motor_table(runs: Sequence[Run]) -> Table:
    """Torques of redundant motors: measured, error of the distribution law, and the measured preload."""
    return table(
        "Torque of each motor", MOTOR_HEADINGS, [(row, False) for row in motor_rows(runs)], left=("motor", "unit")
    )


def motor_rows(runs: Sequence[Run]) -> list[list[str]]:
    """Cells of the table of redundant motors' torques."""
    rows = []
    for run in runs:
        for m in run.motors:
            figures = (m.rms, m.error, m.preload, m.preload_rms)
            rows.append([run.entry.path, m.name, *(f"{x:.3g}" for x in figures), m.unit])
    return rows


def law_words(device: Device) -> str:
    """The distribution law as a sentence."""
    law = device.law
    criterion = (
        "least sum of squares" if (law.weights == 1).all() else "least sum of weighted squares, as in the device file"
    )
    preload = " and the preload of the device file" if law.preload.any() else ""
    return (
        f"Distribution law: {criterion}{preload}. Motion does not determine the preload, the part of the torques that "
        "moves nothing: it is measured, and not an error of the model."
    )


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
    rows = [(parameter_cells(p), p.relative_se > _GREY or not p.excited) for p in parameters]
    return table(title, headings, rows, left=("unit",))


def calibration_table(calibration: Calibration) -> Table:
    """Home offsets and rotations of gravity with 95 % intervals, and the standard deviation of their priors."""
    rows = [(cells, False) for cells in calibration_cells(calibration)]
    return table("\nCalibration", ("", "value", "95 % interval", "prior", "unit"), rows, left=("unit",))


def calibration_cells(calibration: Calibration) -> list[list[str]]:
    """Its rows."""
    q = calibration.quantities
    columns = (q.names, q.units, q.values, q.se, q.conf_int(), calibration.prior_std)
    return [
        [name, with_digits(value, se), " .. ".join(with_digits(end, se) for end in ends), f"+- {std:.2g}", unit]
        for name, unit, value, se, ends, std in zip(*columns, strict=True)
    ]


def between_table(between: BetweenLogs) -> Table:
    """Standard errors within and between logs, and intervals over days; grey where too few logs count."""
    headings = ("", "std err within", "over days", "log to log", "interval over days", "of a repeat", "unit")
    rows = [(between_cells(between, k), not np.isfinite(se)) for k, se in enumerate(between.across.se)]
    return table(f"\nBetween {between.logs} logs, 95 % intervals", headings, rows, left=("unit",))


def between_cells(between: BetweenLogs, k: int) -> list[str]:
    """One row of the table; empty cells where too few logs have information on the parameter."""
    name, unit, inside, se = (
        between.across.names[k],
        between.across.units[k],
        between.within.se[k],
        between.across.se[k],
    )
    if not np.isfinite(se):
        return [name, f"{inside:.2g}", "", "", "", "", unit]
    ends = [
        " .. ".join(with_digits(x, se) for x in made[k]) for made in (between.conf_int(), between.repeat_conf_int())
    ]
    return [name, f"{inside:.2g}", f"{se:.2g}", f"{between.deviation[k]:.2g}", *ends, unit]


def parameter_cells(p: Parameter) -> list[str]:
    """One row of the table."""
    return [p.name, *p.cells, p.unit]


def error_table(runs: tuple[Run, ...], row: str) -> Table:
    """Relative error by log and motor."""
    motors = runs[0].observation.motors
    labels = [m.label if m.free else f"{row} {m.name}" for m in motors] if len(motors) > 1 else []
    wide = sum(map(len, labels)) > _WIDEST
    headings = [str(k) for k in range(1, len(labels) + 1)] if wide else labels
    by_number = "".join(f"; {k} is {label}" for k, label in enumerate(labels, 1)) if wide else ""
    validations = [(run.entry.path, v) for run in runs for v in (run.fit_errors, *run.unseen) if v is not None]
    rows = [([path, *cells], False) for path, v in validations for cells in error_lines(v, len(motors))]
    return table(
        f"\nRelative error of the torque, %{by_number}", ("log", "rows", "all", *headings), rows, left=("rows",)
    )


def error_lines(validation: Validation, motors: int) -> Iterator[list[str | Text]]:
    """Kind of the rows, error of all motors and of each; then the same on all rows behind the reference filter."""
    own = "of the fit" if validation.seen else "unseen"
    for kind, errors in ((Text(own), validation), (Text("unseen, moving", style="bold"), validation.reference)):
        if errors is not None:
            cells = [f"{m.relative:.2f}" if m.rows else "-" for m in errors.motors] if motors > 1 else []
            yield [kind, f"{errors.relative:.2f}", *cells]
