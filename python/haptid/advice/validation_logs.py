"""Sentences on validation logs whose error is no measure of the model, or far above that of the fit's unseen blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from haptid.motion.motion import Motion
from haptid.motion.noise_torques import said_of_unseen_noise
from haptid.study.identify import Identification, Run
from haptid.uncertainty.figures import per_cent

# Ratio of the error of another log to that of unseen blocks of the fit from which the other log is named, and the error
# from which on it is, per cent.
_FAR, _LARGE = 2.0, 10.0


def of_validation_logs(found: Identification, before: float | None) -> Iterator[str]:
    """Sentences on the validation logs of a study.

    Args:
        found: carried out.
        before: unseen error of blocks of the fit, per cent; None where it is no measure of theirs.
    """
    errors = [(0.0, "")]
    for run in found.runs:
        if run.entry.role != "validate":
            continue
        noise = _noise(found, run)
        yield from dict.fromkeys(noise.values())
        for validation in run.unseen:
            kept = tuple(one for k, one in enumerate(validation.comparable.motors) if k not in noise)
            errors.append((replace(validation.comparable, motors=kept).relative if kept else 0.0, run.entry.path))
    worst, path = max(errors)
    if before is not None and worst > max(_FAR * before, _LARGE):
        yield (
            f"The error on {path} is {per_cent(worst, 3)}, on unseen blocks of the fit {per_cent(before, 3)}: the "
            "motion of the fit does not determine the model for other motion, or something differs in that "
            "log. Identify from several of the logs, and validate with another one, to tell."
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
