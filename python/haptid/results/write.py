"""The result file: `result.json`, a contract that other programs read, and the same table as CSV."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from haptid._core import __version__
from haptid.dynamics.model import DynamicModel
from haptid.estimation import BoundedSolution, Constrained, Estimate, Method, Parameter, PhysicallyConsistent, Reduced
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.targets import targets
from haptid.motion.causal import Causal
from haptid.motion.treatment import Treatment
from haptid.observation.known_payload import Payload
from haptid.study.identify import Identification, Run
from haptid.validation.validation import Validation

if TYPE_CHECKING:
    from haptid.inference.diagnosis import Verdict

SCHEMA = 1
HELD_INTERVAL = "of the free fit; cut at 0 where a parameter cannot be negative, widened to the value where it is held"
WITHIN_INTERVAL = "of the free fit; cut at the limits, widened to the value where it is held"


def result(identification: Identification, verdict: Verdict | None = None) -> dict[str, Any]:
    """The result as plain values. Relative errors are of the treated torque, referred to the joint side.

    Args:
        identification: a study walked to its end.
        verdict: of its diagnosis, where there was one.
    """
    study, estimate = identification.study, identification.estimate
    raw, scaled = estimate.observation.condition
    kept = essential(estimate)
    return {
        "schema": SCHEMA,
        "haptid": __version__,
        "device": identification.model.device.name,
        "study": study.name,
        "logs": [log(run) for run in identification.runs],
        "treatment": treatment(identification.proposal.treatment),
        "treatment_reasons": list(identification.proposal.reasons),
        "observation": {
            "rows": estimate.observation.rows,
            "parameters": len(estimate.model.device.parameters.names),
            "rank": len(estimate.base),
            "condition": {"raw": raw, "scaled": scaled},
            "no_effect": list(estimate.base.no_effect),
            "blocks": len(estimate.observation.blocks),
        },
        "estimate": {
            "method": weighting(estimate.method).name,
            "possible": isinstance(estimate.held, Constrained),
            "status": estimate.status,
            "interval": interval(estimate),
            "parameters": [parameter(p) | {"essential": e} for p, e in zip(estimate.parameters, kept, strict=True)],
            "targets": [parameter(p) for p in targets(estimate).parameters] if estimate.model.device.targets else [],
            "searched": searched(identification.projection),
            "loads": None if identification.model.load is None else identification.model.load.tolist(),
            "held": held(estimate.held),
            "freedom": estimate.dof.tolist(),
            "covariance": estimate.covariance.tolist(),
        },
        "validation": [entry for run in identification.runs for entry in validations(run)],
        "criteria": {
            "relative_error_percent": study.largest_error,
            "met": identification.meets_criteria,
        },
        "verdict": uses(verdict),
        "notes": [*notes(estimate), *(identification.projection.notes if identification.projection else ())],
        "device_file": device_file(identification.model),
    }


def uses(verdict: Verdict | None) -> list[dict[str, Any]]:
    """What the model is good for, use by use; nothing without a diagnosis."""
    if verdict is None:
        return []
    grades = {"predicting": verdict.torque, "compensation": verdict.compensation, "quoting": verdict.parameters}
    # The verdict's first sentences are these; what is to be done comes after them.
    said = zip(grades.items(), verdict.sentences, strict=False)
    return [{"use": use, "grade": grade, "sentence": sentence} for (use, grade), sentence in said]


def essential(estimate: Estimate) -> list[bool | None]:
    """Of each parameter, whether it was kept; None where none was to be left out."""
    if not isinstance(estimate.method, Reduced):
        return [None] * len(estimate.base)
    return [k not in estimate.zero for k in range(len(estimate.base))]


def searched(projection: VariableProjection | None) -> list[dict[str, Any]]:
    """Constants that the torque is not linear in, as found."""
    return [
        {
            "name": constant.name,
            "value": constant.value,
            "sd": constant.se,
            "interval95": list(constant.interval),
            "range": [constant.low, constant.high],
            "unit": constant.unit,
        }
        for constant in (projection.constants if projection else ())
    ]


def interval(estimate: Estimate) -> str:
    """How the intervals were made."""
    if estimate.held is None:
        return estimate.intervals.name
    return f"{estimate.intervals.name}, {HELD_INTERVAL if isinstance(estimate.held, Constrained) else WITHIN_INTERVAL}"


def device_file(model: DynamicModel) -> dict[str, Any]:
    """What the device file says, by which the device can be made again; gravity as it is mounted."""
    said: dict[str, Any] = model.device.tables.model_dump(mode="json", by_alias=True, exclude_unset=True)
    return {**said, "gravity": model.device.gravity.tolist()}


def weighting(method: Method) -> Method:
    """The method by its name in a study, whether or not its estimate is held to what is possible."""
    return method.weighting if isinstance(method, PhysicallyConsistent) else method


def treatment(treated: Treatment) -> dict[str, Any]:
    """The settings by their names in a study, the filter's shape by its name."""
    shape, settings = treated.parallel_shape, dataclasses.asdict(treated)
    settings["cutoff_hz"] = "none" if treated.cutoff_hz is None else treated.cutoff_hz
    settings["parallel_shape"] = shape.name
    settings["parallel_order"] = shape.order if isinstance(shape, Causal) else None
    differentiator = settings.pop("velocity")
    settings["velocity_cutoff_hz"] = differentiator and differentiator["cutoff_hz"]
    return settings


def log(run: Run) -> dict[str, Any]:
    """One log: what was read, from where, and what for."""
    read = run.motion.log
    assert read is not None  # a study's motions all come from logs
    return {
        "path": run.entry.path,
        "sha256": read.sha256,
        "role": run.entry.role,
        "start": float(read.t[0]),
        "samples": len(read.t),
        "dt": run.motion.dt,
        "notes": list(read.notes),
        "load": None if run.entry.load is None else load(run.entry.load),
    }


def load(taken_off: Payload) -> dict[str, Any]:
    """A known load as a study has it; the tensor about the centre of mass, 3 x 3, null of a point mass."""
    body = taken_off.body
    inertia = None if body.inertia is None else body.inertia.tolist()
    return {"link": taken_off.link, "mass": body.mass, "com": body.com.tolist(), "inertia": inertia}


def held(found: Constrained | BoundedSolution | None) -> dict[str, Any] | None:
    """What an estimate was held to, where it would not have been possible: bodies, and what that cost."""
    if found is None:
        return None
    if isinstance(found, BoundedSolution):
        return {"active": list(found.active)}
    inside, names = found.possible, found.possible.model.device.parameters.names
    return {
        "margin": inside.margin,
        "active": list(found.active),
        "cost_percent": [{"motor": cost.label, "free": cost.free, "held": cost.held} for cost in found.costs],
        "standard": dict(zip(names, inside.chi.tolist(), strict=True)),
    }


def parameter(p: Parameter) -> dict[str, Any]:
    """One base parameter. `essential` is null: see `essential` for those of an estimate.

    Of a value held outside of the free fit's interval there is no relative deviation: `sd` belongs to `free`.
    """
    return {
        "name": p.name,
        "value": p.value,
        "free": p.free,
        "sd": p.se,
        "interval95": list(p.interval),
        "relative_sd_percent": p.relative_se,
        "classical_se": p.classical_se,
        "unit": p.unit,
        "grouping": p.grouping,
        "essential": None,
        "prior": None if p.prior is None else {"value": p.prior[0], "sd": p.prior[1]},
    }


def validations(run: Run) -> list[dict[str, Any]]:
    """Errors by motor and over all of them: on the rows of the fit, and on unseen ones."""
    found = [v for v in (run.direct, *run.unseen) if v is not None]
    return [entry for v in found for entry in errors(run.entry.path, v)]


def errors(path: str, validation: Validation) -> list[dict[str, Any]]:
    """One validation, motor by motor, then all motors (whose RMSE and norms would mix units, and are null)."""
    kind = "fit" if validation.seen else "unseen"
    rows: list[dict[str, Any]] = [
        {
            "log": path,
            "rows": kind,
            "motor": m.motor,
            "relative_error_percent": m.relative,
            "rmse": m.rmse,
            "unit": m.unit,
            "residual": m.residual,
            "measured": m.measured,
            "count": m.rows,
        }
        for m in validation.motors
    ]
    whole = {"log": path, "rows": kind, "motor": "all", "relative_error_percent": validation.relative}
    mixed = dict.fromkeys(("rmse", "unit", "residual", "measured", "count"))
    return [*rows, {**whole, **mixed}]


def notes(estimate: Estimate) -> list[str]:
    """Sentences that go with the figures."""
    return [
        *estimate.notes,
        "relative_error_percent is 100 norm(y - y_hat) / norm(y) of the treated torque, referred to the joint side.",
    ]


def write_result(identification: Identification, folder: Path, verdict: Verdict | None = None) -> None:
    """Write `result.json`, `parameters.csv` and `correlation.csv` into a folder.

    Args:
        identification: a study walked to its end.
        folder: where; it is there already.
        verdict: of its diagnosis, where there was one; exports of the folder then say it.
    """
    text = json.dumps(finite(result(identification, verdict)), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "result.json").write_text(text + "\n", encoding="utf-8")
    head = ["name", "value", "sd", "low95", "high95", "relative_sd_percent", "classical_se", "unit", "grouping", "free"]
    _write_table(folder / "parameters.csv", [head, *map(_row, identification.estimate.parameters)])
    names, correlation = identification.estimate.base.names, identification.estimate.correlation
    rows = [[name, *("" if math.isnan(r) else r for r in row)] for name, row in zip(names, correlation, strict=True)]
    _write_table(folder / "correlation.csv", [["name", *names], *rows])


def _row(p: Parameter) -> list[object]:
    relative = "" if p.constrained_outside_ci else p.relative_se
    return [p.name, p.value, p.se, *p.interval, relative, p.classical_se, p.unit, p.grouping, p.free]


def _write_table(path: Path, rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def finite(value: Any) -> Any:
    """The same values with null for what JSON cannot say: infinities and not-a-numbers."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
