"""Generalised least squares: correlation across motors (SUR, torque noise) and in time (GLS, autoregressive)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation.block_moments import BlockMoments
from haptid.estimation.intervals.model_based import Autoregression, burg, residual_runs, runs_of
from haptid.estimation.least_squares import solve
from haptid.estimation.method import Fit, UnitVarianceRows, expect_motors, expect_whole
from haptid.estimation.methods.wls import WLS, FeasibleGLS
from haptid.motion.channels import channel_shares
from haptid.observation.observation import Observation
from haptid.observation.rows import Chunk, Rows
from haptid.uncertainty.distributions import t_tail

# Significance level of the test whether whitened rows predict unseen blocks worse than weighted ones.
_SIGNIFICANCE = 0.01
# Largest correlation of two motors' residuals, so that their covariance stays well-conditioned.
MAX_CORRELATION = 0.999
# Steps of expectation maximisation of the channels' variances, the relative change at which it stops, and the least
# variance as a share of that of the least-squares distribution.
_STEPS = 200
_SETTLED = 1e-4
_LEAST_SHARE = 1e-4


@dataclass(frozen=True)
class SUR(FeasibleGLS):
    """Seemingly unrelated regressions: rows of one instant weighted by the inverse of their residuals' covariance.

    The rows of an instant are multiplied by the inverse Cholesky factor of that covariance, so they are white across
    motors, and what holds for `WLS` holds for them.

    Source: Zellner (1962), JASA 57, eqs 2.5 to 2.9.
    """

    name: ClassVar[str] = "SUR"
    mixes_motors: ClassVar[bool] = True

    def factor(self, rows: Rows, beta: Array, before: Decorrelation | None) -> Decorrelation:  # noqa: ARG002
        """The rows of each instant decorrelated across motors."""
        return Decorrelation(covariance(rows, beta))


@dataclass(frozen=True)
class TorqueNoise(FeasibleGLS):
    """Generalised least squares with the covariance B' Sigma B of independent errors of the torque channels.

    Rows that mix channels, such as those of redundant or coupled motors, have correlated errors whose covariance
    varies with the pose. The rows of an instant are multiplied by the inverse Cholesky factor of theirs. The variances
    of the channels (the diagonal of Sigma) are found from the residuals by expectation maximisation, where they can be
    distinguished; where they cannot, they stay in the proportions of the distribution with least sum of squares.

    Source: Dempster, Laird and Rubin (1977), J. Royal Statistical Society B 39(1), section 4.4 (variance components).
    """

    name: ClassVar[str] = "GLS, torque noise"
    mixes_motors: ClassVar[bool] = True
    passes: int = 3

    def factor(self, rows: Rows, beta: Array, before: ChannelWhitening | None) -> ChannelWhitening:  # noqa: ARG002
        """The rows of each instant decorrelated, by the channels' variances."""
        expect_motors(self.name, rows.observation)
        return ChannelWhitening(channel_variances(rows, beta))


@dataclass(frozen=True, eq=False)
class ChannelWhitening:
    """Row transformation: the rows of each instant times the inverse Cholesky factor of B' Sigma B.

    Attributes:
        variances: diagonal of Sigma, (channels,), (N m)^2 or N^2.
    """

    variances: Array

    def __call__(self, chunk: Chunk) -> Chunk:
        B = _used_shares(chunk)
        factor = np.linalg.cholesky(_row_covariances(B, self.variances, chunk.used))
        augmented = np.concatenate([chunk.W, chunk.y[:, :, None]], axis=2) * chunk.used[:, :, None]
        white = np.linalg.solve(factor, augmented.transpose(1, 0, 2)).transpose(1, 0, 2)
        return chunk.with_rows(np.ascontiguousarray(white[..., :-1]), np.ascontiguousarray(white[..., -1]))


def _used_shares(chunk: Chunk) -> Array:
    """B of the torque channels by the rows, (instants, channels, rows); zero for rows that are not used."""
    B = channel_shares(chunk.model.device, chunk.plan.motion, chunk.centres(chunk.c))[:, :, list(chunk.coordinates)]
    return np.asarray(B * chunk.used.T[:, None, :])


def _row_covariances(B: Array, variances: Array, used: np.ndarray) -> Array:
    """B' Sigma B of every instant, (instants, rows, rows), with ones on the diagonal for rows that are not used."""
    covariances = np.swapaxes(B, 1, 2) @ (B * variances[:, None])
    rows = np.arange(B.shape[2])
    covariances[:, rows, rows] += ~used.T
    return np.asarray(covariances)


def channel_variances(rows: Rows, beta: Array) -> Array:
    """Variance of every torque channel from the residuals of the rows, (channels,), (N m)^2 or N^2.

    Expectation maximisation: at each instant the channels' errors e have mean K r and covariance Sigma - K B' Sigma
    given the rows' residual r = B' e, with K = Sigma B (B' Sigma B)^-1.
    """
    chunks = list(rows)
    B = np.concatenate([_used_shares(chunk) for chunk in chunks])
    used = np.concatenate([chunk.used for chunk in chunks], axis=1)
    r = np.concatenate([chunk.residual(beta) for chunk in chunks], axis=1).T * used.T
    count = int(used.any(axis=0).sum())
    floor: Array | None = None
    variances = np.ones(B.shape[1])
    for step in range(_STEPS):
        scaled = B * variances[:, None]
        K = np.linalg.solve(_row_covariances(B, variances, used), np.swapaxes(scaled, 1, 2))
        total = (np.einsum("src,sr->sc", K, r) ** 2).sum(axis=0)
        if step:
            total += variances * count - np.einsum("scr,src->c", scaled, K)
        before, variances = variances, total / count
        if floor is None:  # of least squares; a channel that loads no row keeps its proportion
            floor = _LEAST_SHARE * np.maximum(variances, variances.max() * np.finfo(float).eps)
        variances = np.maximum(variances, floor)
        if np.abs(variances - before).max() < _SETTLED * variances.max():
            break
    many = rows.observation.rows
    return np.asarray(variances * many / max(1, many - len(beta)))


@dataclass(frozen=True, eq=False)
class Decorrelation:
    """Row transformation: the rows of each instant times the inverse Cholesky factor of (motors, motors)."""

    covariance: Array

    def __call__(self, chunk: Chunk) -> Chunk:
        W, y = np.zeros_like(chunk.W), np.zeros_like(chunk.y)
        patterns, pattern_of = np.unique(chunk.used, axis=1, return_inverse=True)
        for number, pattern in enumerate(patterns.T):
            motors, times = np.flatnonzero(pattern), np.flatnonzero(pattern_of.ravel() == number)
            if not len(motors):
                continue
            mix = np.linalg.inv(np.linalg.cholesky(self.covariance[np.ix_(motors, motors)]))
            cells = np.ix_(motors, times)
            W[cells], y[cells] = np.einsum("ij,jrp->irp", mix, chunk.W[cells]), mix @ chunk.y[cells]
        return chunk.with_rows(W, y)


def covariance(rows: Rows, beta: Array) -> Array:
    """Covariance of all motors' residuals at one instant, (motors, motors), from the instants used of both motors."""
    motors = rows.observation.motors
    products, pairs = np.zeros((len(motors),) * 2), np.zeros((len(motors),) * 2)
    for chunk in rows:
        e = chunk.residual(beta)
        products += e @ e.T
        pairs += chunk.used.astype(float) @ chunk.used.T
    # Standard deviations are those of WLS; correlations come from pairs. A motor that fits exactly has none.
    se = np.array([1.0 / WLS().weight(motor, beta) for motor in motors])
    raw = np.sqrt(np.diag(products) / np.maximum(np.diag(pairs), 1.0))
    scale = np.outer(raw, raw) * np.maximum(pairs, 1.0)
    correlation = np.divide(products, scale, out=np.zeros_like(products), where=scale > 0)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(np.outer(se, se) * nearest_correlation(correlation))


def nearest_correlation(C: Array) -> Array:
    """A positive definite correlation matrix near C, which is indefinite where pairs come from different instants."""
    values, vectors = np.linalg.eigh(C)
    positive = (vectors * np.maximum(values, 1.0 - MAX_CORRELATION)) @ vectors.T
    sizes = np.sqrt(np.diag(positive))
    return np.asarray(positive / np.outer(sizes, sizes))


@dataclass(frozen=True)
class GLS(UnitVarianceRows):
    """Generalised least squares with an autoregressive model of each motor's residual.

    Torque and columns pass the filter that whitens the residual, with the first rows of every chunk kept
    (Prais-Winsten); the model is estimated again from the residual of each fit, its order by BIC. The whitened
    residual has unit variance, so `Classical()` intervals are the method's own.

    An error of the model is serially correlated too, and whitening would then fit it at the highest frequencies, where
    the motion has least power. So the fit has to predict the torque of unseen blocks as well as `WLS()` does: where it
    is significantly worse, rows are weighted by motor and not whitened.

    Sources: Cochrane and Orcutt (1949), JASA 44; Prais and Winsten (1954), Cowles Commission paper 383.

    Attributes:
        passes: how often the models are estimated from the residuals of the last fit.
        most_order: largest order of the models.
    """

    name: ClassVar[str] = "GLS"
    passes: int = 3
    most_order: int = 20

    def __post_init__(self) -> None:
        expect_whole("GLS", "passes", self.passes, 1)
        expect_whole("GLS", "most_order", self.most_order, 0)

    def rows(self, observation: Observation) -> Observation:
        """Whitened in time.

        Raises:
            IdentifiabilityError: a motor's torque is zero throughout.
        """
        rows = Rows(observation)
        beta = solve(observation, WLS().weights(observation)).beta
        flat = rows.folded(Whitening(residual_models(rows, beta, 0)))
        for _ in range(self.passes):
            whitened = rows.folded(Whitening(residual_models(rows, beta, self.most_order)))
            beta = solve(whitened, self.weights(whitened)).beta
        return flat if predicts_worse(observation, whitened, flat) else whitened


def predicts_worse(observation: Observation, whitened: Observation, flat: Observation) -> bool:
    """Whether a fit of whitened rows predicts the observation's blocks worse than one of weighted rows.

    Each block is predicted from all others; a paired one-sided t-test over the blocks of time, at `SIGNIFICANCE`.
    """
    weights = WLS().weights(observation)
    excess = prediction_errors(observation, weights, whitened) - prediction_errors(observation, weights, flat)
    if len(excess) < 2 or not excess.any():
        return False
    t = np.sqrt(len(excess)) * excess.mean() / excess.std(ddof=1)
    return bool(t_tail(t, len(excess) - 1) < _SIGNIFICANCE)


def prediction_errors(observation: Observation, weights: Array, whitened: Observation) -> Array:
    """Leave-one-block-out cross-validation: squared weighted prediction error of each block, (blocks,).

    Args:
        observation: whose torque is predicted.
        weights: of each motor's rows in the errors, (motors,).
        whitened: the same blocks as the fit sees them, scaled to unit variance.
    """
    ones = np.ones(len(weights))
    solution = solve(whitened, ones)
    moments, sums = Fit(whitened, ones, solution, True).moments, np.zeros(len(observation.blocks))
    G, s = np.zeros((len(sums), *moments.G.shape[1:])), np.zeros((len(sums), moments.s.shape[1]))
    np.add.at(G, moments.block, moments.G)
    np.add.at(s, moments.block, moments.s)
    beta = solution.beta - BlockMoments(G, s, np.arange(len(sums))).leave_out_shifts @ solution.root.T
    for motor, weight in zip(observation.motors, weights, strict=True):
        T = motor.r_factors * weight
        errors = T[:, :, -1] - np.einsum("bij,bj->bi", T[:, :, :-1], beta[:, motor.columns])
        sums += (errors**2).sum(axis=1)
    return sums


@dataclass(frozen=True, eq=False)
class Whitening:
    """Row transformation: rows filtered by each motor's autoregressive model, one unbroken run at a time.

    Attributes:
        models: of the motors.
        stride: rows from one to the next that a model relates.
    """

    models: Sequence[Autoregression]
    stride: int = 1

    def __call__(self, chunk: Chunk) -> Chunk:
        W, y = np.zeros_like(chunk.W), np.zeros_like(chunk.y)
        for k, autoregression in enumerate(self.models):
            reached = np.flatnonzero(chunk.W[k].any(axis=0))
            for run in runs_of(chunk.used[k], self.stride):
                W[k, run, reached] = autoregression.whitened(chunk.W[k, run][:, reached]).T
                y[k, run] = autoregression.whitened(chunk.y[k, run])
        return chunk.with_rows(W, y)


def residual_models(rows: Rows, beta: Array, most_order: int, stride: int = 1) -> list[Autoregression]:
    """Autoregressive model of every motor's residual; powers are corrected for the degrees of freedom of the fit.

    That of white noise of unit variance for a motor without rows.
    """
    models = []
    for motor, own in zip(rows.observation.motors, residual_runs(rows, beta, stride), strict=True):
        if not motor.rows.any():
            models.append(Autoregression((np.ones(1),), np.ones(1)))
            continue
        found, n = burg(own, most_order), int(motor.rows.sum())
        floor = (np.finfo(float).eps * motor.norm) ** 2 / n
        per_dof = n / max(1, n - len(motor.columns))
        models.append(replace(found, powers=np.maximum(found.powers * per_dof, floor)))
    return models
