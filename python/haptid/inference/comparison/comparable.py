"""What can be compared, and which parameters of several estimates are the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import ModelMismatchError, listed
from haptid.estimation.intervals.clusters import Clusters
from haptid.observation.plan import Block
from haptid.uncertainty.quantities import Quantities

# Base parameters of one name with regrouping factors that differ by a larger share are different parameters.
SAME_MEANING = 1e-6


class Comparable(Protocol):
    """An estimate that can be compared: `Estimate`, `Targets`, or a `Result` that was read back."""

    @property
    def unconstrained(self) -> Quantities:
        """Its parameters: those of the unconstrained fit, to which the standard errors belong."""

    @property
    def base(self) -> BaseParameters | None:
        """What regroups into the parameters; None where they are not base parameters."""

    @property
    def constrained(self) -> bool:
        """Whether a constraint is active, so that the estimate differs from the unconstrained fit."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Time ranges of the logs that it was made from."""


@runtime_checkable
class Clustered(Comparable, Protocol):
    """One with the scores of its time blocks, of which joint tests are made: `Estimate` and `Result`."""

    @property
    def model(self) -> DynamicModel:
        """Of its device."""

    @property
    def clusters(self) -> Clusters | None:
        """Scores of its time blocks, if they are known."""


def common_parameters(estimates: Sequence[Comparable]) -> tuple[str, ...]:
    """Names of the parameters that all estimates have with one unit and meaning.

    Raises:
        ModelMismatchError: there is none.
    """
    first, *others = estimates
    own = first.unconstrained.names
    names = tuple(name for name in own if all(same_parameter(name, first, other) for other in others))
    if not names:
        fewest = min(others, key=lambda other: sum(same_parameter(name, first, other) for name in own))
        differing = (own, fewest.unconstrained.names)
        raise ModelMismatchError(
            "these estimates have no parameter of one name, unit and meaning in common: they are of "
            f"{' and of '.join(listed(one, 6) for one in differing)}.",
            found=differing,
            advice="Compare base parameters with base parameters or targets with targets, in the same units.",
        )
    return names


def same_parameter(name: str, first: Comparable, second: Comparable) -> bool:
    """Whether a parameter of the first is in the second with the same unit and regrouping."""
    a, b = first.unconstrained, second.unconstrained
    if name not in b.names or a.units[a.names.index(name)] != b.units[b.names.index(name)]:
        return False
    if first.base is None or second.base is None:
        return first.base is second.base
    ours, theirs = _regrouped(first.base, name), _regrouped(second.base, name)
    return ours.keys() == theirs.keys() and all(np.isclose(ours[n], theirs[n], rtol=SAME_MEANING) for n in ours)


def _regrouped(base: BaseParameters, name: str) -> dict[str, float]:
    """Factors of the standard parameters in a base parameter."""
    row = base.regrouping[base.names.index(name)]
    return {base.standard[k]: float(row[k]) for k in np.flatnonzero(row)}
