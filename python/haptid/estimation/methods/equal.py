"""Least squares with relations between parameters that hold exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.expressions import combination
from haptid.device.toml.place import Place
from haptid.dynamics.base_parameters import base_combinations
from haptid.dynamics.model import DynamicModel
from haptid.errors import ContradictionError
from haptid.estimation.knowledge import Knowledge
from haptid.estimation.method import Around, Method, expect_weighting
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation

# Relations off by more than this of their size, where they are met as well as can be, contradict each other.
CONTRADICTION = 1e-9


@dataclass(frozen=True)
class EqualityConstraints(Around):
    """Another method, with relations that hold exactly: a weighed mass, links that are alike.

    Solved on the triangle in the directions that the relations leave free.

    Source: Golub and Van Loan (2013), Matrix Computations, section 6.2.3.

    Attributes:
        relations: combinations of parameters and their values, SI, such as {"M4": 0.35, "ZZ2R - ZZ3R": 0.0}; a
            combination of standard parameters has to be one of base parameters too.
        weighting: how rows are weighted, found without the relations: they stand for the noise.
    """

    relations: Mapping[str, float]
    weighting: Method = field(default_factory=WLS)

    def __post_init__(self) -> None:
        expect_weighting("Equal", self.weighting)
        object.__setattr__(self, "relations", dict(self.relations))

    @property
    def name(self) -> str:
        return f"{self.weighting.name} with {len(self.relations)} relations"

    def knowledge(self, observation: Observation) -> Knowledge:
        """The relations.

        Raises:
            DeviceFileError, ExpressionError, NonlinearTargetError: the text is no combination of parameters.
            UnidentifiableTargetError: it is none of base parameters, so that no torque could tell.
            ContradictionError: they cannot hold together.
        """
        A, b = self._rows(observation.model), np.array(list(self.relations.values()), dtype=float)
        sizes = np.linalg.norm(A, axis=1)
        met = np.linalg.lstsq(A / sizes[:, None], b / sizes, rcond=None)[0]
        off = np.abs(A @ met - b) / (np.abs(A) @ np.abs(met) + np.abs(b) + np.finfo(float).tiny)
        if off.max(initial=0.0) > CONTRADICTION:
            raise ContradictionError(", ".join(f"{k} = {v:g}" for k, v in self.relations.items()), float(off.max()))
        rank = np.linalg.matrix_rank(A / sizes[:, None])
        if rank < len(b):  # told twice: the same relations, each once
            u, values, vt = np.linalg.svd(A / sizes[:, None])
            A, b = vt[:rank], (u[:, :rank].T @ (b / sizes)) / values[:rank]
        return Knowledge(A, b, np.zeros(len(b)))

    def _rows(self, model: DynamicModel) -> Array:
        """Each relation as a combination of base parameters, (relations, p)."""
        base, parameters, made = model.base, model.device.parameters, []
        for text in self.relations:
            row = np.zeros(len(parameters))
            symbols = {*base.names, *parameters.raw}
            for name, factor in combination(text, symbols, {}, Place("Equal", text)).items():
                if name in base.names:
                    row += factor * base.regrouping[base.names.index(name)]
                elif name in parameters.index:
                    row[parameters.index[name]] += factor
            made.append(row)
        return base_combinations(model, list(self.relations), np.array(made).reshape(len(made), -1))
