"""Robust regression (M-estimation): Huber, Tukey and Student t losses, by iteratively reweighted least squares."""

from __future__ import annotations

from dataclasses import field
from typing import ClassVar, Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation.least_squares import solve
from haptid.estimation.method import UnitVarianceRows, expect_positive, expect_whole
from haptid.estimation.methods.wls import no_torque
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.rows import Chunk, Rows

# Median absolute deviation of a unit normal distribution.
_NORMAL_MAD = 0.6744897501960817
# Convergence: no parameter moves by more than this share of its standard error.
_CONVERGED = 1e-3


class Loss(Protocol):
    """A loss function of residuals u, in standard deviations."""

    @property
    def name(self) -> str:
        """Short name."""

    def weight(self, u: Array) -> Array:
        """psi(u) / u, 0 to 1."""

    def slope(self, u: Array) -> Array:
        """psi'(u)."""


@dataclass(frozen=True)
class Huber:
    """Quadratic near zero, linear beyond k: 95 % efficient where residuals are normal.

    Source: Huber (1964), Annals of Mathematical Statistics 35(1).
    """

    name: ClassVar[str] = "Huber"
    k: float = 1.345

    def __post_init__(self) -> None:
        expect_positive("Huber", "k", self.k)

    def weight(self, u: Array) -> Array:
        """psi(u) / u."""
        return np.asarray(self.k / np.maximum(np.abs(u), self.k))

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        return np.where(np.abs(u) <= self.k, 1.0, 0.0)


@dataclass(frozen=True)
class Tukey:
    """The bisquare: rows beyond c have no weight. It starts from a Huber fit, because it has many local minima.

    Source: Beaton and Tukey (1974), Technometrics 16(2).
    """

    name: ClassVar[str] = "Tukey"
    c: float = 4.685

    def __post_init__(self) -> None:
        expect_positive("Tukey", "c", self.c)

    def weight(self, u: Array) -> Array:
        """psi(u) / u."""
        return np.where(np.abs(u) < self.c, (1.0 - (u / self.c) ** 2) ** 2, 0.0)

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        x = (u / self.c) ** 2
        return np.where(x < 1.0, (1.0 - x) * (1.0 - 5.0 * x), 0.0)


@dataclass(frozen=True)
class StudentT:
    """Maximum likelihood of residuals with Student's t distribution, of a given scale.

    Source: Lange, Little and Taylor (1989), JASA 84.
    """

    name: ClassVar[str] = "Student t"
    dof: float = 4.0

    def __post_init__(self) -> None:
        expect_positive("StudentT", "dof", self.dof)

    def weight(self, u: Array) -> Array:
        """psi(u) / u, one at zero."""
        return np.asarray(self.dof / (self.dof + u**2))

    def slope(self, u: Array) -> Array:
        """psi'(u)."""
        return np.asarray(self.dof * (self.dof - u**2) / (self.dof + u**2) ** 2)


@dataclass(frozen=True)
class IRLS(UnitVarianceRows):
    """Iteratively reweighted least squares: each row weighted by its own residual, each motor by its median one.

    At convergence the rows are replaced by pseudo-values: torque W beta + s psi(u) / m, with m the mean of psi'. Their
    unweighted least squares give the same beta, and the variance of their residual is that of the robust estimate, so
    every covariance estimator applies.

    Sources: Holland and Welsch (1977), Communications in Statistics A6(9); Huber (1981), Robust Statistics, section
    7.6, eqs 6.5 and 8.4 for the pseudo-values.

    Attributes:
        loss: `Tukey()`, `Huber()` or `StudentT()`.
        most: largest number of iterations.
    """

    loss: Loss = field(default_factory=Tukey)
    most: int = 50

    def __post_init__(self) -> None:
        expect_whole("IRLS", "most", self.most, 1)

    @property
    def name(self) -> str:
        return f"IRLS, {self.loss.name}"

    def rows(self, observation: Observation) -> Observation:
        """As pseudo-values.

        Raises:
            IdentifiabilityError: a motor's torque is zero throughout.
        """
        rows = Rows(observation)
        beta = solve(observation, np.array([1.0 / _rms_torque(motor) for motor in observation.motors])).beta
        if isinstance(self.loss, Tukey):
            beta = iterated(rows, Huber(), beta, self.most)
        beta = iterated(rows, self.loss, beta, self.most)
        return rows.folded(PseudoValues(robust_scales(rows, self.loss, beta)))


def _rms_torque(motor: MotorRows) -> float:
    """Root mean square torque; one of a motor without rows, and of a free joint.

    Raises:
        IdentifiabilityError: it is zero.
    """
    if not motor.rows.any() or motor.free:
        return 1.0
    if motor.norm == 0:
        raise no_torque(motor.name)
    return motor.norm / float(np.sqrt(motor.rows.sum()))


def iterated(rows: Rows, loss: Loss, beta: Array, most: int) -> Array:
    """Fixed point of the reweighted fit, (p,)."""
    ones = np.ones(len(rows.observation.motors))
    for _ in range(most):
        solution = solve(rows.folded(Reweighting(robust_scales(rows, loss, beta))), ones)
        moved = np.abs(solution.beta - beta) / np.linalg.norm(solution.root, axis=1)
        beta = solution.beta
        if moved.max() < _CONVERGED:
            break
    return beta


@dataclass(frozen=True, eq=False)
class RobustScales:
    """Robust scales of the residuals of some parameters, motor by motor.

    Attributes:
        loss: the loss function.
        beta: the parameters, (p,).
        scale: standard deviation s of each motor's residual, (motors,).
        gain: one over the mean of psi', (motors,).
        unit: standard deviation of gain s psi(u), (motors,).
    """

    loss: Loss
    beta: Array
    scale: Array
    gain: Array
    unit: Array

    def weights(self, e: Array) -> Array:
        """psi(u) / u of residuals, (motors, rows)."""
        return self.loss.weight(e / self.scale[:, None])


def robust_scales(rows: Rows, loss: Loss, beta: Array) -> RobustScales:
    """Scale by the median absolute deviation, gain and unit by Huber (1981), eq. 7.6.5; rounding's in an exact fit.

    One of a motor without rows.
    """
    scale, gain, unit = list[float](), list[float](), list[float]()
    for e, motor in zip(rows.residuals(beta), rows.observation.motors, strict=True):
        if not motor.rows.any():
            for figures in (scale, gain, unit):
                figures.append(1.0)
            continue
        s = max(float(np.median(np.abs(e))) / _NORMAL_MAD, np.finfo(float).eps * _rms_torque(motor))
        u = e / s
        mean_slope = float(np.mean(loss.slope(u)))
        power = float(np.sum((loss.weight(u) * u) ** 2)) / max(1, len(u) - len(motor.columns))
        scale.append(s)
        gain.append(1.0 / mean_slope)
        unit.append(s * max(np.sqrt(power), np.finfo(float).eps) / mean_slope)
    return RobustScales(loss, beta, np.array(scale), np.array(gain), np.array(unit))


@dataclass(frozen=True, eq=False)
class Reweighting:
    """Row transformation: rows times the square root of their weights, motors scaled as their pseudo-values are."""

    scales: RobustScales

    def __call__(self, chunk: Chunk) -> Chunk:
        weights = self.scales.weights(chunk.residual(self.scales.beta))
        return chunk.scaled(np.sqrt(weights * self.scales.gain[:, None]) / self.scales.unit[:, None])


@dataclass(frozen=True, eq=False)
class PseudoValues:
    """Row transformation: torque W beta + gain s psi(u), and columns, in units of each motor's `unit`."""

    scales: RobustScales

    def __call__(self, chunk: Chunk) -> Chunk:
        e = chunk.residual(self.scales.beta)
        pseudo = e * self.scales.weights(e) * self.scales.gain[:, None]
        values = chunk.with_rows(chunk.W, np.where(chunk.used, chunk.y - e + pseudo, 0.0))
        return values.scaled(np.broadcast_to(1.0 / self.scales.unit[:, None], e.shape))
