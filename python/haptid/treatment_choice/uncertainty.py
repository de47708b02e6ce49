"""Uncertainty of a proposed treatment in an estimate: delays, the encoders' noise, the position filter."""

from __future__ import annotations

from dataclasses import replace

from haptid.estimation import Estimate
from haptid.treatment_choice.delay_estimate import with_delay_uncertainty
from haptid.treatment_choice.noise_effect import NOISY, of_torque
from haptid.treatment_choice.propose import Proposal
from haptid.treatment_choice.repeated_errors import repeated_errors


def with_treatment_uncertainty(estimate: Estimate, proposal: Proposal) -> Estimate:
    """An estimate whose covariance includes what its treatment leaves uncertain, each part in `nuisances`.

    Args:
        estimate: from logs that were treated as proposed.
        proposal: the treatment.
    """
    made = estimate if proposal.delays is None else with_delay_uncertainty(estimate, proposal.delays)
    repeated = repeated_errors(estimate, proposal.delays)
    if repeated is not None:
        made = made.with_nuisance("errors that repeat with the motion", repeated)
    for name, shift in proposal.effects.items():
        if shift.shape[1] == len(estimate.beta):
            made = made.with_nuisance(name, shift)
            changed = of_torque(estimate.observation, shift[0])
            if changed > NOISY:
                text = (
                    f"The {name} changes the predicted torque by {changed:.2g} % (limit {NOISY:g} %): the positions "
                    f"are too noisy for this motion. Record faster or larger motion, or with a finer encoder."
                )
                made = replace(made, status="noisy_positions", notes=(*made.notes, text))
    return made
