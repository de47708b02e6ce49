"""What is known of base parameters beside the rows: exactly, or with a deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, expect, read_only


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Combinations of base parameters whose values are known: A beta = b.

    Attributes:
        A: (m, p).
        b: (m,), SI.
        se: deviation of each, zero where it is exact, (m,).
    """

    A: Array
    b: Array
    se: Array

    def __post_init__(self) -> None:
        m = np.shape(self.b)[0]
        expect("A", np.shape(self.A), (m, None))
        expect("se", np.shape(self.se), (m,))
        for name in ("A", "b", "se"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def exact(self) -> tuple[Array, Array]:
        """Those that hold exactly, A and b."""
        return self.A[self.se == 0], self.b[self.se == 0]

    @property
    def rows(self) -> Array:
        """The others as rows of unit deviation, [A b] / sd, (k, p + 1)."""
        doubtful = self.se > 0
        return np.asarray(np.column_stack([self.A, self.b])[doubtful] / self.se[doubtful, None])

    @staticmethod
    def nothing(p: int) -> Knowledge:
        """Of p base parameters nothing is known."""
        return Knowledge(np.zeros((0, p)), np.zeros(0), np.zeros(0))
