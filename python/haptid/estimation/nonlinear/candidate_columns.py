"""Regressor columns of friction terms at candidate values of their nonlinear constants, next to the model's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.parameters import standard_parameters
from haptid.device.terms.term import TermColumn
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.motion.motion import Motion
from haptid.observation.observation import Observation, concatenated, observe
from haptid.observation.r_factor import r_factor


@dataclass(frozen=True, eq=False)
class AlternateBlocks:
    """Every other time block of a motion, a fold of a cross-validation.

    Attributes:
        motion: whose blocks.
        parity: 0 for the first, third, ...; 1 for the second, fourth, ...
    """

    motion: Motion
    parity: int


# Where rows come from: a motion, or every other block of one.
RowSource = Motion | AlternateBlocks


@dataclass(frozen=True)
class Candidate:
    """A term's column at another value of one of its nonlinear constants.

    Attributes:
        constant: index among the device's searched constants.
        value: of that constant, SI.
    """

    constant: int
    value: float


@dataclass(frozen=True, eq=False)
class CandidateRows:
    """Rows of a model with candidate columns: its own columns first, then the candidates.

    Attributes:
        model: the dynamic model itself.
        candidates: what was added.
        observation: rows of the model with the candidates.
        term: base parameter of each searched constant's own term, (constants,).
    """

    model: DynamicModel
    candidates: tuple[Candidate, ...]
    observation: Observation
    term: tuple[int, ...]

    @property
    def own(self) -> int:
        """Number of the model's own columns."""
        return len(self.model.base)

    def fit(self, weights: Array, instead: Mapping[int, int] | None = None, extra: Array | None = None) -> CandidateFit:
        """Least squares on the model's own columns, some of them replaced by candidates.

        Args:
            weights: of each motor's rows, (motors,).
            instead: candidate that replaces each constant's term.
            extra: combinations of all columns that are fitted too, (p of the observation, k).
        """
        stack: Array = self.observation.stack(weights)
        replaced = {self.term[constant]: self.own + number for constant, number in (instead or {}).items()}
        kept = [replaced.get(column, column) for column in range(self.own)]
        columns = stack[:, kept] if extra is None else np.hstack([stack[:, kept], stack[:, :-1] @ extra])
        beta = np.asarray(np.linalg.lstsq(columns, stack[:, -1], rcond=None)[0], dtype=np.float64)
        return CandidateFit(beta, stack[:, -1] - columns @ beta)

    def projected(self, weights: Array, columns: Array) -> tuple[Array, Array]:
        """Combinations (p, k) of all columns, and the torque, projected off the model's own columns."""
        stack = self.observation.stack(weights)
        p = self.own
        R = r_factor(np.column_stack([stack[:, :p], stack[:, :-1] @ columns, stack[:, -1]]))
        return R[p:, p:-1], R[p:, -1]


@dataclass(frozen=True, eq=False)
class CandidateFit:
    """A least-squares fit of some columns.

    Attributes:
        beta: their parameters.
        residual: of the weighted R factor, (rows,).
    """

    beta: Array
    residual: Array

    @property
    def square(self) -> float:
        """Sum of squares of the weighted residual."""
        return float(self.residual @ self.residual)


def candidate_rows(model: DynamicModel, sources: Sequence[RowSource], candidates: Sequence[Candidate]) -> CandidateRows:
    """Observe motions with candidate columns; every term with a searched constant is a base parameter of its own.

    Raises:
        HaptidError: as `observe`.
    """
    wide = _WidenedModel(model, [_column(model, copy, f":{number}") for number, copy in enumerate(candidates)])
    names = [model.device.parameters.names[k] for k in model.base.independent_columns]
    return CandidateRows(
        model=model,
        candidates=tuple(candidates),
        observation=observed_candidates(wide, sources),
        term=tuple(names.index(model.terms[k].name) for k, _ in model.device.searched),
    )


def observed_candidates(model: DynamicModel, sources: Sequence[RowSource]) -> Observation:
    """The rows of several motions, or of every other block of them.

    Raises:
        HaptidError: as `observe`.
    """
    return concatenated(_observed(model, source) for source in sources)


def _observed(model: DynamicModel, source: RowSource) -> Observation:
    if isinstance(source, AlternateBlocks):
        return observe(model, source.motion).alternate()[source.parity]
    return observe(model, source)


def _column(model: DynamicModel, candidate: Candidate, suffix: str) -> TermColumn:
    k, constant = model.device.searched[candidate.constant]
    changed = model.terms[k].with_constant(constant.name, candidate.value)
    return replace(changed, name=f"{changed.name}{suffix}", searched=())


@dataclass(frozen=True, eq=False, init=False)
class _WidenedModel(DynamicModel):
    """A model with additional terms, each of which is a base parameter of its own.

    Attributes:
        narrow: the model without them.
    """

    narrow: DynamicModel

    def __init__(self, narrow: DynamicModel, added: Sequence[TermColumn]) -> None:
        terms, device = (*narrow.terms, *added), narrow.device
        bodies = [joint.body for joint in device.joints]
        parameters = standard_parameters(device.joint_names, bodies, terms, device.symmetry)
        super().__init__(replace(device, terms=terms, parameters=parameters, targets=()))
        object.__setattr__(self, "narrow", narrow)

    @cached_property
    def base(self) -> BaseParameters:
        """Those of the model without, then the added terms."""
        own, old = self.narrow.base, len(self.narrow.device.parameters)
        added = range(old, len(self.device.parameters))
        return replace(
            own,
            names=(*own.names, *(self.device.parameters.names[k] for k in added)),
            units=(*own.units, *(self.device.parameters.units[k] for k in added)),
            independent_columns=(*own.independent_columns, *added),
            regrouping=linalg.block_diag(own.regrouping, np.eye(len(added))),
            standard=tuple(self.device.parameters.names),
            lengths=np.append(own.lengths, np.ones(len(added))),
            growth=np.append(own.growth, np.ones(len(added))),
        )
