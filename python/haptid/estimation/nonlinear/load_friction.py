"""Friction proportional to load, and models with searched constants, linearised for estimation.

The column of friction by load depends on the parameters to be estimated, so both are found by fixed-point iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from haptid.device.terms.friction import LoadDependentFriction
from haptid.dynamics.model import DynamicModel
from haptid.estimation.estimate import estimate
from haptid.estimation.intervals.covariance import Intervals
from haptid.estimation.method import Method, not_converged, only_weights_rows
from haptid.estimation.methods.constrained import FixedAtZero
from haptid.estimation.methods.kalman import Filtering
from haptid.estimation.methods.wls import WLS
from haptid.estimation.nonlinear.candidate_columns import RowSource, observed_candidates
from haptid.estimation.nonlinear.variable_projection import VariableProjection, variable_projection

# Largest number of passes, and convergence: largest move of a parameter, in standard errors.
MOST_PASSES, _CONVERGED = 20, 0.01
# Least standard error in that criterion, relative to the largest parameter, for rows without noise.
_ROUNDING = 1e-9

_Progress = Callable[[str, float], None]


def has_nonlinear_constants(model: DynamicModel) -> bool:
    """Whether columns of the model depend on what is estimated: searched constants, or friction by load."""
    return bool(model.device.searched) or model.has_loads


def fit_nonlinear_constants(
    model: DynamicModel,
    motions: Sequence[RowSource],
    method: Method | None = None,
    intervals: Intervals | None = None,
    progress: _Progress | None = None,
) -> tuple[DynamicModel, VariableProjection | None]:
    """The model with its searched constants and loads estimated, linear in all other parameters.

    Loads are estimated first with the initial constants, so that the search starts with approximate loads, and again
    with the constants found.

    Args:
        model: as its file has it.
        motions: treated, or every other block of one.
        method: of estimation, `WLS()` where None.
        intervals: of the constants, `ClusterRobust()` where None.
        progress: called with the present step and the share of it done.

    Raises:
        HaptidError: as `fit_load_friction` and `variable_projection`.
    """
    progress = progress or (lambda _what, _share: None)
    model = _loaded(model, motions, method, progress)
    if not model.device.searched:
        return model, None
    progress("searching constants", 0.0)
    projection = variable_projection(
        model, motions, method, intervals, lambda share: progress("searching constants", share)
    )
    model = _loaded(projection.model, motions, method, progress)
    return model, replace(projection, model=model)


def _loaded(
    model: DynamicModel, motions: Sequence[RowSource], method: Method | None, progress: _Progress
) -> DynamicModel:
    """With its loads estimated, where it has friction by load."""
    if not model.has_loads:
        return model
    progress("estimating loads", 0.0)
    model = fit_load_friction(model, motions, method)
    progress("estimating loads", 1.0)
    return model


def fit_load_friction(model: DynamicModel, motions: Sequence[RowSource], method: Method | None = None) -> DynamicModel:
    """The model with the load of its own bodies in its friction by load, by fixed-point iteration of fits.

    The first fit is without that friction; every next one has its columns from the bodies of the one before. The
    error decreases in each pass by a factor of about the friction coefficient. Intervals of a fit with these columns
    take the load as exact, because it is known far better than the coefficient.

    Source: Hamon, Gautier and Garrec (2010), Proc. IEEE/RSJ IROS, 6187-6193.

    Args:
        model: with terms of the kind "load-friction".
        motions: treated, with accelerations; or every other block of one.
        method: of estimation. Only its weighting is used here, `WLS()` where it has none of its own; its constraints
            and priors apply in the final fit.

    Raises:
        MissingAccelerationError: a motion has no accelerations.
        ConvergenceError: no convergence.
        HaptidError: as `observe` and `estimate`.
    """
    weighting = _weighting(method)
    names = {term.name for term in model.terms if isinstance(term.shape, LoadDependentFriction)}
    own = tuple(name for name in model.base.names if name in names)
    beta = estimate(observed_candidates(model, motions), FixedAtZero(own, weighting)).beta
    for _ in range(MOST_PASSES):
        loaded = model.loaded(beta)
        fitted = estimate(observed_candidates(loaded, motions), weighting)
        moved = np.abs(fitted.beta - beta) / np.maximum(fitted.se, _ROUNDING * np.abs(fitted.beta).max())
        if moved.max() <= _CONVERGED:
            return loaded
        beta = fitted.beta
    worst = int(np.argmax(moved))
    name = model.base.names[worst]
    raise not_converged("friction by load", MOST_PASSES, name, float(moved[worst]), _CONVERGED)


def _weighting(method: Method | None) -> Method:
    """The method, or the one it wraps, if that weights rows and nothing else, which a Kalman filter does not."""
    inner: Method | None = getattr(method, "weighting", method)
    return inner if inner and only_weights_rows(inner) and not isinstance(inner, Filtering) else WLS()
