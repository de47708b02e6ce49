"""Uncertainty of a proposed treatment in an estimate: delays, errors of the positions, the position filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.estimation.estimate import judged
from haptid.treatment_choice.delay_estimate import Delays, with_delay_uncertainty
from haptid.treatment_choice.noise_effect import NOISY, of_torque, without_bias
from haptid.treatment_choice.repeated_errors import repeated_errors
from haptid.treatment_choice.rounding import Rounding

_REPEATED, _ROUNDING = "errors that repeat with the motion", "rounding of the encoders"
# Nuisances that positions are the cause of.
OF_POSITIONS = (_REPEATED, _ROUNDING, "encoder noise", "position filter")


def with_treatment_uncertainty(
    estimate: Estimate, delays: Delays | None, effects: Mapping[str, Array], rounding: Rounding | None = None
) -> Estimate:
    """An estimate whose covariance includes what its treatment leaves uncertain, each part in `nuisances`.

    Of devices with springs it is less the bias by noise and position filter.

    Args:
        estimate: from logs that were treated as proposed.
        delays: of the torque channels, as proposed; None where they were given.
        effects: of noise and position filter, as in `Proposal`.
        rounding: the effect of rounding, as in `Proposal`.
    """
    return with_uncertain_delays(estimate, delays, effects, rounding)[0]


def with_uncertain_delays(
    estimate: Estimate, delays: Delays | None, effects: Mapping[str, Array], rounding: Rounding | None
) -> tuple[Estimate, Delays | None]:
    """The same, and the delays with what errors of the positions move them by."""
    made = estimate if delays is None else with_delay_uncertainty(estimate, delays)
    joint = _repeating(estimate, delays, rounding)
    p = len(estimate.beta)
    for name, shift in joint.items():
        made = made.with_nuisance(name, shift[:, :p])
    made, effects = without_bias(made, effects)
    for name, shift in effects.items():
        made = made.with_nuisance(name, shift)
        changed = of_torque(estimate.observation, shift[0])
        if changed > NOISY:
            text = (
                f"The {name} changes the predicted torque by {changed:.2g} % (limit {NOISY:g} %): the positions "
                f"are too noisy for this motion. Record faster or larger motion, or with a finer encoder."
            )
            made = replace(made, status="noisy_positions", notes=(*made.notes, text))
    moved = [shift[:, p:] for shift in joint.values() if shift.shape[1] > p]
    if delays is not None and moved:
        delays = replace(delays, by_positions=np.concatenate(moved))
    return judged(made), delays


def _repeating(estimate: Estimate, delays: Delays | None, rounding: Rounding | None) -> Mapping[str, Array]:
    """Shifts of parameters and delays by errors that repeat, as far as each shows what the others do not."""
    made = {}
    repeated = repeated_errors(estimate, delays)
    if repeated is not None:
        made[_REPEATED] = repeated
    if rounding is not None and rounding.shifts.shape[1] >= len(estimate.beta):
        same = repeated is not None and repeated.shape[1] == rounding.shifts.shape[1]
        shifts = rounding.beyond(np.sum(repeated**2, axis=0) if repeated is not None and same else 0.0)
        if shifts.any():
            made[_ROUNDING] = shifts
    return made
