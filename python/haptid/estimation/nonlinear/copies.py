"""Columns of a term at other values of its searched constants, observed beside the term itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from operator import add

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid.device.parameters import standard_parameters
from haptid.device.terms.term import TermColumn
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.motion.treatment import Motion
from haptid.observation.observation import Observation, observe
from haptid.observation.r_factor import triangle


@dataclass(frozen=True, eq=False)
class EveryOther:
    """Every other time block of a motion.

    Attributes:
        motion: whose blocks.
        parity: 0 for the first, third, ...; 1 for the second, fourth, ...
    """

    motion: Motion
    parity: int


# What constants are searched in.
Sought = Motion | EveryOther


@dataclass(frozen=True)
class Copy:
    """A term's column at another value of one of its searched constants.

    Attributes:
        constant: index among the device's searched constants.
        value: of that constant, SI.
    """

    constant: int
    value: float


@dataclass(frozen=True, eq=False)
class Copied:
    """Rows of a device with copies of some terms: its own columns first, then the copies'.

    Attributes:
        model: the dynamic model itself.
        copies: what was added.
        observation: rows of the device with the copies.
        term: base parameter of each searched constant's own term, (constants,).
    """

    model: DynamicModel
    copies: tuple[Copy, ...]
    observation: Observation
    term: tuple[int, ...]

    @property
    def own(self) -> int:
        """How many columns are the device's own."""
        return len(self.model.base)

    def left(self, weights: Array, instead: Mapping[int, int] | None = None, beside: Array | None = None) -> Left:
        """What columns leave of the torque: the device's own, some terms replaced by copies of them.

        Args:
            weights: of each motor's rows, (motors,).
            instead: copy that stands for each constant's term.
            beside: combinations of all columns that are fitted too, (p of the observation, k).
        """
        stack: Array = self.observation.stack(weights)
        replaced = {self.term[constant]: self.own + copy for constant, copy in (instead or {}).items()}
        kept = [replaced.get(column, column) for column in range(self.own)]
        columns = stack[:, kept] if beside is None else np.hstack([stack[:, kept], stack[:, :-1] @ beside])
        beta = np.asarray(np.linalg.lstsq(columns, stack[:, -1], rcond=None)[0], dtype=np.float64)
        return Left(beta, stack[:, -1] - columns @ beta)

    def taken_out(self, weights: Array, columns: Array) -> tuple[Array, Array]:
        """Combinations (p, k) of all columns, and the torque, without what the device's own columns tell of them."""
        stack = self.observation.stack(weights)
        p = self.own
        R = triangle(np.column_stack([stack[:, :p], stack[:, :-1] @ columns, stack[:, -1]]))
        return R[p:, p:-1], R[p:, -1]


@dataclass(frozen=True, eq=False)
class Left:
    """A fit of some columns.

    Attributes:
        beta: their parameters.
        residual: of the weighted triangle, (rows,).
    """

    beta: Array
    residual: Array

    @property
    def square(self) -> float:
        """Of the weighted residual."""
        return float(self.residual @ self.residual)


def copied(model: DynamicModel, motions: Sequence[Sought], copies: Sequence[Copy]) -> Copied:
    """Observe motions with copies of terms; every term with a searched constant is a base parameter of its own.

    Raises:
        HaptidError: as `observe`.
    """
    wide = _Wide(model, [_copy(model, copy, f":{number}") for number, copy in enumerate(copies)])
    names = [model.device.parameters.names[k] for k in model.base.independent_columns]
    return Copied(
        model=model,
        copies=tuple(copies),
        observation=reduce(add, [observed(wide, motion) for motion in motions]),
        term=tuple(names.index(model.terms[k].name) for k, _ in model.device.searched),
    )


def observed(model: DynamicModel, sought: Sought) -> Observation:
    """The rows of a motion, or of every other block of one."""
    if isinstance(sought, EveryOther):
        return observe(model, sought.motion).alternate()[sought.parity]
    return observe(model, sought)


def _copy(model: DynamicModel, copy: Copy, suffix: str) -> TermColumn:
    k, constant = model.device.searched[copy.constant]
    changed = model.terms[k].with_constant(constant.name, copy.value)
    return replace(changed, name=f"{changed.name}{suffix}", searched=())


@dataclass(frozen=True, eq=False, init=False)
class _Wide(DynamicModel):
    """A device with more terms, every one of which is a base parameter, whatever the others are.

    Attributes:
        narrow: the device without them.
    """

    narrow: DynamicModel

    def __init__(self, narrow: DynamicModel, more: Sequence[TermColumn]) -> None:
        terms, device = (*narrow.terms, *more), narrow.device
        bodies = [joint.body for joint in device.joints]
        parameters = standard_parameters(device.joint_names, bodies, terms, device.symmetry)
        super().__init__(replace(device, terms=terms, parameters=parameters, targets=()))
        object.__setattr__(self, "narrow", narrow)

    @cached_property
    def base(self) -> BaseParameters:
        """Those of the device without, then the terms added."""
        own, old = self.narrow.base, len(self.narrow.device.parameters)
        more = range(old, len(self.device.parameters))
        return replace(
            own,
            names=(*own.names, *(self.device.parameters.names[k] for k in more)),
            units=(*own.units, *(self.device.parameters.units[k] for k in more)),
            independent_columns=(*own.independent_columns, *more),
            regrouping=linalg.block_diag(own.regrouping, np.eye(len(more))),
            standard=tuple(self.device.parameters.names),
        )
