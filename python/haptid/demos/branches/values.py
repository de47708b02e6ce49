"""Every figure of the branches, as JSON holds it."""

from __future__ import annotations

from typing import Any

from haptid._internal.arrays import Array
from haptid.demos.branches.columns import at_posture
from haptid.demos.branches.finding import Results
from haptid.demos.branches.fits import Identified
from haptid.demos.report import head
from haptid.validation.validation import Validation


def values(found: Results) -> dict[str, Any]:
    """Every figure, as JSON holds it."""
    made = found.compensated
    return {
        **head(found.demo),
        "branches": {key: _branch(found, key) for key in found.found},
        "compensation": {
            "degrees": made.degrees.tolist(),
            "mass": made.estimated.tolist(),
            "mass_before": made.before.tolist(),
            "mass_after": made.after.tolist(),
            "mass_promised": made.promised.tolist(),
            "target": made.target,
            "mass_even": made.even.tolist(),
            "stable_share": made.bound,
            "lag": made.lag,
        },
    }


def _branch(found: Results, key: str) -> dict[str, Any]:
    one, handle = found.found[key], found.handles[key]
    return {
        "friction_test": {
            joint.label: {"model": joint.chosen.friction_model, "enough": joint.enough, "values": joint.chosen.values}
            for joint in found.friction[key].choice.joints
        },
        "reasons": one.proposal.reasons,
        "rows": {"all": one.every.rows, "used": one.full.observation.rows},
        "condition": {
            "all rows": one.every.condition,
            "all rows, published columns": one.condition_of_published,
            "rows of the fit": one.full.observation.condition,
        },
        "relative_error_percent": {"direct": _errors(one.direct), "cross": _errors(one.cross)},
        "parameters": {name: _parameter(one, name) for name in one.full.base.names},
        "essential": one.reduction.essential,
        "eliminate_by_motor": {made.full.observation.motors[0].name: made.essential for made in one.by_motor},
        "sweeps": {name: {"mass": _lists(felt.mass.values)} for name, felt in handle.sweeps.items()},
        "posture": {f"{what}, {unit}": text for (what, unit), text in at_posture(found, handle)},
    }


def _parameter(one: Identified, name: str) -> dict[str, Any]:
    full, reduced = one.full[name], one.reduced[name]
    made: dict[str, Any] = {
        "unit": full.unit,
        "true": one.true(name),
        "full": {"value": full.value, "sd": full.se, "interval95": full.interval},
    }
    if name in one.reduction.essential:
        made["essential"] = {"value": reduced.value, "sd": reduced.se, "interval95": reduced.interval}
    return made


def _errors(validation: Validation) -> dict[str, float]:
    return {"all": validation.relative, **{motor.label: motor.relative for motor in validation.motors}}


def _lists(masses: Array) -> list[list[float]]:
    return [[float(x) for x in row] for row in masses]
