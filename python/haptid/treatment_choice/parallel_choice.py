"""Choice of the parallel filter by its errors on unseen blocks, behind one reference filter with all rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.log import Log
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.first_fit import least_squares

# Parts of each log, every other one of which is held out.
LOG_PARTS = 17
# Blocks in a part: rows belong to the part that holds the middle of their block.
_BLOCKS = 4
# Standard deviations of the difference of losses by which another filter must be better than the usual one.
SURELY = 1.0
# Share of the loss that a gain must be: noise of the judged rows is in every loss, and may favour one side.
WORTH = 0.02
# Better on fewer parts than this share is chance.
_MOSTLY = 0.5


def better_cutoff(
    model: DynamicModel,
    logs: Sequence[Log],
    tried: Sequence[Treatment],
    usual: int,
    reference: Treatment,
    worth: float = WORTH,
    surely: float = SURELY,
) -> int:
    """Index of the treatment that predicts unseen parts best; the usual one where no other is better beyond chance.

    Args:
        logs: recordings.
        tried: the treatments.
        usual: index of the one that stands in doubt.
        reference: the treatment of the rows that are predicted.
        worth: share of the loss that a gain must be.
        surely: standard deviations that it must be.
    """
    block = min(len(log.t) * float(log.dt) for log in logs) / LOG_PARTS / _BLOCKS
    try:
        judged = observe(model, *(treat(log, replace(reference, block_s=block)) for log in logs))
    except (NoRowsError, MotionTooShortError):
        return usual
    parts = [_losses(model, logs, replace(treatment, block_s=block), judged) for treatment in tried]
    if parts[usual] is None:  # as with a filter longer than what the log has between its ends
        return next((k for k, loss in enumerate(parts) if loss is not None), usual)
    losses = [np.inf if loss is None else float(loss.sum()) for loss in parts]
    best = int(np.argmin(losses))
    before, after = parts[usual], parts[best]
    if best == usual or before is None or after is None:
        return usual
    gain = before - after
    sure = gain.sum() > surely * np.sqrt(len(gain)) * gain.std(ddof=1) and np.mean(gain > 0) > _MOSTLY
    # In a log that moves one joint after another, parts without its motion dominate the sum and say nothing.
    sure = sure and np.median(gain[before > 0] / before[before > 0]) > worth
    return best if sure else usual


def _losses(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, judged: Observation) -> Array | None:
    """Sum of squares, each motor's in units of its torque, of every part by a fit to the parts of the other parity."""
    try:
        seen = observe(model, *(treat(log, treatment) for log in logs))
    except (NoRowsError, MotionTooShortError):
        return None
    own, other = parts_of(seen, logs), parts_of(judged, logs)
    losses = np.zeros(LOG_PARTS * len(logs))
    for parity in (0, 1):
        chosen = np.flatnonzero(own % 2 == parity)
        if not len(chosen):
            return None
        try:
            beta = least_squares(seen.pick(chosen))
        except (NoRowsError, IdentifiabilityError):
            return None
        unseen = other % 2 != parity
        for motor in (own for own in judged.motors if not own.free):
            T = motor.r_factors[unseen]
            e = T[:, :, -1] - T[:, :, :-1] @ beta[motor.columns]
            np.add.at(losses, other[unseen], (e**2).sum(axis=1) / max(motor.norm**2, np.finfo(float).tiny))
    return losses


def parts_of(observation: Observation, logs: Sequence[Log]) -> np.ndarray:
    """The part of each block, numbered through all logs; an odd number of parts continues their parity."""
    found = np.empty(len(observation.blocks), dtype=int)
    names = [motion.name for motion in observation.motions]
    for k, block in enumerate(observation.blocks):
        which = names.index(block.log)
        t = logs[which].t
        share = (0.5 * (block.start + block.stop) - t[0]) / (t[-1] - t[0])
        found[k] = which * LOG_PARTS + min(int(share * LOG_PARTS), LOG_PARTS - 1)
    return found
