"""Robust least squares: rows that do not fit the others count less, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from haptid._values import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimators.robust import Huber, Loss, Tukey
from haptid.estimators.solve import solve
from haptid.observation import MotorRows, Observation
from haptid.rows import Rows, RowStretch

# Median absolute deviation of a unit normal distribution.
NORMAL_MAD = 0.6744897501960817
# Passes end where no parameter moves by more than this share of its deviation.
SETTLED = 1e-6


@dataclass(frozen=True)
class IRLS:
    """Iteratively reweighted least squares: each row weighted by its own residual, each motor by its median one.

    Once the weights have settled the rows are folded as pseudo-values: torque W beta + s psi(u) / m, with m the mean
    of psi'. Their plain least squares are the same beta, and the variance of their residual is that of the robust
    estimate, so that intervals need nothing of their own.

    Sources: Holland and Welsch (1977), Communications in Statistics A6(9); Huber (1981), Robust Statistics, section
    7.6, eqs 6.5 and 8.4 for the pseudo-values.

    Attributes:
        loss: `Huber()`, `Tukey()` or `StudentT()`.
        most: passes at most.
    """

    loss: Loss = field(default_factory=Tukey)
    most: int = 100

    def __post_init__(self) -> None:
        if not (whole(self.most) and self.most >= 1):
            raise MethodSettingError("IRLS", "most", self.most, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return f"IRLS, {self.loss.name}"

    @property
    def unit_residual(self) -> bool:
        """Rows are in units of the pseudo-values' own deviation."""
        return True

    def weights(self, observation: Observation) -> Array:
        """Rows have their unit already, (motors,)."""
        return np.ones(len(observation.motors))

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
        return rows.folded(pseudo_values(rows, self.loss, beta))


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
        found = solve(rows.folded(Reweighting(loss, beta, scales(rows, beta))), ones)
        moved = np.abs(found.beta - beta) / np.linalg.norm(found.root, axis=1)
        beta = found.beta
        if moved.max() < SETTLED:
            break
    return beta


def scales(rows: Rows, beta: Array) -> Array:
    """Deviation of each motor's residual from its median size, (motors,); of an exact fit rounding's."""
    made = [float(np.median(np.abs(e))) / NORMAL_MAD for e in rows.residuals(beta)]
    floors = [np.finfo(float).eps * _deviation(motor) for motor in rows.observation.motors]
    return np.maximum(made, floors)


@dataclass(frozen=True, eq=False)
class Reweighting:
    """Rows multiplied by the root of their weights, in each motor's unit."""

    loss: Loss
    beta: Array
    scale: Array

    def __call__(self, stretch: RowStretch) -> RowStretch:
        u = stretch.residual(self.beta) / self.scale[:, None]
        return stretch.scaled(np.sqrt(self.loss.weight(u)) / self.scale[:, None])


@dataclass(frozen=True, eq=False)
class PseudoValues:
    """Torque W beta + gain s psi(u) in units of each motor's `unit`; columns in the same units."""

    loss: Loss
    beta: Array
    scale: Array
    gain: Array
    unit: Array

    def __call__(self, stretch: RowStretch) -> RowStretch:
        e = stretch.residual(self.beta)
        kept = e * self.loss.weight(e / self.scale[:, None]) * self.gain[:, None]
        made = replace(stretch, y=np.where(stretch.used, stretch.y - e + kept, 0.0))
        return made.scaled(np.broadcast_to(1.0 / self.unit[:, None], e.shape))


def pseudo_values(rows: Rows, loss: Loss, beta: Array) -> PseudoValues:
    """With the gain and the deviation of every motor's residual (Huber 1981, eq. 7.6.5)."""
    scale, gain, unit = scales(rows, beta), [], []
    for s, e, motor in zip(scale, rows.residuals(beta), rows.observation.motors, strict=True):
        u = e / s
        mean_slope = float(np.mean(loss.slope(u)))
        power = float(np.sum((loss.weight(u) * u) ** 2)) / max(1, len(u) - len(motor.columns))
        gain.append(1.0 / mean_slope)
        unit.append(s * max(np.sqrt(power), np.finfo(float).eps) / mean_slope)
    return PseudoValues(loss, beta, scale, np.array(gain), np.array(unit))
