"""The two roads to base parameters, compared: exact with symbols, and numeric at the device's own lengths."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from haptid.device.expressions import Column
from haptid.dynamics.base_parameters import random_regressor
from haptid.errors import AccelerationRegroupingError, RoadsDisagreeError

if TYPE_CHECKING:
    from haptid.dynamics.base_parameters import BaseParameters
    from haptid.dynamics.model import DynamicModel
    from haptid.dynamics.symbolic.regrouping import Regroupings

# Coefficients of the two roads may differ by this much: relatively, and beside what a coefficient would be that made
# the two columns equally long. The numeric road solves with columns whose lengths differ by orders of magnitude.
RELATIVE, ROUNDING = 1e-6, 1e-7


def check_agreement(exact: Regroupings, model: DynamicModel) -> None:
    """Raise unless both roads keep the same parameters and regroup the others alike.

    Args:
        exact: by the one road.
        model: its numbers, for the other.

    Raises:
        AccelerationRegroupingError: a column of accelerations is kept by the one and not by the other.
        RoadsDisagreeError: they do not agree for another reason.
    """
    numeric = model.base
    tied = [name for name in accelerated(model) if (name in _kept(exact)) != (name in _kept(numeric))]
    if tied:
        raise AccelerationRegroupingError(tied)
    if exact.kept != numeric.kept or exact.no_effect != numeric.no_effect:
        only = [_names(exact, a, b) for a, b in ((exact, numeric), (numeric, exact))]
        raise RoadsDisagreeError(len(exact), len(numeric), only[0], only[1])
    apart = np.abs(exact.values - numeric.regrouping)
    lengths = np.linalg.norm(random_regressor(model, seed=0), axis=0)
    limit = ROUNDING * lengths / lengths[list(exact.kept)][:, None] + RELATIVE * np.abs(exact.values)
    if (apart > limit).any():
        row, column = np.unravel_index(int(np.argmax(apart - limit)), apart.shape)
        where = f"{exact.standard[column]} in {exact.names[row]}"
        found = (float(exact.values[row, column]), float(numeric.regrouping[row, column]))
        raise RoadsDisagreeError(len(exact), len(numeric), [f"{found[0]:.6g} {where}"], [f"{found[1]:.6g} {where}"])


def accelerated(model: DynamicModel) -> list[str]:
    """Names of the user's own columns that are made of accelerations."""
    rates = {f"a_{name}" for name in model.device.joint_names}
    return [term.name for term in model.externals if isinstance(term.shape, Column) and term.shape.reads(rates)]


def _kept(one: Regroupings | BaseParameters) -> list[str]:
    """Standard parameters that base parameters are named after."""
    return [one.standard[k] for k in one.kept]


def _names(exact: Regroupings, one: Regroupings | BaseParameters, other: Regroupings | BaseParameters) -> list[str]:
    """What one road keeps, or finds without effect, and the other does not."""
    kept = [exact.standard[k] for k in one.kept if k not in other.kept]
    return kept + [f"{name} without effect" for name in one.no_effect if name not in other.no_effect]
