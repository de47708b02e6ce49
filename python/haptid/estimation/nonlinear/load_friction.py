"""Dry friction in proportion to the load: its column depends on the parameters, so both are found in turn."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add

import numpy as np

from haptid.device.terms.term import LoadDependentFriction
from haptid.dynamics.model import DynamicModel
from haptid.errors import UnsettledError
from haptid.estimation import WLS, FixedAtZero, Method, estimate
from haptid.estimation.method import only_weighs
from haptid.estimation.methods.kalman import Filtering
from haptid.estimation.nonlinear.copies import Sought, observed
from haptid.observation.observation import Observation

# Passes at most, and how far the last may move a parameter, in its deviations.
MOST, SETTLED = 20, 0.01
# Of the largest parameter: rows without noise leave deviations of rounding, which no pass comes to rest within.
ROUNDING = 1e-9


def fit_load_friction(model: DynamicModel, motions: Sequence[Sought], method: Method | None = None) -> DynamicModel:
    """The device with the load of its own bodies in its friction by load: a fixed point of fits in turn.

    The first fit is without that friction; every next one has its columns from the bodies of the one before. A pass
    takes off all of what is wrong but a share of about the friction's coefficient. Intervals of a fit with these
    columns take the load as exact: it is known far better than the coefficient.

    Source: Hamon, Gautier and Garrec (2010), Proc. IEEE/RSJ IROS, 6187-6193.

    Args:
        model: with terms of the kind "load".
        motions: treated, with accelerations; or every other block of one.
        method: of estimation. What it holds, knows or leaves out counts in the last fit alone: here it only weighs
            rows, and where it does not, `WLS()` does.

    Raises:
        AccelerationColumnError: a motion has no accelerations.
        UnsettledError: the passes do not come to rest.
        HaptidError: as `observe` and `estimate`.
    """
    weighting = _weighting(method)
    names = {term.name for term in model.terms if isinstance(term.shape, LoadDependentFriction)}
    own = tuple(name for name in model.base.names if name in names)
    beta = estimate(_rows(model, motions), FixedAtZero(own, weighting)).beta
    for _ in range(MOST):
        here = model.loaded(beta)
        found = estimate(_rows(here, motions), weighting)
        moved = np.abs(found.beta - beta) / np.maximum(found.se, ROUNDING * np.abs(found.beta).max())
        if moved.max() <= SETTLED:
            return here
        beta = found.beta
    worst = int(np.argmax(moved))
    raise UnsettledError("friction by load", MOST, model.base.names[worst], float(moved[worst]), SETTLED)


def _rows(model: DynamicModel, motions: Sequence[Sought]) -> Observation:
    """Of all motions."""
    return reduce(add, [observed(model, motion) for motion in motions])


def _weighting(method: Method | None) -> Method:
    """The method, or what it is around, if that weighs rows and nothing else; a filter simulates besides."""
    inner: Method | None = getattr(method, "weighting", method)
    return inner if inner and only_weighs(inner) and not isinstance(inner, Filtering) else WLS()
