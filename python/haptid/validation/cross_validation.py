"""Cross-validation of models with nonlinear friction constants: they are estimated again in every training fold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Method, estimate
from haptid.estimation.nonlinear import AlternateBlocks
from haptid.estimation.nonlinear.load_friction import fit_nonlinear_constants
from haptid.motion.motion import Motion
from haptid.observation.observation import observe
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
    motion: Motion,
    others: Sequence[Motion],
    method: Method,
    reference: Motion | None = None,
    use: str = "auto",
) -> Validation:
    """Alternate blocks of a motion predicted by an estimate from its other blocks and the other motions; both folds.

    Args and raises as for `each_log`.
    """

    def predicted() -> Iterator[Validation]:
        for parity in (0, 1):
            fitted_model, _ = fit_nonlinear_constants(model, [AlternateBlocks(motion, parity), *others], method)
            halves = observe(fitted_model, motion).alternate()
            fit = sum((observe(fitted_model, other) for other in others), halves[parity])
            yield validate(model_for_use(estimate(fit, method), None, use).estimate, halves[1 - parity], reference)

    return pooled(*predicted())
