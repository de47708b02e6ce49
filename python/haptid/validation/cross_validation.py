"""Cross-validation of models with nonlinear friction constants: they are estimated again in every training fold."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Method, estimate
from haptid.estimation.nonlinear import AlternateBlocks
from haptid.estimation.nonlinear.load_friction import fit_nonlinear_constants
from haptid.motion.motion import Motion
from haptid.observation.observation import concatenated, observe
from haptid.validation.model_for_use import model_for_use
from haptid.validation.validation import Validation, pooled, validate


def each_log(
    model: DynamicModel,
    motion: Motion,
    others: Sequence[Motion],
    method: Method,
    reference: Motion | None = None,
    use: str = "auto",
) -> Validation:
    """Leave-one-log-out: a motion predicted by constants, friction by load and parameters estimated from the others.

    Args:
        model: as in its file, with searched constants or friction by load.
        motion: that is predicted.
        others: that are fitted.
        method: of estimation.
        reference: the predicted motion behind the reference filter, for errors on all rows.
        use: which fit is the model for use; see `model_for_use`.

    Raises:
        HaptidError: as `fit_nonlinear_constants`, `observe` and `estimate`.
    """
    fitted_model, _ = fit_nonlinear_constants(model, others, method)
    usable = model_for_use(estimate(observe(fitted_model, *others), method), None, use).estimate
    return validate(usable, observe(fitted_model, motion), reference)


def alternate(
    model: DynamicModel,
    motions: Sequence[Motion],
    others: Sequence[Motion],
    method: Method,
    references: Sequence[Motion | None] | None = None,
    use: str = "auto",
) -> tuple[Validation, ...]:
    """Alternate blocks of motions predicted by an estimate from their other blocks and the other motions; both folds.

    Args:
        motions: that are predicted; the result has one validation for each.
        references: of each, the motion behind the reference filter; None for no errors on all rows.

    The others, and what is raised, are as for `each_log`.
    """
    references = references or [None] * len(motions)
    folds: list[list[Validation]] = []
    for parity in (0, 1):
        halved = [AlternateBlocks(motion, parity) for motion in motions]
        fitted_model, _ = fit_nonlinear_constants(model, [*halved, *others], method)
        halves = [observe(fitted_model, motion).alternate() for motion in motions]
        fit = concatenated([*(half[parity] for half in halves), *(observe(fitted_model, other) for other in others)])
        usable = model_for_use(estimate(fit, method), None, use).estimate
        unseen = [half[1 - parity] for half in halves]
        folds.append([validate(usable, rows, own) for rows, own in zip(unseen, references, strict=True)])
    return tuple(pooled(*both) for both in zip(*folds, strict=True))
