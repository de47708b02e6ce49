"""Dry friction where a joint turns back: its sign is not known there, so it is smoothed, and its doubt is told."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.terms.friction import DRY
from haptid.device.terms.term import TermColumn
from haptid.dynamics.model import DynamicModel

# Devices whose softened twin is kept: a stream asks for it at every sample.
KEPT = 8


@lru_cache(maxsize=KEPT)
def softened(model: DynamicModel, speed: float) -> DynamicModel:
    """The same device, with tanh(v / speed) for the sign of a velocity wherever its file has a sharper one.

    Args:
        model: the dynamic model.
        speed: rad/s or m/s; 0 leaves the device as it is.
    """
    return replace(model, terms=tuple(_softer(term, speed) for term in model.terms)) if speed else model


def _softer(term: TermColumn, speed: float) -> TermColumn:
    if term.kind not in DRY:
        return term
    return term.with_constant("width", max(term.constant("width"), speed))


def doubt(model: DynamicModel, chi: Array, c: Array, cd: Array, speed: float) -> Array:
    """Torque that dry friction may be off by, (rows, samples), N m or N: all of it at rest, none at speed.

    Where the smoothed sign is s, the friction is FC s give or take FC sqrt(1 - s^2): a joint at rest may be held by
    anything between -FC and FC.

    Args:
        model: the dynamic model.
        chi: parameters of the core's columns, (r,), SI.
        c: positions of the coordinates that torque rows belong to, (active, samples).
        cd: their rates.
        speed: of the smoothed sign, rad/s or m/s; 0 for no doubt.
    """
    squared = np.zeros_like(cd)
    for k, term in enumerate(model.terms) if speed else ():
        if term.kind in DRY:
            shares = model.shares(term, c, cd)
            s = np.tanh((shares * cd).sum(axis=0) / max(term.constant("width"), speed))
            squared += np.square(shares) * chi[10 * len(model.device.joints) + k] ** 2 * (1 - s**2)
    return np.asarray(np.sqrt(squared))
