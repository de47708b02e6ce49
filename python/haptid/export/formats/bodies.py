"""Physically consistent standard parameters from base parameters, as simulators and robot descriptions require."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.escaping import xml_comment
from haptid.dynamics.model import DynamicModel
from haptid.errors import PhysicalConsistencyError
from haptid.estimation.feasibility.cone import Cone
from haptid.estimation.feasibility.feasible import feasible_parameters, roomy
from haptid.export.provenance import Provenance, about

# Distance from the boundary of physical consistency, in each link's own mass and length, to which bodies on it are
# moved: simulators reject what rounding may push outside.
INSIDE = 1e-9


def standard_parameters_of(model: DynamicModel, beta: Array) -> Array:
    """Physically consistent free standard parameters with these base parameters, (n,), SI.

    Of all that have them, those nearest to the prior, or to a ball for every link without one. The base parameters are
    reproduced to rounding; where a body lies on the boundary of consistency, to 1e-9 relative.

    Args:
        beta: its base parameters, (p,), SI.

    Raises:
        PhysicalConsistencyError: the base parameters are not physically consistent.
    """
    found = feasible_parameters(model, beta)
    if not found.ok:
        raise PhysicalConsistencyError(
            f"the base parameters are not physically consistent: {'; '.join(found.failing)}.",
            found=found.failing,
            advice=(
                'A simulator requires bodies. Identify with `constraints = "physical"` under [estimate] in the study, '
                "or with `haptid.PhysicallyConsistent`."
            ),
        )
    conditions = roomy(model, beta)
    return conditions.scale * inward(conditions, found.chi / conditions.scale)


def inward(conditions: Cone, x: Array) -> Array:
    """x with the inertia of a small ball added to the bodies on the boundary, so that they are strictly inside, (n,).

    Friction may be zero.
    """
    moved = np.array(x)
    for part in conditions.parts:
        margin, wanted = part.margin(x), INSIDE if any(block.is_link for block in part.blocks) else 0.0
        if margin < wanted:
            ball = conditions.ball[part.columns]
            moved[part.columns] += (wanted - margin) / part.margin(conditions.ball) * ball
    return moved


def departure(model: DynamicModel, beta: Array, chi: Array) -> float:
    """Largest relative difference between base parameters and those of the standard parameters.

    Relative to the sum of the magnitudes that a base parameter groups.

    Args:
        beta: its base parameters, (p,), SI.
        chi: its free standard parameters, (n,), SI.
    """
    sizes = np.abs(model.base.regrouping) @ np.abs(chi)
    gaps = np.abs(model.base.of(chi) - beta)
    return float((gaps / np.where(sizes > 0, sizes, 1.0)).max(initial=0.0))


def heading(source: Provenance, chi: Array, *notes: str) -> str:
    """XML comment with the provenance and how the bodies were chosen."""
    lines = [
        *about(source),
        "Of all bodies with the identified base parameters, those nearest to the prior (without one, to a ball).",
        f"Their base parameters differ from the identified ones by {departure(source.model, source.beta, chi):.0e}.",
        *notes,
    ]
    return f"<!--\n{xml_comment(chr(10).join(lines))}\n-->"
