"""What is compared: base parameters or targets, of an estimate or of a folder of results, the free fit of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.base_parameters import BaseParameters
from haptid.errors import DependentEstimatesError
from haptid.estimation import Estimate
from haptid.inference.targets import Targets, free_fit
from haptid.observation.observation import Block
from haptid.results.read import Recorded

# Regrouping coefficients that differ by a larger share make two base parameters of one name two things.
SAME_MEANING = 1e-6

Compared = Estimate | Targets | Recorded


@dataclass(frozen=True, eq=False)
class Side:
    """One of the estimates of a comparison.

    Attributes:
        base: where the parameters are base parameters, else None.
        names, units: of the parameters, (p,).
        value: of the fit that is held to nothing, (p,).
        se: honest deviations, infinite where one stretch of a log alone tells, (p,).
        covariance: (p, p).
        dof: degrees of freedom of each, (p,).
        held: whether the estimate differs from the free fit.
        blocks: stretches of logs that it was made from.
    """

    base: BaseParameters | None
    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    se: Array
    covariance: Array
    dof: Array
    held: bool
    blocks: tuple[Block, ...]

    @staticmethod
    def of(made: Compared) -> Side:
        spread = made.se, made.covariance, made.dof
        if isinstance(made, Recorded):
            held = bool((made.beta != made.free).any())
            return Side(made.base, made.names, made.base.units, made.free, *spread, held, made.blocks)
        estimate = made.estimate if isinstance(made, Targets) else made
        whence = bool(estimate.held and estimate.held.active), estimate.observation.blocks
        if isinstance(made, Targets):
            return Side(None, made.names, made.units, made.free, *spread, *whence)
        return Side(made.base, made.base.names, made.base.units, free_fit(made), *spread, *whence)

    def same(self, name: str, other: Side) -> bool:
        """Whether the parameter is in both with one meaning."""
        if name not in other.names or self.units[self.names.index(name)] != other.units[other.names.index(name)]:
            return False
        if self.base is None or other.base is None:
            return self.base is other.base
        mine, theirs = _regrouped(self.base, name), _regrouped(other.base, name)
        return mine.keys() == theirs.keys() and all(np.isclose(mine[n], theirs[n], rtol=SAME_MEANING) for n in mine)

    def expect_apart(self, other: Side) -> None:
        """Raise DependentEstimatesError where both were made from the same rows."""
        for block in self.blocks:
            if any(block.overlaps(theirs) for theirs in other.blocks):
                raise DependentEstimatesError(block.log, block.start, block.stop)

    def pick(self, names: tuple[str, ...]) -> list[int]:
        """Indices of some of its parameters."""
        return [self.names.index(name) for name in names]


def _regrouped(base: BaseParameters, name: str) -> dict[str, float]:
    """Factors of the standard parameters in a base parameter."""
    row = base.regrouping[base.names.index(name)]
    return {base.standard[k]: float(row[k]) for k in np.flatnonzero(row)}
