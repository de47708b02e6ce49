"""Uncertainty of a proposed treatment in an estimate: delays, the encoders' noise, the position filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.treatment_choice.delay_estimate import with_delay_uncertainty
from haptid.treatment_choice.propose import Proposal
from haptid.treatment_choice.repeated_errors import repeated_errors

# Share of the torque, per cent, by which the encoders' noise may change the predicted one.
_NOISY = 3.0


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
            changed = _of_torque(estimate, shift[0])
            if changed > _NOISY:
                text = (
                    f"The {name} changes the predicted torque by {changed:.2g} % (limit {_NOISY:g} %): the positions "
                    f"are too noisy for this motion. Record faster or larger motion, or with a finer encoder."
                )
                made = replace(made, status="noisy_positions", notes=(*made.notes, text))
    return made


def _of_torque(estimate: Estimate, shift: Array) -> float:
    """Torque of a change of the parameters, in per cent of the measured torque."""
    own = [np.linalg.norm(m.whole[:, :-1] @ shift[m.columns]) for m in estimate.observation.motors]
    measured = float(np.linalg.norm([m.norm for m in estimate.observation.motors]))
    return 100 * float(np.linalg.norm(own)) / measured if measured else 0.0
