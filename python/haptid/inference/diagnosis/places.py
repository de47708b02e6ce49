"""Where friction acts: the coordinates of a device whose velocity has a say in the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.dynamics.model import DynamicModel


@dataclass(frozen=True, eq=False)
class Place:
    """A motor's or a joint's own coordinate.

    Attributes:
        label: "motor 2".
        weights: its coordinate, as a combination of the device's coordinates, (active,).
    """

    label: str
    weights: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", read_only(self.weights))


def places(model: DynamicModel, rows: Sequence[int]) -> tuple[Place, ...]:
    """The coordinates with declared dry friction, and those of rows without any.

    Friction of a joint whose rate varies with the pose is no place of its own: its row is looked at.
    """
    found: list[Place] = []
    for row in rows:
        declared = [(term.on, term.weights) for term in model.coulomb_terms(row) if term.joint is None]
        for label, weights in declared or [(model.device.row_labels[row], np.eye(len(model.device.drives))[row])]:
            if not any(np.array_equal(np.abs(weights), np.abs(known.weights)) for known in found):
                found.append(Place(label, weights))
    return tuple(found)
