"""Ordinary least squares: every row counts the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.observation.observation import Observation


@dataclass(frozen=True)
class OLS:
    """Ordinary least squares, all motors' rows alike.

    Source: Janot et al. (2007), ISIE, eqs 13 to 17.
    """

    @property
    def name(self) -> str:
        return "OLS"

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""
        return False

    def weights(self, observation: Observation) -> Array:
        """One for every motor, (motors,)."""
        return np.ones(len(observation.motors))
