"""Robust least squares: rows that do not fit the others count less, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimation.least_squares import solve
from haptid.estimation.method import UnitRows
from haptid.estimation.methods.robust import Huber, Loss, Tukey
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.rows import Chunk, Rows

# Median absolute deviation of a unit normal distribution.
NORMAL_MAD = 0.6744897501960817
# Passes end where no parameter moves by more than this share of its deviation.
SETTLED = 1e-3


@dataclass(frozen=True)
class IRLS(UnitRows):
    """Iteratively reweighted least squares: each row weighted by its own residual, each motor by its median one.

    Once the weights have settled the rows are folded as pseudo-values: torque W beta + s psi(u) / m, with m the mean
    of psi'. Their plain least squares are the same beta, and the variance of their residual is that of the robust
    estimate, so that intervals need nothing of their own.

    Sources: Holland and Welsch (1977), Communications in Statistics A6(9); Huber (1981), Robust Statistics, section
    7.6, eqs 6.5 and 8.4 for the pseudo-values.

    Attributes:
        loss: `Tukey()`, `Huber()` or `StudentT()`.
        most: passes at most.
    """

    loss: Loss = field(default_factory=Tukey)
    most: int = 50

    def __post_init__(self) -> None:
        if not (whole(self.most) and self.most >= 1):
            raise MethodSettingError("IRLS", "most", self.most, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return f"IRLS, {self.loss.name}"

    def rows(self, observation: Observation) -> Observation:
        """As pseudo-values.

        Raises:
            NoTorqueError: nothing was measured of a motor.
        """
        rows = Rows(observation)
        beta = solve(observation, np.array([1.0 / _deviation(motor) for motor in observation.motors])).beta
        if isinstance(self.loss, Tukey):
            beta = settled(rows, Huber(), beta, self.most)
        beta = settled(rows, self.loss, beta, self.most)
        return rows.folded(PseudoValues(judged(rows, self.loss, beta)))


def _deviation(motor: MotorRows) -> float:
    """Root mean square torque.

    Raises:
        NoTorqueError: nothing was measured.
    """
    if motor.norm == 0:
        raise NoTorqueError(motor.name)
    return motor.norm / float(np.sqrt(motor.rows.sum()))


def settled(rows: Rows, loss: Loss, beta: Array, most: int) -> Array:
    """Parameters whose weights give them back, (p,)."""
    ones = np.ones(len(rows.observation.motors))
    for _ in range(most):
        found = solve(rows.folded(Reweighting(judged(rows, loss, beta))), ones)
        moved = np.abs(found.beta - beta) / np.linalg.norm(found.root, axis=1)
        beta = found.beta
        if moved.max() < SETTLED:
            break
    return beta


@dataclass(frozen=True, eq=False)
class Judged:
    """What a loss makes of the residuals of some parameters.

    Attributes:
        loss: the loss.
        beta: the parameters, (p,).
        scale: deviation s of each motor's residual, (motors,).
        gain: one over the mean of psi', (motors,).
        unit: deviation of gain s psi(u), (motors,).
    """

    loss: Loss
    beta: Array
    scale: Array
    gain: Array
    unit: Array

    def weights(self, e: Array) -> Array:
        """psi(u) / u of residuals, (motors, rows)."""
        return self.loss.weight(e / self.scale[:, None])


def judged(rows: Rows, loss: Loss, beta: Array) -> Judged:
    """Scale by the median absolute deviation, gain and unit by Huber (1981), eq. 7.6.5; rounding's in an exact fit."""
    scale, gain, unit = [], [], []
    for e, motor in zip(rows.residuals(beta), rows.observation.motors, strict=True):
        s = max(float(np.median(np.abs(e))) / NORMAL_MAD, np.finfo(float).eps * _deviation(motor))
        u = e / s
        mean_slope = float(np.mean(loss.slope(u)))
        power = float(np.sum((loss.weight(u) * u) ** 2)) / max(1, len(u) - len(motor.columns))
        scale.append(s)
        gain.append(1.0 / mean_slope)
        unit.append(s * max(np.sqrt(power), np.finfo(float).eps) / mean_slope)
    return Judged(loss, beta, np.array(scale), np.array(gain), np.array(unit))


@dataclass(frozen=True, eq=False)
class Reweighting:
    """Rows multiplied by the root of their weights, motors as their pseudo-values are."""

    judged: Judged

    def __call__(self, stretch: Chunk) -> Chunk:
        weights = self.judged.weights(stretch.residual(self.judged.beta))
        return stretch.scaled(np.sqrt(weights * self.judged.gain[:, None]) / self.judged.unit[:, None])


@dataclass(frozen=True, eq=False)
class PseudoValues:
    """Torque W beta + gain s psi(u), and columns, in units of each motor's `unit`."""

    judged: Judged

    def __call__(self, stretch: Chunk) -> Chunk:
        e = stretch.residual(self.judged.beta)
        kept = e * self.judged.weights(e) * self.judged.gain[:, None]
        made = stretch.with_rows(stretch.W, np.where(stretch.used, stretch.y - e + kept, 0.0))
        return made.scaled(np.broadcast_to(1.0 / self.judged.unit[:, None], e.shape))
