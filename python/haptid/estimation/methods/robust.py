"""Losses that do not let a few wild rows decide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array, positive
from haptid.errors import MethodSettingError


class Loss(Protocol):
    """How much a residual u, in deviations, counts."""

    @property
    def name(self) -> str:
        """Short name."""

    def weight(self, u: Array) -> Array:
        """psi(u) / u, 0 to 1."""

    def slope(self, u: Array) -> Array:
        """psi'(u)."""


@dataclass(frozen=True)
class Huber:
    """Square near zero, straight beyond k: 95 % efficient where residuals are normal.

    Source: Huber (1964), Annals of Mathematical Statistics 35(1).
    """

    k: float = 1.345

    def __post_init__(self) -> None:
        _expect_positive("Huber", "k", self.k)

    @property
    def name(self) -> str:
        return "Huber"

    def weight(self, u: Array) -> Array:
        """psi(u) / u."""
        return np.asarray(self.k / np.maximum(np.abs(u), self.k))

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        return np.where(np.abs(u) <= self.k, 1.0, 0.0)


@dataclass(frozen=True)
class Tukey:
    """The bisquare: rows beyond c do not count at all. It is started from a Huber fit, for it has many minima.

    Source: Beaton and Tukey (1974), Technometrics 16(2).
    """

    c: float = 4.685

    def __post_init__(self) -> None:
        _expect_positive("Tukey", "c", self.c)

    @property
    def name(self) -> str:
        return "Tukey"

    def weight(self, u: Array) -> Array:
        """psi(u) / u."""
        return np.where(np.abs(u) < self.c, (1.0 - (u / self.c) ** 2) ** 2, 0.0)

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        x = (u / self.c) ** 2
        return np.where(x < 1.0, (1.0 - x) * (1.0 - 5.0 * x), 0.0)


@dataclass(frozen=True)
class StudentT:
    """Maximum likelihood of residuals with Student's t distribution, of a given scale.

    Source: Lange, Little and Taylor (1989), JASA 84.
    """

    dof: float = 4.0

    def __post_init__(self) -> None:
        _expect_positive("StudentT", "dof", self.dof)

    @property
    def name(self) -> str:
        return "Student t"

    def weight(self, u: Array) -> Array:
        """psi(u) / u, one at zero."""
        return np.asarray(self.dof / (self.dof + u**2))

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        return np.asarray(self.dof * (self.dof - u**2) / (self.dof + u**2) ** 2)


def _expect_positive(method: str, name: str, value: float) -> None:
    if not positive(value):
        raise MethodSettingError(method, name, value, "a finite number above zero")
