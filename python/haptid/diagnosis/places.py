"""Where friction acts: the coordinates of a device whose velocity has a say in the torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptid._values import Array, read_only
from haptid.device import Device
from haptid.device.terms import DRY


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


def places(device: Device, rows: Sequence[int]) -> tuple[Place, ...]:
    """The coordinates with declared dry friction, and those of rows without any."""
    found: list[Place] = []
    for row in rows:
        directions = device.coulomb_directions(row) or (np.eye(len(device.drives))[row],)
        for weights in directions:
            if not any(np.array_equal(np.abs(weights), np.abs(known.weights)) for known in found):
                found.append(Place(_label(device, row, weights), weights))
    return tuple(found)


def _label(device: Device, row: int, weights: Array) -> str:
    named = [term.on for term in device.terms if term.kind in DRY and np.array_equal(term.weights, weights)]
    return named[0] if named else device.row_labels[row]
