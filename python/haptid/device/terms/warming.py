"""Viscous friction that falls while a device warms up."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass


@dataclass(frozen=True)
class Warming:
    """Column of the viscous friction that a cold device has in addition: v exp(-t / time).

    The lubricant's temperature approaches its steady state exponentially, and to first order the viscosity with it.
    Where no time is known the device is warm, and the column is zero.

    Attributes:
        time: constant of the warming, s.
    """

    time: float

    @property
    def text(self) -> str:
        """The formula."""
        return f"v exp(-t / {self.time:g} s)"

    def along(self, t: Array, v: Array) -> Array:
        """The column, (samples,), from times since the start of the log, s, and velocities."""
        return np.asarray(v * np.exp(-t / self.time))
