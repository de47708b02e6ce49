"""Sentences on validation logs whose error is no measure of the model, or far above that of the fit's unseen blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from haptid.inference.diagnosis.finding import joined_names
from haptid.motion.motion import Motion
from haptid.motion.noise_torques import said_of_unseen_noise
from haptid.study.identify import Identification, Run
from haptid.uncertainty.figures import per_cent

# Ratio of the error of another log to that of unseen blocks of the fit from which the other log is named, and the error
# from which on it is, per cent.
_FAR, _LARGE = 2.0, 10.0
# Share of a motor's error that a factor leaves where it is the cause, of its torque over the error of the fit, and at
# least; factors that are none.
_EXPLAINED, _LEFT, _LEAST_LEFT, _SAME_SIZE = 0.4, 3.0, 0.02, 1.25
_UNKNOWN = (
    "the motion of the fit does not determine the model for other motion, or something differs in that log. Identify "
    "from several of the logs, and validate with another one, to tell."
)


def of_validation_logs(found: Identification, before: float | None) -> Iterator[str]:
    """Sentences on the validation logs of a study.

    Args:
        found: carried out.
        before: unseen error of blocks of the fit, per cent; None where it is no measure of theirs.
    """
    errors = list[tuple[float, Run]]()
    for run in found.runs:
        if run.entry.role != "validate":
            continue
        noise = _noise(found, run)
        yield from dict.fromkeys(noise.values())
        for validation in run.unseen:
            kept = tuple(one for k, one in enumerate(validation.comparable.motors) if k not in noise)
            errors.append((replace(validation.comparable, motors=kept).relative if kept else 0.0, run))
    if before is None or not errors:
        return
    worst, run = max(errors, key=lambda one: one[0])
    if worst > max(_FAR * before, _LARGE):
        errors_of = f"{per_cent(worst, 3)}, on unseen blocks of the fit {per_cent(before, 3)}"
        yield f"The error on {run.entry.path} is {errors_of}: {_other_sizes(found, run, before) or _UNKNOWN}"


def _other_sizes(found: Identification, run: Run, before: float) -> str:
    """The rest of the sentence where torques in a log are another multiple of the model's; empty where none is.

    A gain leaves the error of the fit. A body that was added makes torques larger too, and leaves more.

    Args:
        before: unseen error of blocks of the fit, per cent.
    """
    beta, told, most = found.estimate.beta, [], max(_LEFT * before / 100, _LEAST_LEFT)
    for motor in run.observation.motors:
        model, torque = motor.whole[:, :-1] @ beta[motor.columns], motor.whole[:, -1]
        power = float(model @ model)
        if motor.free or not power or not motor.norm:
            continue
        factor = float(model @ torque) / power
        left, plain = (float(np.linalg.norm(torque - size * model)) for size in (factor, 1.0))
        explained = left < min(_EXPLAINED * plain, most * motor.norm)
        if explained and not 1 / _SAME_SIZE < factor < _SAME_SIZE:
            rest = per_cent(100 * left / motor.norm, 2)
            told.append(f"that of {motor.label} is {factor:.3g} times the model's, all but {rest} of it")
    if not told:
        return ""
    return (
        f"of its torques {joined_names(told)}. Another unit, sign or gain than in the logs of the fit? It may have "
        "[logs.channels] of its own."
    )


def _noise(found: Identification, run: Run) -> dict[int, str]:
    """Sentences on motors, by number, whose torque shows noise alone in a validation log, but not in those of the fit.

    Nothing else would name them: the fit has their rows, and an error of noise is that of no model.
    """
    known = {k for motion in found.estimate.observation.motions for k in _said(found, motion)}
    return {k: said for k, said in _said(found, run.motion).items() if k not in known}


def _said(found: Identification, motion: Motion) -> dict[int, str]:
    """Sentences on motors, by number, whose torque shows noise alone in a log; none where there is no log."""
    if motion.log is None:
        return {}
    said = said_of_unseen_noise(found.model.device, motion.log)
    return {m: said[row] for m, row in enumerate(found.model.known_rows) if row in said}
