"""Least squares with weights: ordinary (OLS), weighted by motor (WLS), and with a variance function."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.errors import IdentifiabilityError
from haptid.estimation.least_squares import solve
from haptid.estimation.method import FREE_SHARE, Method, UnitVarianceRows, expect_whole
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.rows import Chunk, Rows

# Fisher scoring steps for the variance function in each pass; the next pass continues from there.
SCORING_STEPS = 20
# Largest change of the logarithm of a variance in one step.
LARGEST_STEP = 2.0
# Range of log variances around that of the motor, so that a few rows that fit exactly do not take all the weight.
LOG_RANGE = 6.0


def no_torque(motor: str) -> IdentifiabilityError:
    """The error for a motor whose treated torque is zero throughout."""
    return IdentifiabilityError(
        f"the treated torque of motor {motor} is zero in every row, so its rows cannot be weighted by their residual.",
        where=motor,
        found=0.0,
        advice="Map the channel that holds its torque, or estimate with OLS.",
    )


@dataclass(frozen=True)
class OLS:
    """Ordinary least squares, all motors' rows weighted alike.

    Source: Janot et al. (2007), ISIE, eqs 13 to 17.
    """

    name: ClassVar[str] = "OLS"

    unit_residual: ClassVar[bool] = False

    def weights(self, observation: Observation) -> Array:
        """One for every motor, (motors,)."""
        return np.ones(len(observation.motors))


@dataclass(frozen=True)
class WLS:
    """Weighted least squares: each motor's rows are divided by the standard deviation of that motor's residual.

    Source: Gautier and Poignet (2001), Control Engineering Practice 9(12).

    Attributes:
        passes: how often the weights are computed from the residuals of the last fit.
    """

    name: ClassVar[str] = "WLS"
    passes: int = 2

    def __post_init__(self) -> None:
        expect_whole("WLS", "passes", self.passes, 1)

    unit_residual: ClassVar[bool] = True

    def weights(self, observation: Observation, zero: Sequence[int] = ()) -> Array:
        """One over the standard deviation of each motor's residual, (motors,), 1/(N m) or 1/N.

        Args:
            observation: rows.
            zero: base parameters that the fits leave out, by index.
        """
        weights = np.ones(len(observation.motors))
        for _ in range(self.passes):
            beta = solve(observation, weights, zero).beta
            weights = np.array([self.weight(motor, beta) for motor in observation.motors])
        return weights

    def weight(self, motor: MotorRows, beta: Array) -> float:
        """One over the standard deviation of one motor's residual, which is not below the rounding of its channel.

        One for a motor without rows. That of a free joint is less, by `FREE_SHARE`, and goes by the noise of its rows
        alone, not by what a wrong model of the motors leaves in them: that made the weight less the more it was needed.

        Raises:
            IdentifiabilityError: the motor's torque is zero throughout.
        """
        if not motor.rows.any():
            return 1.0
        size = motor.size(beta)
        if size == 0:
            if motor.free:  # nothing is known of its terms yet
                return 1.0
            raise no_torque(motor.name)
        dof = max(1, int(motor.rows.sum()) - len(motor.columns))
        floor = max(np.finfo(float).eps * size / np.sqrt(dof), motor.rounding)
        left = motor.own_residual(beta) if motor.free else motor.residual(beta)
        return float((FREE_SHARE if motor.free else 1.0) / max(left / np.sqrt(dof), floor))


def weights_without(
    weighting: Method, observation: Observation, left_out: Callable[[Observation], Sequence[int]]
) -> Array:
    """Weights of the motors' rows, (motors,); of `WLS` by fits without some parameters where the rows do not tell all.

    Args:
        weighting: of the rows.
        observation: rows.
        left_out: gives the base parameters to leave out, by index.

    Raises:
        IdentifiabilityError: another method's fits need what the rows do not tell.
    """
    try:
        return weighting.weights(observation)
    except IdentifiabilityError:
        if not isinstance(weighting, WLS):
            raise
        return weighting.weights(observation, left_out(observation))


@dataclass(frozen=True)
class FeasibleGLS(UnitVarianceRows, ABC):
    """Base of methods that multiply the rows by a factor that is estimated from the residuals of the last fit.

    Attributes:
        passes: how often the factor is estimated; the first residuals are those of `WLS`.
    """

    mixes_motors: ClassVar[bool] = False
    passes: int = 2

    def __post_init__(self) -> None:
        expect_whole(type(self).__name__, "passes", self.passes, 1)

    @abstractmethod
    def factor(self, rows: Rows, beta: Array, before: Any) -> Callable[[Chunk], Chunk]:
        """The row transformation for the residuals of parameters (p,); `before` is that of the pass before, or None."""

    def rows(self, observation: Observation) -> Observation:
        """The transformed rows, of unit variance.

        Raises:
            IdentifiabilityError: a motor's torque is zero throughout.
        """
        columns = None
        if self.mixes_motors:
            before = [observation.motors[: k + 1] for k in range(len(observation.motors))]
            columns = [np.unique(np.concatenate([motor.columns for motor in some])) for some in before]
        rows, beta = Rows(observation), solve(observation, WLS().weights(observation)).beta
        factor = None
        for _ in range(self.passes):
            factor = self.factor(rows, beta, factor)
            weighted = rows.folded(factor, columns)
            beta = solve(weighted, self.weights(weighted)).beta
        return weighted


@dataclass(frozen=True)
class Heteroscedastic(FeasibleGLS):
    """Maximum likelihood with a variance that depends on speed and load, motor by motor.

    log sigma^2 = a0 + a1 |v| / v_rms + a2 |load| / load_rms, where the load is the model's torque. Parameters and
    variances are estimated in turn, the variances by Fisher scoring; every row is then divided by its own standard
    deviation.

    Source: Harvey (1976), Econometrica 44(3), eqs 3 and 12.
    """

    name: ClassVar[str] = "heteroscedastic ML"
    passes: int = 5

    def factor(self, rows: Rows, beta: Array, before: VarianceFunction | None) -> VarianceFunction:
        """Each row divided by its own standard deviation."""
        return variance_function(rows, beta, before)


@dataclass(frozen=True, eq=False)
class VarianceFunction:
    """Row transformation: each row divided by its own standard deviation.

    Attributes:
        a: of log sigma^2 on one, speed and load, both divided by their root mean squares, (motors, 3).
        speed, load: the root mean squares, (motors,).
        beta: of the model that gives the load, (p,).
    """

    a: Array
    speed: Array
    load: Array
    beta: Array

    def __call__(self, chunk: Chunk) -> Chunk:
        return chunk.scaled(np.where(chunk.used, np.exp(-0.5 * self.log_variances(chunk)), 0.0))

    def log_variances(self, chunk: Chunk) -> Array:
        """log sigma^2 of all rows, (motors, rows)."""
        Z = variance_regressors(chunk, self.speed, self.load, self.beta)
        logs = np.einsum("mrk,mk->mr", Z, self.a)
        middle = self.a @ np.array([1.0, 1.0, 1.0])
        return np.asarray(np.clip(logs, middle[:, None] - LOG_RANGE, middle[:, None] + LOG_RANGE))


def variance_regressors(chunk: Chunk, speed: Array, load: Array, beta: Array) -> Array:
    """One, speed and load, divided by their root mean squares, (motors, rows, 3)."""
    torque = np.abs(chunk.W @ beta) / load[:, None]
    return np.stack([np.ones_like(torque), np.abs(chunk.velocity) / speed[:, None], torque], axis=2)


def variance_function(rows: Rows, beta: Array, before: VarianceFunction | None) -> VarianceFunction:
    """The maximum-likelihood variance function for the residuals of given parameters."""
    motors = rows.observation.motors
    speed, load = rms_speed_and_load(rows, beta)
    a = np.zeros((len(motors), 3)) if before is None else np.array(before.a)
    if before is None:
        a[:, 0] = [-2.0 * np.log(WLS().weight(motor, beta)) for motor in motors]
    parts: list[list[tuple[Array, Array]]] = [[] for _ in motors]
    for chunk in rows:
        Z, e = variance_regressors(chunk, speed, load, beta), chunk.residual(beta)
        for k, used in enumerate(chunk.used):
            parts[k].append((Z[k, used], e[k, used]))
    for k, own in enumerate(parts):
        if not motors[k].rows.any():
            continue
        Z, e = (np.concatenate(arrays) for arrays in zip(*own, strict=True))
        squares = e**2 * len(e) / max(1, len(e) - len(motors[k].columns))
        rounding = (np.finfo(float).eps * motors[k].norm) ** 2 / int(motors[k].rows.sum())
        a[k] = fisher_scoring(Z, squares, a[k], rounding)
    return VarianceFunction(a, speed, load, beta)


def rms_speed_and_load(rows: Rows, beta: Array) -> tuple[Array, Array]:
    """Root mean square speed and model torque of every motor's used rows, each (motors,); one where zero."""
    sums = np.zeros((2, len(rows.observation.motors)))
    for chunk in rows:
        sums[0] += (np.where(chunk.used, chunk.velocity, 0.0) ** 2).sum(axis=1)
        sums[1] += ((chunk.W @ beta) ** 2).sum(axis=1)
    counts = np.array([motor.rows.sum() for motor in rows.observation.motors])
    speed, load = np.sqrt(sums / np.maximum(counts, 1))
    return np.where(speed > 0, speed, 1.0), np.where(load > 0, load, 1.0)


def fisher_scoring(Z: Array, squares: Array, a: Array, least: float) -> Array:
    """Fisher scoring of log sigma^2 = Z a: a + (Z'Z)^-1 Z'(e^2 / sigma^2 - 1), (k,).

    Args:
        Z: (rows, k).
        squares: of residuals, (rows,).
        a: start, (k,).
        least: smaller squares are taken as rounding and raised to this.
    """
    squares = np.maximum(squares, least)
    for _ in range(SCORING_STEPS):
        excess = np.minimum(squares / np.exp(np.clip(Z @ a, -700, 700)), 1e6) - 1.0
        step = np.linalg.lstsq(Z, excess, rcond=None)[0]
        step *= min(1.0, LARGEST_STEP / max(float(np.abs(Z @ step).max()), 1e-300))
        a = a + step
        if np.abs(step).max() < 1e-8:
            break
    return a
