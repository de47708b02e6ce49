"""Uncertainty of a proposed treatment in an estimate: delays, the encoders' noise, the position filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.estimation.estimate import judged
from haptid.treatment_choice.delay_estimate import Delays, with_delay_uncertainty
from haptid.treatment_choice.noise_effect import NOISY, of_torque
from haptid.treatment_choice.repeated_errors import repeated_errors

_REPEATED = "errors that repeat with the motion"
# Nuisances that positions are the cause of.
OF_POSITIONS = (_REPEATED, "encoder noise", "position filter")


def with_treatment_uncertainty(estimate: Estimate, delays: Delays | None, effects: Mapping[str, Array]) -> Estimate:
    """An estimate whose covariance includes what its treatment leaves uncertain, each part in `nuisances`.

    Args:
        estimate: from logs that were treated as proposed.
        delays: of the torque channels, as proposed; None where they were given.
        effects: of noise and position filter, as in `Proposal`.
    """
    made = estimate if delays is None else with_delay_uncertainty(estimate, delays)
    repeated = repeated_errors(estimate, delays)
    if repeated is not None:
        made = made.with_nuisance(_REPEATED, repeated)
    for name, shift in effects.items():
        if shift.shape[1] == len(estimate.beta):
            made = made.with_nuisance(name, shift)
            changed = of_torque(estimate.observation, shift[0])
            if changed > NOISY:
                text = (
                    f"The {name} changes the predicted torque by {changed:.2g} % (limit {NOISY:g} %): the positions "
                    f"are too noisy for this motion. Record faster or larger motion, or with a finer encoder."
                )
                made = replace(made, status="noisy_positions", notes=(*made.notes, text))
    return judged(made)
