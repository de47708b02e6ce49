"""Weighted least squares with the covariance of all motors' residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimation.least_squares import solve
from haptid.estimation.method import UnitRows
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation
from haptid.observation.rows import Chunk, Rows

# Of two motors whose residuals go wholly together one tells nothing new: correlations are held below this.
MOST_CORRELATED = 0.999


@dataclass(frozen=True)
class SUR(UnitRows):
    """Seemingly unrelated regressions: rows of one instant weighed by the inverse of their residuals' covariance.

    The rows of an instant are replaced by each motor's less what the motors before it foretell of its residual, in
    units of what is left: they are white across motors, so all that holds for `WLS` holds for them.

    Source: Zellner (1962), JASA 57, eqs 2.5 to 2.9.

    Attributes:
        passes: times the covariance is made from the last fit's residuals.
    """

    passes: int = 2

    def __post_init__(self) -> None:
        if not (whole(self.passes) and self.passes >= 1):
            raise MethodSettingError("SUR", "passes", self.passes, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return "SUR"

    def rows(self, observation: Observation) -> Observation:
        """Each motor's less what the motors before it foretell.

        Raises:
            NoTorqueError: nothing was measured of a motor.
        """
        rows = Rows(observation)
        beta = solve(observation, WLS().weights(observation)).beta
        before = [observation.motors[: k + 1] for k in range(len(observation.motors))]
        columns = [np.unique(np.concatenate([motor.columns for motor in some])) for some in before]
        for _ in range(self.passes):
            seen = rows.folded(Unmixing(covariance(rows, beta)), columns)
            beta = solve(seen, self.weights(seen)).beta
        return seen


@dataclass(frozen=True, eq=False)
class Unmixing:
    """The rows of each instant times the inverse of the Cholesky factor of their covariance, (motors, motors)."""

    covariance: Array

    def __call__(self, stretch: Chunk) -> Chunk:
        W, y = np.zeros_like(stretch.W), np.zeros_like(stretch.y)
        patterns, which = np.unique(stretch.used, axis=1, return_inverse=True)
        for number, pattern in enumerate(patterns.T):
            motors, at = np.flatnonzero(pattern), np.flatnonzero(which.ravel() == number)
            if not len(motors):
                continue
            mix = np.linalg.inv(np.linalg.cholesky(self.covariance[np.ix_(motors, motors)]))
            here = np.ix_(motors, at)
            W[here], y[here] = np.einsum("ij,jrp->irp", mix, stretch.W[here]), mix @ stretch.y[here]
        return stretch.with_rows(W, y)


def covariance(rows: Rows, beta: Array) -> Array:
    """Of all motors' residuals at one instant, (motors, motors), from the instants at which both of a pair count.

    Raises:
        NoTorqueError: nothing was measured of a motor.
    """
    motors = rows.observation.motors
    products, pairs = np.zeros((len(motors),) * 2), np.zeros((len(motors),) * 2)
    for stretch in rows:
        e = stretch.residual(beta)
        products += e @ e.T
        pairs += stretch.used.astype(float) @ stretch.used.T
    for motor in motors:
        if motor.norm == 0:
            raise NoTorqueError(motor.name)
    # Of each motor what WLS takes; correlations from pairs. A motor that fits exactly has none.
    se = np.array([1.0 / WLS().weight(motor, beta) for motor in motors])
    raw = np.sqrt(np.diag(products) / np.diag(pairs))
    scale = np.outer(raw, raw) * np.maximum(pairs, 1.0)
    correlation = np.divide(products, scale, out=np.zeros_like(products), where=scale > 0)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(np.outer(se, se) * nearest_correlation(correlation))


def nearest_correlation(C: Array) -> Array:
    """A correlation matrix that can be inverted: pairs of different instants may give one that is none."""
    values, vectors = np.linalg.eigh(C)
    made = (vectors * np.maximum(values, 1.0 - MOST_CORRELATED)) @ vectors.T
    sizes = np.sqrt(np.diag(made))
    return np.asarray(made / np.outer(sizes, sizes))
