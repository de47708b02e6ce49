"""How far an estimate may be off: what every kind of interval says of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.estimation.fit import Fit


@dataclass(frozen=True, eq=False)
class Spread:
    """Deviations of base parameters, or of combinations of them, and how well these are known.

    Attributes:
        covariance: (q, q).
        dof: degrees of freedom of the t interval of each, (q,).
        blocks: how many blocks of rows there were.
        alone: those that lean on a single block, as indices, (k,).
    """

    covariance: Array
    dof: Array
    blocks: int
    alone: np.ndarray


class Intervals(Protocol):
    """A way to say how far an estimate may be off: a small frozen type, its settings its fields."""

    @property
    def name(self) -> str:
        """In words, as in the result file."""

    def spread(self, fit: Fit, combinations: Array | None = None) -> Spread:
        """Deviations of combinations of base parameters, (q, p); of each base parameter by itself where left out."""


@runtime_checkable
class Limiting(Intervals, Protocol):
    """Intervals that are not a deviation to both sides, for estimates that are held."""

    def limits(self, fit: Fit, held: object, half: Array) -> Array:
        """Ends of the 95 % intervals, (p, 2), where the free fit's half-widths are (p,)."""


def believing(outer: Array, dof: Array, spread: Array, pull: Array | None) -> tuple[Array, Array]:
    """Covariance (q, q) and degrees of freedom (q,) with the variance of what is only believed added.

    Args:
        outer, dof: what the rows say of combinations.
        spread: these combinations, of coordinates in which rows and knowledge together are the unit matrix, (q, k).
        pull: the knowledge in these coordinates, (rows, k).
    """
    if pull is None:
        return outer, dof
    covariance = outer + (spread @ pull.T) @ (spread @ pull.T).T
    own, whole = np.diag(outer), np.diag(covariance)
    # What is only believed has no degrees of freedom to lose (Satterthwaite 1946).
    return covariance, dof * np.divide(whole, own, out=np.ones_like(whole), where=own > 0) ** 2


def correlations(covariance: Array) -> Array:
    """Of a covariance, (p, p); NaN beside what has no deviation, 1 on the diagonal."""
    se = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        made = np.clip(covariance / np.outer(se, se), -1.0, 1.0)
    np.fill_diagonal(made, 1.0)
    return freeze(made)
