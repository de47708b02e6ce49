"""Effect of the encoders' rounding on the parameters and delays: smoothed positions are rounded again, elsewhere.

Rounding depends on the position alone. Where a motion comes back to the same samples, its errors are the same in every
period, and what of them lies in the columns of the model is in the parameters and not in the residual: no scatter of
the residual shows it. Noise drawn at random does not show it either, since it averages out over the periods. Positions
that are rounded once more, on lattices that lie elsewhere between the steps of the encoder, have errors that repeat as
those of the log do; by how much they move the estimates is their error, as far as blocks do not show it. Where the
motion does not come back, the scatter of blocks shows all of it, and nothing is added.

Smoothed positions are not the true ones, but a function of positions on the encoder's own lattice: on lattices of the
same step their errors have phases that depend on what the smoothing took away, as the columns do, and add up where
those of the log do not. So each lattice has a step of its own, a little larger or smaller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.estimation import Estimate
from haptid.log import Log
from haptid.log.lattice import lattices
from haptid.log.spectrum import Spectrum, widest
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.treatment_choice.delay_estimate import Delays
from haptid.treatment_choice.first_fit import solve_excited
from haptid.treatment_choice.refit import Refit

# Random signs, and the standard deviations above their mean from which on the errors of blocks add up.
_SIGNS, _BEYOND = 100, 2.0
# Lattices after which it ends where the shifts of all estimates are below such a share of their standard errors.
_FIRST, _MATTERS = 2, 0.2
# Cut-off of the filter behind which positions stand for the true ones, over the motion's bandwidth, at most: with much
# of their own rounding left, they lie too near to the lattice, and what is found is too small.
_SMOOTH = 1.5


@dataclass(frozen=True, eq=False)
class Rounding:
    """Shifts of parameters and delays by rounding, with the part that the scatter of blocks shows.

    Attributes:
        shifts: of the base parameters and of the delays that were estimated with them, by the errors of each lattice,
            (lattices, p + delays), SI.
        shown: variance of each in the scatter of the blocks, (p + delays,), SI.
        se: standard errors of parameters and delays without it, (p + delays,), SI.
    """

    shifts: Array
    shown: Array
    se: Array

    def beyond(self, known: Array | float = 0.0) -> Array:
        """One standard error's shifts with the variance that is in no scatter, (lattices, p + delays), SI.

        The share of the variance is one for all: shares of their own would take the shifts apart, and with them the
        torque, in which shifts of correlated parameters cancel.

        Args:
            known: variance of the parameters and delays by errors that repeat, as the residual shows it, SI.
        """
        sure = self.se > 0
        whole, seen = (
            float(np.sum(np.broadcast_to(variance, self.se.shape)[sure] / self.se[sure] ** 2))
            for variance in (np.mean(self.shifts**2, axis=0), self.shown + known)
        )
        share = max(0.0, 1.0 - seen / whole) if whole > 0 else 0.0
        return np.asarray(self.shifts * np.sqrt(share / len(self.shifts)))


def rounding_effect(
    estimate: Estimate,
    logs: Sequence[Log],
    spectra: Sequence[Sequence[Spectrum]],
    treatment: Treatment,
    delays: Delays | None,
) -> Rounding | None:
    """What the rounding of the positions may have moved the estimates by; None where blocks show all that matters.

    Args:
        estimate: from the logs.
        logs: recordings.
        spectra: of each log's position channels, with their steps.
        treatment: of the logs.
        delays: of the torque channels; None where they were given.
    """
    steps = [np.array([own.step for own in channels]) for channels in spectra]
    if treatment.cutoff_hz is None or treatment.momentum or not any(step.any() for step in steps):
        return None
    highest = _SMOOTH * max(own.bandwidth for own in widest(spectra))
    cutoffs = np.minimum(np.broadcast_to(treatment.cutoff_hz, (len(steps[0]),)), highest)
    smoother = replace(treatment, torque_delay_s=0.0, cutoff_hz=tuple(cutoffs.tolist()))
    refit = Refit.of(estimate, delays)
    try:
        smooth = [np.asarray(treat(log, smoother).q[:]) for log in logs]
        plain = refit.motors(smooth)
        at = solve_excited(plain, refit.weights, refit.known).beta
        before, parts = refit.by_block(plain, at), list[Array]()
        for lattice in lattices(len(steps[0])):
            rounded = [lattice.rounded(q, own) for q, own in zip(smooth, steps, strict=True)]
            parts.append(refit.by_block(refit.motors(rounded), at) - before)
            if len(parts) == _FIRST and np.all(np.abs(np.sum(parts, axis=1)) < _MATTERS * refit.se):
                return None
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return None
    made = np.array(parts)
    if not _add_up(made / np.where(refit.se > 0, refit.se, np.inf)):
        return None
    return Rounding(made.sum(axis=1), np.mean(np.sum(made**2, axis=1), axis=0), refit.se)


def _add_up(parts: Array) -> bool:
    """Whether what lattices move the estimates by adds up over the blocks beyond chance: random signs of blocks.

    Args:
        parts: of each lattice and block, over standard errors, (lattices, blocks, p + delays).
    """
    own = parts - parts.mean(axis=0)  # what all lattices do alike is attenuation, which SIMEX shows
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(_SIGNS, *own.shape[:2]))
    chance = np.sum(np.einsum("slb,lbk->slk", signs, own) ** 2, axis=(1, 2))
    return bool(np.sum(own.sum(axis=1) ** 2) > np.mean(chance) + _BEYOND * np.std(chance))
