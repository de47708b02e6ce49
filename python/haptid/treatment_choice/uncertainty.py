"""Uncertainty of a proposed treatment in an estimate: delays, errors of the positions, the position filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation import Estimate
from haptid.estimation.estimate import judged
from haptid.estimation.intervals.cluster_robust import ClusterRobust
from haptid.treatment_choice.delay_estimate import Delays, delay_prior, delay_problem
from haptid.treatment_choice.first_fit import memory_of
from haptid.treatment_choice.noise_effect import NOISY, of_torque, without_bias
from haptid.treatment_choice.nuisance_problem import NuisanceProblem
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


def with_delay_uncertainty(estimate: Estimate, delays: Delays) -> Estimate:
    """An estimate whose covariance includes what the uncertainty of the delays adds.

    Args:
        estimate: from logs treated with these delays.
        delays: of the torque channels.
    """
    motions = estimate.observation.motions
    if not np.any(delays.covariance) or any(m.log is None or m.treatment.momentum for m in motions):
        return estimate
    problem = delay_problem(estimate.model, motions, estimate.free, delays.noise_hz)
    if delays.white or not _same_rows(problem, estimate, delays):
        return estimate.with_nuisance("torque delay", problem.propagated(estimate, delays.covariance))
    problem = replace(problem, known_memory=memory_of(estimate))
    moved, by_rows, by_prior = problem.moves(delay_prior(len(delays.seconds), delays.dt))
    # The mixture of priors draws the delays towards the hold, and what moves them with them.
    drawn = np.linalg.solve(by_rows + by_prior, delays.covariance)
    made = estimate.with_moved_nuisances(moved @ drawn @ problem.sensitivity(estimate).T)
    rest = delays.covariance - drawn.T @ by_rows @ drawn
    return made.with_nuisance("torque delay", problem.propagated(estimate, rest))


def _same_rows(problem: NuisanceProblem, estimate: Estimate, delays: Delays) -> bool:
    """Whether delays were estimated from the rows of an estimate: then errors of these move both, often oppositely."""
    samples = sum(len(m.log.t) for m in estimate.observation.motions if m.log is not None)
    plain = estimate.observation.change is None and isinstance(estimate.intervals, ClusterRobust)
    return delays.accepted and samples == delays.samples and plain and problem.rows.blocks == estimate.blocks
