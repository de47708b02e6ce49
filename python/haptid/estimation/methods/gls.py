"""Generalised least squares: rows of a residual that remembers, made white before they are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimation.fit import Moments, moments
from haptid.estimation.intervals.autoregression import Autoregression, burg, unbroken
from haptid.estimation.least_squares import solve
from haptid.estimation.method import UnitRows
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation
from haptid.observation.rows import Chunk, Rows

# A fit of whitened rows that predicts unseen blocks worse by what chance does so rarely is not to be trusted.
CHANCE = 0.01


@dataclass(frozen=True)
class GLS(UnitRows):
    """Generalised least squares with an autoregressive model of each motor's residual.

    Torque and columns pass the filter that makes the residual white, with the first rows of every stretch kept
    (Prais-Winsten); the model is made anew from the residual of each fit. The order is found by BIC. What is left has
    unit variance, so `Classical()` intervals are the method's own.

    A misfit of the model remembers too, and whitening would fit it where the motion hardly is: at the highest
    frequencies. So the fit has to predict the torque of blocks that it has not seen as well as `WLS()` does: where it
    is worse by more than chance, rows are weighted as there, and not whitened.

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

    def rows(self, observation: Observation) -> Observation:
        """Whitened.

        Raises:
            NoTorqueError: nothing was measured of a motor.
        """
        rows = Rows(observation)
        beta = solve(observation, WLS().weights(observation)).beta
        flat = rows.folded(Whitening(models(rows, beta, 0)))
        for _ in range(self.passes):
            seen = rows.folded(Whitening(models(rows, beta, self.most_order)))
            beta = solve(seen, self.weights(seen)).beta
        return flat if worse(observation, seen, flat) else seen


def worse(observation: Observation, seen: Observation, flat: Observation) -> bool:
    """Whether a fit of whitened rows predicts the observation's blocks worse than one of weighted rows.

    Each block is predicted from all others; a paired t-test over the blocks of time, one-sided, at `CHANCE`.
    """
    weights = WLS().weights(observation)
    more = prediction_errors(observation, weights, seen) - prediction_errors(observation, weights, flat)
    if len(more) < 2 or not more.any():
        return False
    return bool(stats.ttest_1samp(more, 0.0, alternative="greater").pvalue < CHANCE)


def prediction_errors(observation: Observation, weights: Array, seen: Observation) -> Array:
    """Squares of what fits to all other blocks of some rows leave of each block's weighted torque, (blocks,).

    Args:
        observation: whose torque is predicted.
        weights: of each motor's rows in the errors, (motors,).
        seen: the same blocks as the fit sees them, in units of the residual.
    """
    ones = np.ones(len(weights))
    solution = solve(seen, ones)
    made, sums = moments(seen, ones, solution), np.zeros(len(observation.blocks))
    G, s = np.zeros((len(sums), *made.G.shape[1:])), np.zeros((len(sums), made.s.shape[1]))
    np.add.at(G, made.block, made.G)
    np.add.at(s, made.block, made.s)
    beta = solution.beta - Moments(G, s, np.arange(len(sums))).moved @ solution.root.T
    for motor, weight in zip(observation.motors, weights, strict=True):
        T = motor.triangles * weight
        left = T[:, :, -1] - np.einsum("bij,bj->bi", T[:, :, :-1], beta[:, motor.columns])
        sums += (left**2).sum(axis=1)
    return sums


@dataclass(frozen=True, eq=False)
class Whitening:
    """Rows through the filter of each motor's model, stretch by unbroken stretch."""

    models: Sequence[Autoregression]

    def __call__(self, stretch: Chunk) -> Chunk:
        W, y = np.zeros_like(stretch.W), np.zeros_like(stretch.y)
        for k, autoregression in enumerate(self.models):
            reached = np.flatnonzero(stretch.W[k].any(axis=0))
            for run in unbroken(stretch.used[k]):
                W[k, run, reached] = autoregression.whitened(stretch.W[k, run][:, reached]).T
                y[k, run] = autoregression.whitened(stretch.y[k, run])
        return stretch.with_rows(W, y)


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
