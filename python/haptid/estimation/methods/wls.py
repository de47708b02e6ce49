"""Weighted least squares: every motor's rows in units of that motor's own residual."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import MethodSettingError, NoTorqueError
from haptid.estimation.least_squares import solve
from haptid.observation.observation import MotorRows, Observation


@dataclass(frozen=True)
class WLS:
    """Weighted least squares, each motor weighted by its own residual.

    Source: Gautier and Poignet (2001), Control Engineering Practice 9(12).

    Attributes:
        passes: times the weights are made from the last fit's residuals.
    """

    passes: int = 2

    def __post_init__(self) -> None:
        if not (type(self.passes) is int and self.passes >= 1):
            raise MethodSettingError("WLS", "passes", self.passes, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return "WLS"

    @property
    def unit_residual(self) -> bool:
        """Whether the weighted residual has unit variance, or its variance is still to be estimated."""
        return True

    def weights(self, observation: Observation) -> Array:
        """One over the deviation of each motor's residual, (motors,), 1/(N m) or 1/N."""
        weights = np.ones(len(observation.motors))
        for _ in range(self.passes):
            beta = solve(observation, weights).beta
            weights = np.array([self.weight(motor, beta) for motor in observation.motors])
        return weights

    def weight(self, motor: MotorRows, beta: Array) -> float:
        """One over the deviation of one motor's residual; a motor that fits exactly is held to rounding."""
        if motor.norm == 0:
            raise NoTorqueError(motor.name)
        dof = max(1, int(motor.rows.sum()) - len(motor.columns))
        floor = np.finfo(float).eps * motor.norm / np.sqrt(dof)
        return float(1.0 / max(motor.residual(beta) / np.sqrt(dof), floor))
