"""What a bias of least squares is in an estimate with constraints or a prior, and the estimate less it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.estimation.estimate import Estimate, Restricted
from haptid.estimation.intervals.covariance import Limiting
from haptid.estimation.method import Knowing, Reduced
from haptid.observation.observation import stacked
from haptid.uncertainty.quantities import half_width


def carried(estimate: Estimate, shifts: Array) -> Array:
    """Shifts of least squares, (k, p), as an estimate has them with its fixed parameters, equalities and priors.

    Errors of the columns change the normal equations by W'W shift, and the estimate by what this does to its own.
    """
    if not isinstance(estimate.method, Reduced | Knowing):
        return shifts
    fit, p = estimate.fit, shifts.shape[1]
    W, root = stacked(fit.observation.motors, fit.weights, p)[:, :-1], fit.solution.root
    return np.asarray(shifts @ W.T @ W @ root @ root.T)


def may_be_less(estimate: Estimate) -> bool:
    """Whether a bias can be subtracted: not where intervals are computed around the fit itself, as by `Profile`."""
    return estimate.constrained_fit is None or not isinstance(estimate.intervals, Limiting)


def like(made: Estimate, other: Estimate) -> Estimate:
    """An estimate less what is subtracted from another one of the same rows and weights, with its nuisances.

    Args:
        made: by another method, such as `FixedAtZero`, as it comes from the rows.
        other: with the uncertainty of its treatment.
    """
    bias, moved = carried(made, (other.fit.solution.beta - other.free)[None])[0], other.fit.moved
    nuisances = {name: carried(made, shifts) for name, shifts in other.nuisances.items()}
    fit = other.fit if moved is None else other.fit.with_moved(carried(made, moved))
    made = less(made, bias) if bias.any() else made
    return made.with_nuisances_of(replace(other, fit=fit, nuisances=nuisances))


def less(estimate: Estimate, bias: Array) -> Estimate:
    """An estimate less a bias, (p,), SI; inequality constraints hold behind it, with their notes.

    Raises:
        ConvergenceError: the solver of the constraints stopped without a solution.
    """
    own, before, free = estimate.quantities, estimate.constrained_fit, estimate.free - bias
    if before is None or not isinstance(estimate.method, Restricted):
        return replace(estimate, quantities=replace(own, values=read_only(free)))
    now = estimate.method.constrain(estimate.observation, replace(estimate.fit.solution, beta=free))
    # That of the estimate's first notes, without nuisances.
    first = estimate.intervals.spread(estimate.fit.with_moved(None))
    half = half_width(np.sqrt(np.diag(first.covariance)), first.dof)
    gone, status = before.notes(half), estimate.status
    if now.constrained_outside_ci(half):
        status = "constrained_outside_ci"
    elif status == "constrained_outside_ci":
        status = "ok"
    return replace(
        estimate,
        quantities=replace(own, values=read_only(now.beta)),
        constrained_fit=now,
        status=status,
        notes=(*(note for note in estimate.notes if note not in gone), *now.notes(half)),
    )
