"""Tables of a result file, made from an identification: parameters, targets, constants, constraints, errors."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.estimation import (
    BoundedSolution,
    Constrained,
    EqualityConstraints,
    Estimate,
    Method,
    PhysicallyConsistent,
    Reduced,
)
from haptid.estimation.intervals.model_based import Sandwich, burg, runs_of
from haptid.estimation.nonlinear import VariableProjection
from haptid.inference.diagnosis.residuals import residuals
from haptid.inference.diagnosis.subsample import subsample
from haptid.inference.targets import targets
from haptid.motion.filters import SHAPES, Causal, HighPass, KaiserSmoother
from haptid.motion.treatment import Treatment
from haptid.results.schema import (
    BetweenLogsTable,
    BoundConstraints,
    CalibrationQuantity,
    CandidateTable,
    EqualityConstraintsTable,
    ErrorTable,
    ModelForUseTable,
    NonlinearConstant,
    PhysicalConstraints,
    ResidualTable,
    ResultCost,
    ResultParameter,
    ResultUse,
    UseParameter,
)
from haptid.study.identify import Identification, Run
from haptid.treatment_choice.calibration import Calibration

if TYPE_CHECKING:
    from haptid.inference.diagnosis import Verdict

RELATIVE_ERROR = (
    "relative_error_percent is 100 norm(y - y_hat) / norm(y) of the treated torque, referred to the joint side."
)
PHYSICAL_INTERVAL = (
    "of the unconstrained fit; cut at 0 where a parameter cannot be negative, widened to the constrained value"
)
BOUNDS_INTERVAL = "of the unconstrained fit; cut at the bounds, widened to the constrained value"


def interval(estimate: Estimate) -> str:
    """How the confidence intervals were made."""
    if estimate.constrained_fit is None:
        return estimate.intervals.name
    limited = PHYSICAL_INTERVAL if isinstance(estimate.constrained_fit, Constrained) else BOUNDS_INTERVAL
    return f"{estimate.intervals.name}, {limited}"


def device_file(model: DynamicModel) -> dict[str, Any]:
    """The contents of the device file, from which the device can be made again; gravity as mounted."""
    tables: dict[str, Any] = model.device.tables.model_dump(mode="json", by_alias=True, exclude_unset=True)
    return {**tables, "gravity": model.device.gravity.tolist()}


def weighting(method: Method) -> Method:
    """The method whose name a study gives, without the physical constraints around it."""
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


def treatment_of(settings: Mapping[str, Any]) -> Treatment:
    """The treatment that has these settings, as `treatment` gives them and a result file has them."""
    shape, order, rate = (settings.get(key) for key in ("parallel_shape", "parallel_order", "velocity_cutoff_hz"))
    known = {field.name for field in dataclasses.fields(Treatment)}
    given = {key: value for key, value in settings.items() if key in known}
    given["cutoff_hz"] = None if settings.get("cutoff_hz") == "none" else settings.get("cutoff_hz")
    given["parallel_shape"] = Causal(order) if order else SHAPES.get(str(shape), KaiserSmoother())
    return Treatment(**given | {"velocity": None if rate is None else HighPass(rate)})


def residual_tables(estimate: Estimate) -> Iterator[ResidualTable]:
    """Autoregressive models of the residuals; variances are corrected for the degrees of freedom of the fit.

    Of a long log they are those of the diagnosis's subsample.
    """
    for motor, e in zip(estimate.observation.motors, residuals(subsample(estimate)).e, strict=True):
        runs = [e[run] for run in runs_of(np.isfinite(e))]
        rows = sum(map(len, runs))
        if rows:
            found, per_dof = burg(runs, Sandwich().most_order), rows / max(1, rows - len(motor.columns))
            yield ResidualTable(
                motor=motor.name,
                filter=found.filters[-1].tolist(),
                white_variance=per_dof * float(found.powers[-1]),
                variance=per_dof * float(found.powers[0]),
            )


def finite(value: Any) -> Any:
    """The same values with None (JSON null) for infinities and NaN, and lists for tuples."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def parameter_tables(estimate: Estimate) -> Iterator[ResultParameter]:
    """Base parameters; `eliminated` is None where nothing was to be eliminated."""
    between = BetweenLogsTable.each(estimate.between_logs, len(estimate.beta))
    for k, p in enumerate(estimate.parameters):
        yield ResultParameter.of(p, estimate.dof[k], between[k], k in estimate.zero if _reduced(estimate) else None)


def _reduced(estimate: Estimate) -> bool:
    return isinstance(estimate.method, Reduced)


def target_tables(estimate: Estimate) -> Iterator[ResultParameter]:
    if estimate.model.device.targets:
        found_targets = targets(estimate)
        yield from map(
            ResultParameter.of,
            found_targets.parameters,
            found_targets.dof,
            BetweenLogsTable.each(found_targets.between_logs, len(found_targets)),
        )


def use_table(identification: Identification) -> ModelForUseTable:
    """The model for use; its intervals hold the value, and those that are quoted."""
    use, quoted = identification.use, identification.estimate.conf_int()
    low, high = np.minimum(quoted[:, 0], use.beta), np.maximum(quoted[:, 1], use.beta)
    return ModelForUseTable(
        name=use.name,
        method_description=use.method.name,
        reason=use.reason,
        parameters=[
            UseParameter(name=name, value=value, conf_int=(a, b))
            for name, value, a, b in zip(
                use.estimate.names, use.beta.tolist(), low.tolist(), high.tolist(), strict=True
            )
        ],
        candidates=[
            CandidateTable(
                name=candidate.name,
                strength=candidate.strength,
                error_percent=candidate.error,
                excess=candidate.excess[0],
                excess_se=candidate.excess[1],
            )
            for candidate in use.candidates
        ],
    )


def constant_tables(projection: VariableProjection | None) -> Iterator[NonlinearConstant]:
    for constant in projection.constants if projection else ():
        yield NonlinearConstant(
            name=constant.name,
            unit=constant.unit,
            value=constant.value,
            se=constant.se,
            conf_int=constant.conf_int(),
            range=(constant.low, constant.high),
        )


def calibration_sentences(identification: Identification) -> tuple[str, ...]:
    calibration = identification.calibration
    return calibration.sentences(identification.model) if calibration else ()


def calibration_tables(calibration: Calibration | None) -> Iterator[CalibrationQuantity]:
    if calibration is not None:
        for entry, std in zip(calibration.quantities.to_json(), calibration.prior_std.tolist(), strict=True):
            yield CalibrationQuantity(**entry, prior_std=std)


def constraints_table(estimate: Estimate) -> PhysicalConstraints | BoundConstraints | EqualityConstraintsTable | None:
    constrained = estimate.constrained_fit
    if constrained is None:
        method = estimate.method
        return (
            EqualityConstraintsTable(values=dict(method.relations)) if isinstance(method, EqualityConstraints) else None
        )
    if isinstance(constrained, BoundedSolution):
        return BoundConstraints(active=list(constrained.active))
    inside, names = constrained.feasible, constrained.feasible.model.device.parameters.names
    return PhysicalConstraints(
        margin=inside.margin,
        active=list(constrained.active),
        cost_percent=[
            ResultCost(motor=cost.label, unconstrained=cost.free, constrained=cost.constrained)
            for cost in constrained.costs
        ],
        standard_parameters=dict(zip(names, inside.chi.tolist(), strict=True)),
    )


def grade_tables(verdict: Verdict | None) -> Iterator[ResultUse]:
    """What the model is good for, use by use; nothing without a diagnosis."""
    if verdict is not None:
        grades = {"predicting": verdict.torque, "compensation": verdict.compensation, "quoting": verdict.parameters}
        # The verdict's first sentences are these; recommendations follow.
        for (use, grade), sentence in zip(grades.items(), verdict.sentences, strict=False):
            yield ResultUse(use=use, grade=grade, sentence=sentence)


def error_tables(run: Run) -> Iterator[ErrorTable]:
    """Errors by motor, then of all motors (whose RMSE and norms would mix units, and are null)."""
    every = [(v, "fit" if v.seen else "unseen") for v in (run.fit_errors, *run.unseen) if v is not None]
    every += [(v.reference, "reference") for v in run.unseen if v.reference is not None]
    for validation, rows in every:
        common: dict[str, Any] = {"log": run.entry.path, "rows": rows}
        for m in validation.motors:
            yield ErrorTable(
                motor=m.motor,
                relative_error_percent=m.relative if m.rows else None,
                rmse=m.rmse if m.rows else None,
                unit=m.unit,
                residual=m.residual,
                measured=m.measured,
                count=m.rows,
                **common,
            )
        mixed: dict[str, Any] = dict.fromkeys(("rmse", "unit", "residual", "measured", "count"))
        yield ErrorTable(motor="all", relative_error_percent=validation.relative, **mixed, **common)
