"""What every method of estimation can do."""

from __future__ import annotations

from typing import Protocol

from haptid._values import Array
from haptid.observation import Observation


class Method(Protocol):
    """How rows are weighted: a small frozen type, its settings its fields."""

    @property
    def name(self) -> str:
        """Short name, as in tables and the result file."""

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""

    def weights(self, observation: Observation) -> Array:
        """Weight of each motor's rows, (motors,)."""
