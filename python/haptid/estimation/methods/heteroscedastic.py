"""Maximum likelihood where noise grows with speed or load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, whole
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimation.least_squares import solve
from haptid.estimation.method import UnitRows
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.rows import Chunk, Rows

# Fisher's steps for the variance in each pass: the next pass goes on from there.
STEPS = 20
# A step of the logarithm of the variance is no longer than this.
LONGEST = 2.0
# Logarithms of a row's variance stay within this of its motor's: a few rows that fit exactly do not take all weight.
WIDEST = 6.0


@dataclass(frozen=True)
class Heteroscedastic(UnitRows):
    """Maximum likelihood with a variance that depends on speed and load, motor by motor.

    log sigma^2 = a0 + a1 |v| / v_rms + a2 |load| / load_rms, where the load is the model's torque. Parameters and
    variances are found in turn, the variances by Fisher scoring; every row is then weighted by its own deviation.

    Source: Harvey (1976), Econometrica 44(3), eqs 3 and 12.

    Attributes:
        passes: times the variances are made from the last fit's residuals.
    """

    passes: int = 5

    def __post_init__(self) -> None:
        if not (whole(self.passes) and self.passes >= 1):
            raise MethodSettingError("Heteroscedastic", "passes", self.passes, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return "heteroscedastic ML"

    def rows(self, observation: Observation) -> Observation:
        """Each in units of its own deviation.

        Raises:
            NoTorqueError: nothing was measured of a motor.
        """
        rows = Rows(observation)
        beta = solve(observation, WLS().weights(observation)).beta
        made: Variances | None = None
        for _ in range(self.passes):
            made = variances(rows, beta, made)
            seen = rows.folded(made)
            beta = solve(seen, self.weights(seen)).beta
        return seen


@dataclass(frozen=True, eq=False)
class Variances:
    """Rows multiplied by one over their own deviation.

    Attributes:
        a: of log sigma^2 on one, speed and load in their typical sizes, (motors, 3).
        speed, load: the typical sizes, (motors,).
        beta: of the model that gives the load, (p,).
    """

    a: Array
    speed: Array
    load: Array
    beta: Array

    def __call__(self, stretch: Chunk) -> Chunk:
        return stretch.scaled(np.where(stretch.used, np.exp(-0.5 * self.logarithms(stretch)), 0.0))

    def logarithms(self, stretch: Chunk) -> Array:
        """log sigma^2 of all rows, (motors, rows)."""
        Z = regressors(stretch, self.speed, self.load, self.beta)
        made = np.einsum("mrk,mk->mr", Z, self.a)
        middle = self.a @ np.array([1.0, 1.0, 1.0])
        return np.asarray(np.clip(made, middle[:, None] - WIDEST, middle[:, None] + WIDEST))


def regressors(stretch: Chunk, speed: Array, load: Array, beta: Array) -> Array:
    """One, speed and load in their typical sizes, (motors, rows, 3)."""
    torque = np.abs(stretch.W @ beta) / load[:, None]
    return np.stack([np.ones_like(torque), np.abs(stretch.velocity) / speed[:, None], torque], axis=2)


def variances(rows: Rows, beta: Array, before: Variances | None) -> Variances:
    """The most likely ones, for residuals of given parameters.

    Raises:
        NoTorqueError: nothing was measured of a motor.
    """
    motors = rows.observation.motors
    speed, load = typical(rows, beta)
    a = np.zeros((len(motors), 3)) if before is None else np.array(before.a)
    if before is None:
        a[:, 0] = [-2.0 * np.log(WLS().weight(motor, beta)) for motor in motors]
    parts: list[list[tuple[Array, Array]]] = [[] for _ in motors]
    for stretch in rows:
        Z, e = regressors(stretch, speed, load, beta), stretch.residual(beta)
        for k, used in enumerate(stretch.used):
            parts[k].append((Z[k, used], e[k, used]))
    for k, own in enumerate(parts):
        Z, e = (np.concatenate(each) for each in zip(*own, strict=True))
        a[k] = scored(Z, e**2 * len(e) / max(1, len(e) - len(motors[k].columns)), a[k], floor(motors[k]))
    return Variances(a, speed, load, beta)


def floor(motor: MotorRows) -> float:
    """Variance that is rounding's, for a motor that fits exactly.

    Raises:
        NoTorqueError: nothing was measured of it.
    """
    if motor.norm == 0:
        raise NoTorqueError(motor.name)
    return (np.finfo(float).eps * motor.norm) ** 2 / int(motor.rows.sum())


def typical(rows: Rows, beta: Array) -> tuple[Array, Array]:
    """Root mean square speed and model torque of every motor's rows that count, each (motors,); one where zero."""
    sums = np.zeros((2, len(rows.observation.motors)))
    for stretch in rows:
        sums[0] += (np.where(stretch.used, stretch.velocity, 0.0) ** 2).sum(axis=1)
        sums[1] += ((stretch.W @ beta) ** 2).sum(axis=1)
    counts = np.array([motor.rows.sum() for motor in rows.observation.motors])
    speed, load = np.sqrt(sums / counts)
    return np.where(speed > 0, speed, 1.0), np.where(load > 0, load, 1.0)


def scored(Z: Array, squares: Array, a: Array, least: float) -> Array:
    """Fisher scoring of log sigma^2 = Z a: a + (Z'Z)^-1 Z'(e^2 / sigma^2 - 1), (k,).

    Args:
        Z: (rows, k).
        squares: of residuals, (rows,).
        a: start, (k,).
        least: variances below are rounding.
    """
    squares = np.maximum(squares, least)
    for _ in range(STEPS):
        excess = np.minimum(squares / np.exp(np.clip(Z @ a, -700, 700)), 1e6) - 1.0
        step = np.linalg.lstsq(Z, excess, rcond=None)[0]
        step *= min(1.0, LONGEST / max(float(np.abs(Z @ step).max()), 1e-300))
        a = a + step
        if np.abs(step).max() < 1e-8:
            break
    return a
