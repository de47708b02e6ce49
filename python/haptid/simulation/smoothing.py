"""Smooth dry friction for simulation: tanh(v / width) in place of sgn(v)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import state
from haptid.motion.treatment import Motion

# Least width of smooth dry friction, rad/s or m/s.
LEAST = 1e-6


def smooth(model: DynamicModel, motions: Sequence[Motion], share: float) -> DynamicModel:
    """The device with tanh(v / width) in place of sgn(v) wherever its dry friction has no width of its own.

    A joint that sticks then creeps; a solver needs no events.

    Args:
        model: the dynamic model.
        motions: what it does; the width is a share of each term's root mean square speed there.
        share: of that speed.
    """
    states = [state(model.device, motion, *motion.usable) for motion in motions]
    terms = []
    for term in model.terms:
        if term.dry and term.constant("width") == 0:
            power = np.concatenate([model.speed(term, c, cd) ** 2 for c, cd in states])
            term = term.with_constant("width", max(share * float(np.sqrt(power.mean())), LEAST))
        terms.append(term)
    return replace(model, terms=tuple(terms))
