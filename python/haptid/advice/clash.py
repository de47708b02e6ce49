"""All torques reversed, or the base upside down, where bodies that can exist explain the log only then.

The free fit of a log with reversed torques, or gravity, is nearly as good as that of the log itself, with parameters of
the opposite sign. The physically consistent fit tells them apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from haptid.advice.action import CHANGES, Action
from haptid.advice.edits import Edit
from haptid.estimation import Estimate, estimate
from haptid.inference.diagnosis.subsample import log_name, row_ranges
from haptid.observation.observation import Observation, concatenated, rows_by_motor
from haptid.observation.plan import Plan
from haptid.study.identify import Identification
from haptid.validation.model_for_use import CLASH, CONSISTENT, FREE, ModelForUse, model_for_use


def whole_reversed(found: Identification, part: Estimate) -> Action | None:
    """The sign of all torques, or of gravity, with the consistent fit's held-out errors; None where neither is needed.

    It does where its error is twice that of the free fit or more, and falls to half of it or less. The sign of a
    single motor follows from its own inertia and friction, which cannot be negative.

    Args:
        found: a study carried out.
        part: its estimate on the rows that advice is tried on: of a long log, all errors are of these rows.
    """
    now, free = clash(found.use)
    own = part.observation
    if len(own.motors) < 2 or not now:
        return None
    seen = [run.reference for run in found.runs if run.entry.role == "identify" and run.reference is not None]
    if part is not found.estimate:
        seen, (now, free) = [], clash(model_for_use(estimate(own, part.method, part.intervals)))
        if not now:
            return None
    blocks = sum(len(one.blocks) for one in seen) or len(own.blocks)
    labels = tuple(motor.label for motor in own.motors)
    change = CHANGES["torque sign"].format(where="every motor")
    edits = [
        Edit("study", "multiply", ("channels", "torque", "gain"), -1.0, k) for k in range(own.motions[0].tau.shape[1])
    ]
    up = [0.0 - x for x in found.model.device.gravity]
    hung = f"set gravity to [{', '.join(f'{x:.4g}' for x in up)}] in the device file: the base is mounted so"
    ways: list[tuple[str, tuple[str, ...], str, list[Edit], Callable[[Observation], Observation]]] = [
        ("torque sign", labels, change, edits, _reversed),
        ("mounting", ("the base",), hung, [Edit("device", "set", ("gravity",), up)], _upside_down),
    ]
    made = []
    for kind, places, change, edits, changed in ways[: 1 + any(up)]:
        fitted = estimate(changed(own), part.method, part.intervals)
        use = model_for_use(fitted, [changed(one) for one in seen])
        # Without candidates the free fit is consistent by itself, and its error is that of the log's.
        then = _error(use, CONSISTENT) if use.candidates else free
        if use.name in (CONSISTENT, FREE) and then <= now / CLASH:
            made.append(
                Action(kind, places, change, "consistent fit", now, then, None, 1.0, True, tuple(edits), blocks)
            )
    return min(made, key=lambda action: action.after, default=None)


def clash(use: ModelForUse) -> tuple[float, float]:
    """Held-out errors of the consistent and of the free fit, per cent, where they clash; zeros where they do not."""
    consistent, free = _error(use, CONSISTENT), _error(use, FREE)
    return (consistent, free) if np.isfinite(consistent) and consistent >= CLASH * free else (0.0, 0.0)


def _error(use: ModelForUse, name: str) -> float:
    return next((one.error for one in use.candidates if one.name == name), np.inf)


def _reversed(rows: Observation) -> Observation:
    """The rows with all torques of the opposite sign."""
    motors = []
    for motor in rows.motors:
        factors = np.array(motor.r_factors)
        factors[:, :, -1] *= -1
        motors.append(replace(motor, r_factors=factors))
    return replace(rows, motors=tuple(motors))


def _upside_down(rows: Observation) -> Observation:
    """The same rows under gravity of the opposite direction."""
    model, made = rows.model.with_gravity([-x for x in rows.model.device.gravity]), []
    for motion in rows.motions:
        plan, own = Plan.of(model, motion), tuple(b for b in rows.blocks if b.log == log_name(motion))
        parts = [plan.reduce(start, stop) for start, stop in row_ranges(plan, own)]
        made.append(Observation(model, rows_by_motor(plan, parts, model.known_rows), own, (motion,)))
    return concatenated(made)
