"""Placements of frames with the lengths as symbols: turns and shifts, one after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.symbolic.laurent import Laurent
from haptid.dynamics.symbolic.residues import Field, Residues


@dataclass(frozen=True)
class Turn:
    """A turn about an axis of the frame so far: 0 is x, 1 is y, 2 is z."""

    axis: int
    cos: Laurent
    sin: Laurent

    @property
    def entries(self) -> tuple[tuple[int, int, Laurent], ...]:
        """Row, column and value of the matrix where it is not that of the identity."""
        i, k = (self.axis + 1) % 3, (self.axis + 2) % 3
        return ((i, i, self.cos), (k, k, self.cos), (i, k, -self.sin), (k, i, self.sin))


@dataclass(frozen=True)
class Shift:
    """A shift along an axis of the frame so far, m."""

    axis: int
    length: Laurent

    @property
    def entries(self) -> tuple[tuple[int, int, Laurent], ...]:
        """Row, column and value of the matrix where it is not that of the identity."""
        return ((self.axis, 3, self.length),)


# From the left: the first step is taken in the parent's frame.
Placement = tuple[Turn | Shift, ...]


def inverse(placement: Placement) -> Placement:
    """The way back."""
    return tuple(
        Turn(step.axis, step.cos, -step.sin) if isinstance(step, Turn) else Shift(step.axis, -step.length)
        for step in reversed(placement)
    )


def modulo(placement: Placement, field: Field, values: Mapping[str, Residues], count: int) -> Residues:
    """Residues of a placement, (count, 4, 4), from those of its symbols, (count,) each."""
    made = np.zeros((count, 4, 4), dtype=np.int64)
    made[:, range(4), range(4)] = 1
    whole = made
    for step in placement:
        matrix = whole.copy()
        for row, column, entry in step.entries:
            matrix[:, row, column] = entry.modulo(field, values, count)
        made = field.product(made, matrix)
    return made


def value(placement: Placement, values: Mapping[str, float]) -> Array:
    """A placement as numbers, (4, 4), m."""
    made = np.eye(4)
    for step in placement:
        matrix = np.eye(4)
        for row, column, entry in step.entries:
            matrix[row, column] = entry.value(values)
        made = made @ matrix
    return made


def least_turn(axis: tuple[float, float, float]) -> tuple[tuple[int, float], ...]:
    """The least turn that takes z onto a unit axis, as axes and angles, rad; about x where the axis is -z."""
    x, y, z = axis
    across = math.hypot(x, y)
    if across < 1e-12:
        return () if z > 0 else ((0, math.pi),)
    heading = math.atan2(y, x)
    return ((2, heading), (1, math.atan2(across, z)), (2, -heading))
