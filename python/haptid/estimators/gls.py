"""Generalised least squares: rows of a residual that remembers, made white before they are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from haptid._values import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimators.autoregression import Autoregression, burg, unbroken
from haptid.estimators.solve import solve
from haptid.estimators.wls import WLS
from haptid.observation import Observation
from haptid.rows import Rows, RowStretch


@dataclass(frozen=True)
class GLS:
    """Generalised least squares with an autoregressive model of each motor's residual.

    Torque and columns pass the filter that makes the residual white, with the first rows of every stretch kept
    (Prais-Winsten); the model is made anew from the residual of each fit. The order is found by BIC. What is left has
    unit variance, so `Textbook()` intervals are the method's own.

    Sources: Cochrane and Orcutt (1949), JASA 44; Prais and Winsten (1954), Cowles Commission paper 383.

    Attributes:
        passes: times the models are made from the last fit's residuals.
        most_order: of the models.
    """

    passes: int = 3
    most_order: int = 20

    def __post_init__(self) -> None:
        for name, least in (("passes", 1), ("most_order", 0)):
            value = getattr(self, name)
            if not (whole(value) and value >= least):
                raise MethodSettingError("GLS", name, value, f"a whole number, {least} or more")

    @property
    def name(self) -> str:
        return "GLS"

    @property
    def unit_residual(self) -> bool:
        """Rows are in units of what cannot be foreseen."""
        return True

    def weights(self, observation: Observation) -> Array:
        """Whitened rows have their unit already, (motors,)."""
        return np.ones(len(observation.motors))

    def rows(self, observation: Observation) -> Observation:
        """Whitened.

        Raises:
            NoTorqueError: nothing was measured of a motor.
        """
        rows = Rows(observation)
        beta = solve(observation, WLS().weights(observation)).beta
        for _ in range(self.passes):
            seen = rows.folded(Whitening(models(rows, beta, self.most_order)))
            beta = solve(seen, self.weights(seen)).beta
        return seen


@dataclass(frozen=True, eq=False)
class Whitening:
    """Rows through the filter of each motor's model, stretch by unbroken stretch."""

    models: Sequence[Autoregression]

    def __call__(self, stretch: RowStretch) -> RowStretch:
        W, y = np.zeros_like(stretch.W), np.zeros_like(stretch.y)
        for k, model in enumerate(self.models):
            reached = np.flatnonzero(stretch.W[k].any(axis=0))
            for run in unbroken(stretch.used[k]):
                W[k, run, reached] = model.whitened(stretch.W[k, run][:, reached]).T
                y[k, run] = model.whitened(stretch.y[k, run])
        return replace(stretch, W=W, y=y)


def models(rows: Rows, beta: Array, most_order: int) -> list[Autoregression]:
    """Of every motor's residual; powers are of the residual less what the fit took from it.

    Raises:
        NoTorqueError: nothing was measured of a motor.
    """
    parts: list[list[Array]] = [[] for _ in rows.observation.motors]
    for stretch in rows:
        for own, e, used in zip(parts, stretch.residual(beta), stretch.used, strict=True):
            own.extend(e[run] for run in unbroken(used))
    made = []
    for motor, own in zip(rows.observation.motors, parts, strict=True):
        if motor.norm == 0:
            raise NoTorqueError(motor.name)
        found, n = burg(own, most_order), int(motor.rows.sum())
        floor = (np.finfo(float).eps * motor.norm) ** 2 / n
        taken = n / max(1, n - len(motor.columns))
        made.append(replace(found, powers=np.maximum(found.powers * taken, floor)))
    return made
