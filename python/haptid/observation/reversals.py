"""Dry friction near a velocity reversal: its sign is uncertain there, so it is smoothed, with a bound on the error."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.term import TermColumn
from haptid.dynamics.model import DynamicModel

# Smoothed models that are cached: a stream requires one at every sample.
_CACHED = 8


@lru_cache(maxsize=_CACHED)
def smoothed_friction(model: DynamicModel, speed: float) -> DynamicModel:
    """The model with tanh(v / speed) in place of sgn(v), wherever its file has a sharper transition.

    Args:
        speed: rad/s or m/s; 0 leaves the model as it is.
    """
    return model.with_terms([_softer(term, speed) for term in model.terms]) if speed else model


def _softer(term: TermColumn, speed: float) -> TermColumn:
    if not term.signed:
        return term
    return term.with_constant("width", max(term.constant("width"), speed))


def friction_uncertainty(model: DynamicModel, chi: Array, c: Array, cd: Array, speed: float) -> Array:
    """Uncertainty of the dry friction torque near reversals, (rows, samples), N m or N: all of it at rest, 0 at speed.

    Where the smoothed sign is s, the friction is FC s with an uncertainty of FC sqrt(1 - s^2): the friction of a joint
    at rest lies anywhere between -FC and FC.

    Args:
        chi: parameters of the core's columns, (r,), SI.
        c: positions of the coordinates that torque rows belong to, (active, samples).
        cd: their rates.
        speed: of the smoothed sign, rad/s or m/s; 0 for no uncertainty.
    """
    squared = np.zeros_like(cd)
    for k, term in enumerate(model.terms) if speed else ():
        if term.signed:
            shares = model.shares(term, c, cd)
            s = np.tanh((shares * cd).sum(axis=0) / max(term.constant("width"), speed))
            squared += np.square(shares) * chi[10 * len(model.device.joints) + k] ** 2 * (1 - s**2)
    return np.asarray(np.sqrt(squared))
