"""Which motors carry torque: the definition by which weights, status, validation and verdict tell small channels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array

# Share of the RMS torque of all motors in its unit below which a motor has hardly any.
HARDLY = 0.02


def shares_of_torque(squares: Array, units: Sequence[str]) -> Array:
    """Each motor's RMS torque over that of all motors in its unit, (motors,); zero where no motor of the unit has any.

    Args:
        squares: mean square of each motor's torque, (motors,), in its unit.
        units: of the motors' torques.
    """
    index = np.unique(np.asarray(units), return_inverse=True)[1]
    total = np.bincount(index, squares)[index]
    return np.sqrt(np.divide(squares, total, out=np.zeros(len(total)), where=total > 0))


def carrying(squares: Array, units: Sequence[str]) -> np.ndarray:
    """Whether each motor carries torque, (motors,), from the arguments of `shares_of_torque`; all where none does."""
    made = shares_of_torque(squares, units) > HARDLY
    return made if made.any() else np.ones(len(made), dtype=bool)
