"""Full parameters of real bodies behind base parameters: what simulators and robot descriptions ask for."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import ImpossibleModelError
from haptid.estimation.feasibility.cone import Cone
from haptid.estimation.feasibility.feasible import possible, roomy

# Bodies on the border of what is possible go this far inside, in each link's own mass and length: simulators refuse
# what rounding may push out.
INSIDE = 1e-9


def standard_parameters(model: DynamicModel, beta: Array) -> Array:
    """Free standard parameters that real bodies and passive terms can have, with these base parameters, (n,), SI.

    Of all that have them, those of `FeasibleParameters`: nearest to the prior, or to a ball for every link without one. The base
    parameters come out to rounding; where a body lies on the border of what is possible, to 1e-9 of its size.

    Args:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.

    Raises:
        ImpossibleModelError: no bodies have these base parameters.
    """
    found = possible(model, beta)
    if not found.ok:
        raise ImpossibleModelError(found.failing)
    conditions = roomy(model, beta)
    return conditions.scale * inward(conditions, found.chi / conditions.scale)


def inward(conditions: Cone, x: Array) -> Array:
    """x, with as much of a ball in every part on the border as brings it inside, (n,)."""
    moved = np.array(x)
    for part in conditions.parts:
        margin = part.margin(x)
        if margin < INSIDE:
            ball = conditions.ball[part.columns]
            moved[part.columns] += (INSIDE - margin) / part.margin(conditions.ball) * ball
    return moved


def departure(model: DynamicModel, beta: Array, chi: Array) -> float:
    """Largest difference of base parameters from those of standard parameters, beside what they are sums of.

    Args:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        chi: its free standard parameters, (n,), SI.
    """
    sizes = np.abs(model.base.regrouping) @ np.abs(chi)
    gaps = np.abs(model.base.of(chi) - beta)
    return float((gaps / np.where(sizes > 0, sizes, 1.0)).max(initial=0.0))
