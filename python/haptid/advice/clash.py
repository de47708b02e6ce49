"""All torques reversed, where bodies that can exist explain the log only then.

The free fit of a reversed log is as good as that of the log itself, with parameters of the opposite sign. The
physically consistent fit tells them apart.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid.advice.action import CHANGES, Action
from haptid.advice.edits import Edit
from haptid.estimation import estimate
from haptid.observation import Observation, concatenated
from haptid.study.identify import Identification
from haptid.validation.model_for_use import CLASH, CONSISTENT, FREE, ModelForUse, model_for_use

_KIND = "torque sign"


def reversed_torques(found: Identification) -> Action | None:
    """The sign of all torques, with the consistent fit's held-out errors; None where that fit does not call for it.

    It does where its error is twice that of the free fit or more, and falls to half of it or less. The sign of a
    single motor follows from its own inertia and friction, which cannot be negative.
    """
    now, free = clash(found.use)
    if len(found.estimate.observation.motors) < 2 or not now:
        return None
    seen = [run.reference for run in found.runs if run.entry.role == "identify" and run.reference is not None]
    fitted = estimate(_reversed(found.estimate.observation), found.estimate.method, found.estimate.intervals)
    use = model_for_use(fitted, _reversed(concatenated(seen)) if seen else None)
    # Without candidates the free fit is consistent by itself, and its error is that of the log's.
    then = _error(use, CONSISTENT) if use.candidates else free
    if use.name not in (CONSISTENT, FREE) or then > now / CLASH:
        return None
    labels = tuple(motor.label for motor in found.estimate.observation.motors)
    channels = found.estimate.observation.motions[0].tau.shape[1]
    change = CHANGES[_KIND].format(where="every motor")
    edits = tuple(Edit("study", "multiply", ("channels", "torque", "gain"), -1.0, k) for k in range(channels))
    blocks = sum(len(one.blocks) for one in seen) or len(found.estimate.observation.blocks)
    return Action(_KIND, labels, change, "consistent fit", now, then, None, 1.0, True, edits, blocks)


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
