"""Dry friction of motors whose torque was shifted by another delay than the positions: its sign at their own instants.

The common part of the delays moves the positions, which are smooth, to the torques' instants. What a motor differs by
shifts its torque, and interpolation between samples rounds the jumps of dry friction off. Its column jumps as well: at
the motor's own instants, by interpolated velocities. Shifted by the same interpolation it is what the torque contains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device import Device
from haptid.device.terms.friction import DRY
from haptid.device.terms.term import TermColumn
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import state, torque_map
from haptid.motion.motion import SIDE, Motion
from haptid.motion.streaming import CUBIC, SMOOTH, delayed, lost

# Shift of a torque, samples, below which the rounded jump is as good as a sharp one.
_SHARP = 0.02
# Models with such columns that are cached: each is compiled.
_CACHED = 16


@dataclass(frozen=True)
class OwnColumn:
    """A term's column at the instants of one motor.

    Attributes:
        term: of dry friction.
        shift: of the motor's torque to later samples, samples.
    """

    term: TermColumn
    shift: float

    def values(self, speed: Array) -> Array:
        """From its velocity at consecutive samples, (samples,); the first and last `reach` are not right."""
        there = delayed(speed[:, None], -self.shift, SMOOTH)[:, 0]
        return delayed(self.term.sliding(there)[:, None], self.shift, CUBIC)[:, 0]

    @property
    def reach(self) -> int:
        """Samples at either end that lack neighbours."""
        return lost(self.shift, SMOOTH) + lost(self.shift, CUBIC)


def own_columns(model: DynamicModel, motion: Motion) -> tuple[OwnColumn, ...]:
    """Terms of dry friction on a motor whose torque alone is a row, and is shifted."""
    treatment, log = motion.treatment, motion.log
    shifts = np.asarray(treatment.torque_shift_s) / motion.dt
    if log is None or treatment.cutoff_hz is None or not shifts.ndim or np.abs(shifts).max() < _SHARP:
        return ()
    if log.channels.torque.side == "motor" and model.device.drive_varies.any():
        return ()
    alone = _channels(model.device, motion)
    found = []
    for term in model.terms:
        rows = np.flatnonzero(term.weights)
        sharp = term.kind in DRY and term.joint is None and term.constant("width") == 0
        if sharp and len(rows) == 1 and int(rows[0]) in alone:
            shift = float(shifts[alone[int(rows[0])]])
            if abs(shift) >= _SHARP:
                found.append(OwnColumn(term, shift))
    return tuple(found)


def _channels(device: Device, motion: Motion) -> dict[int, int]:
    """The torque channel of each row that has one alone."""
    assert motion.log is not None
    acts = torque_map(device, motion.log) != 0
    return {int(row): int(np.argmax(acts[row])) for row in np.flatnonzero(acts.sum(axis=1) == 1)}


def along(
    model: DynamicModel, motion: Motion, columns: tuple[OwnColumn, ...], low: int, high: int
) -> Mapping[str, Array]:
    """The columns at usable samples low..high, by name, each (samples,)."""
    if not columns:
        return {}
    reach = max(own.reach for own in columns)
    first, last = max(low - reach, SIDE), min(high + reach, len(motion) - SIDE)
    c, cd = state(model.device, motion, first, last)
    made = {own.term.name: own.values(model.speed(own.term, c, cd)) for own in columns}
    return {name: values[low - first : high - first] for name, values in made.items()}


@lru_cache(maxsize=_CACHED)
def with_given(model: DynamicModel, names: frozenset[str]) -> DynamicModel:
    """The model with columns of these terms given from outside, in their places.

    Args:
        names: of the terms' parameters.
    """
    return model.with_terms([replace(term, kind="external") if term.name in names else term for term in model.terms])
