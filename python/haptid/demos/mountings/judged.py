"""What becomes of a set of parameters in use: where M is positive definite, and whether bodies can have it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.demos.mountings.plan import Mountings, Place
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.definiteness import Definiteness, definiteness
from haptid.estimation import Estimate, FeasibleParameters, possible
from haptid.inference.targets import Targets, target_map


@dataclass(frozen=True, eq=False)
class Judged:
    """One set of base parameters, published or identified.

    Attributes:
        title: for tables.
        definite: by workspace, in the plan's order.
        possible: whether real bodies and passive terms can have it.
    """

    title: str
    definite: tuple[Definiteness, ...]
    possible: FeasibleParameters

    def eigenvalues(self, per_command: float) -> tuple[float, ...]:
        """Least eigenvalue of M in each workspace, in units of command."""
        return tuple(found.smallest * per_command for found in self.definite)


def judge(title: str, parameters: Estimate | Array, model: DynamicModel, places: Sequence[Place]) -> Judged:
    """A set of base parameters over all workspaces."""
    beta = parameters.beta if isinstance(parameters, Estimate) else parameters
    found = tuple(definiteness(parameters, place.of(model)) for place in places)
    return Judged(title, found, possible(model, beta))


def published(demo: Mountings, like: Targets, column: str) -> Array:
    """Base parameters of a published column, in SI; a parameter that it does not have is taken as zero, (p,).

    Args:
        demo: the demonstration.
        like: targets of any estimate of the device, which know the units of command.
        column: of the table of parameters.
    """
    per_command = np.linalg.norm(like.in_command().C, axis=1) / np.linalg.norm(like.C, axis=1)
    values = np.nan_to_num(demo.parameters.column(column)) / per_command
    return np.asarray(np.linalg.solve(target_map(like.estimate.model), values))
