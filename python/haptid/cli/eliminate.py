"""`haptid eliminate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haptid.cli.common import (
    AsJson,
    DataFolder,
    Quiet,
    StudyFile,
    command,
    errors_shown,
    out,
    print_json,
    print_lines,
    progress_bars,
    progress_callback,
)

if TYPE_CHECKING:
    from haptid.inference.elimination import Elimination
    from haptid.study.identify import Identification

HELP = """\
Identify a device, then eliminate base parameters backwards, one at a time, stopped by a robust F-test.

The candidate of each step is the parameter with the largest relative standard error. The elimination stops where the
F-test rejects it, or where the largest relative standard error is at most 10 times the smallest, or
--max-relative-std per cent. If the study has a log with the role "validate", both models are compared on it. Writes
into OUT:

- `elimination.json`: every step, the essential parameters with intervals, their changes, errors of both models
- `result.json`: the reduced model of all motors, as of haptid identify, for haptid export and others
- `parameters.csv`, `correlation.csv`: its tables

Exit status: 0 on success, 2 on an error; the message says what to do.

Example: `haptid eliminate examples/phantom/study.toml --data logs --max-relative-std 20`
"""


@command(HELP)
def eliminate(
    study: StudyFile,
    data: DataFolder = None,
    max_relative_std: Annotated[
        float | None, typer.Option(min=0.0, help="largest relative standard error that remains, per cent")
    ] = None,
    level: Annotated[float, typer.Option(min=0.0, max=1.0, help="significance level of the F-test")] = 0.05,
    by_motor: Annotated[bool, typer.Option("--by-motor", help="also on the rows of each motor alone")] = False,
    out_folder: Annotated[Path, typer.Option("--out", help="folder for the results")] = Path("haptid-elimination"),
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    from haptid._internal.atomic_folder import check_writable, publishing
    from haptid.advice.eliminate import with_reduced
    from haptid.cli.outputs import output_text
    from haptid.inference.diagnosis import diagnose
    from haptid.inference.elimination import BackwardElimination, GautierRatio, MaxRelativeStd, eliminate_by_motor
    from haptid.inference.elimination import eliminate as eliminated
    from haptid.results.result import Result
    from haptid.study import read_study
    from haptid.study.identify import identify

    with errors_shown():
        check_writable(out_folder)
        plan = read_study(study)
        criterion = GautierRatio() if max_relative_std is None else MaxRelativeStd(max_relative_std)
        procedure = BackwardElimination(criterion, level)
        with progress_bars(quiet or as_json) as bars, publishing(out_folder) as folder:
            progress = progress_callback(bars)
            identification = identify(plan, data, progress)
            progress("eliminating", 0.0)
            unseen = _unseen(identification)
            reductions = {"all motors": eliminated(identification.estimate, procedure, unseen)}
            if by_motor:
                labels = [motor.label for motor in identification.estimate.observation.motors]
                reductions |= dict(
                    zip(labels, eliminate_by_motor(identification.estimate, procedure, unseen), strict=True)
                )
            progress("eliminating", 1.0)
            progress("diagnosing", 0.0)
            smaller = with_reduced(identification, reductions["all motors"].reduced)
            worst = max(smaller.unseen, key=lambda validation: validation.relative, default=None)
            Result.of(smaller, diagnose(smaller.estimate, worst, plan.controller).verdict).write_into(folder)
            progress("diagnosing", 1.0)
            values = {name: elimination_values(elimination) for name, elimination in reductions.items()}
            (folder / "elimination.json").write_text(output_text("eliminate", values), encoding="utf-8")
    if as_json:
        print_json("eliminate", values)
    elif not quiet:
        for name, elimination in reductions.items():
            out.print(name, style="bold")
            print_lines(elimination.summary())
        out.print(f"Steps in {out_folder / 'elimination.json'}; the reduced model in {out_folder / 'result.json'}")


def _unseen(identification: Identification) -> Any:
    """The rows of all logs with the role "validate", None without any."""
    from haptid.observation import concatenated

    rows = [run.observation for run in identification.runs if run.entry.role == "validate"]
    return concatenated(rows) if rows else None


def elimination_values(elimination: Elimination) -> dict[str, Any]:
    """An elimination as JSON values."""
    errors = {"fit": elimination.seen, "unseen": elimination.unseen}
    free = list(elimination.reduced.free_parameters)
    parameters = [elimination.reduced.parameters[k] for k in free]
    return {
        "parameters": len(elimination.full.free_parameters),
        "reason": elimination.reason,
        "eliminated": [
            {
                "name": d.name,
                "relative_se_percent": d.relative_se,
                "F": d.test.F,
                "p": d.test.p,
                "error_percent": d.error,
            }
            for d in elimination.steps
        ],
        "refused": None
        if elimination.rejected is None
        else {"name": elimination.rejected.name, "p": elimination.rejected.test.p},
        "essential": [
            {
                "name": p.name,
                "unit": p.unit,
                "value": p.value,
                "se": p.se,
                "dof": dof,
                "conf_int": list(p.conf_int()),
                "change_in_se": change,
            }
            for p, dof, change in zip(
                parameters, elimination.reduced.dof[free].tolist(), elimination.shift[free].tolist(), strict=True
            )
        ],
        "error_percent": {
            kind: {"full": validations[0].relative, "reduced": validations[1].relative}
            for kind, validations in errors.items()
            if validations
        },
    }
