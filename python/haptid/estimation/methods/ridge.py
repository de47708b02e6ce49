"""Least squares pulled towards what is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, positive, whole
from haptid.errors import MethodSettingError, NoPriorError
from haptid.estimation.fit import moments
from haptid.estimation.knowledge import Knowledge
from haptid.estimation.least_squares import solve
from haptid.estimation.methods.wls import WLS
from haptid.observation.observation import Observation

# Strengths that are tried where none is given: the prior's weight times 10^-4 to 10^4.
STRENGTHS = tuple(10.0 ** (k / 2) for k in range(-8, 9))


@dataclass(frozen=True)
class Ridge:
    """Weighted least squares, pulled towards the prior values of the device file.

    Every base parameter with a prior is one more row: its value, in units of its prior deviation, times the root of
    `strength`. With strength 1 it is the Bayesian estimate for white residuals. Where no strength is given, it is the
    one whose estimates from all other blocks predict the torque of each block best. Parameters without a prior, or with
    a prior of zero without a deviation, are free.

    Intervals take the prior's value as drawn with its deviation: where the prior is wrong by more, they miss.

    Sources: Hoerl and Kennard (1970), Technometrics 12(1); Stone (1974), JRSS B 36, for the choice of the strength.

    Attributes:
        share: deviation of a prior value that has none in the device file, as a share of the value.
        strength: of the pull; None for the one that predicts best.
        passes: times the weights are made from the last fit's residuals.
    """

    share: float = 0.3
    strength: float | None = None
    passes: int = 2

    def __post_init__(self) -> None:
        if not positive(self.share):
            raise MethodSettingError("Ridge", "share", self.share, "a finite number above zero")
        if self.strength is not None and not positive(self.strength):
            raise MethodSettingError("Ridge", "strength", self.strength, "a finite number above zero, or None")
        if not (whole(self.passes) and self.passes >= 1):
            raise MethodSettingError("Ridge", "passes", self.passes, "a whole number, 1 or more")

    @property
    def name(self) -> str:
        return "ridge towards the prior"

    @property
    def unit_residual(self) -> bool:
        """Rows are weighted to unit variance."""
        return True

    def weights(self, observation: Observation) -> Array:
        """One over the deviation of each motor's residual in the fit with the prior, (motors,).

        Raises:
            NoPriorError: the device has no prior values.
            NoTorqueError: nothing was measured of a motor.
        """
        return self._weighted(observation, self._prior(observation))

    def knowledge(self, observation: Observation) -> Knowledge:
        """The prior values, with deviations as the strength makes them.

        Raises:
            NoPriorError: the device has no prior values.
        """
        prior = self._prior(observation)
        if self.strength is not None:
            return strengthened(prior, self.strength)
        weights = self._weighted(observation, prior)
        tried = [strengthened(prior, strength) for strength in STRENGTHS]
        errors = [prediction_error(observation, weights, known) for known in tried]
        return tried[int(np.argmin(errors))]

    def _weighted(self, observation: Observation, prior: Knowledge) -> Array:
        weighting, known = WLS(self.passes), strengthened(prior, self.strength or 1.0)
        weights = np.array([1.0 / max(motor.norm, np.finfo(float).tiny) for motor in observation.motors])
        for _ in range(self.passes):
            beta = solve(observation, weights, (), known).beta
            weights = np.array([weighting.weight(motor, beta) for motor in observation.motors])
        return weights

    def _prior(self, observation: Observation) -> Knowledge:
        model = observation.model
        known = [(k, p) for k, p in enumerate(model.base_prior) if p is not None and (p[1] or p[0])]
        if not known:
            raise NoPriorError(model.device.name)
        values = np.array([value for _, (value, _) in known])
        se = np.array([se or self.share * abs(value) for _, (value, se) in known])
        return Knowledge(np.eye(len(model.base))[[k for k, _ in known]], values, se)


def strengthened(prior: Knowledge, strength: float) -> Knowledge:
    """The same with its weight multiplied."""
    return Knowledge(prior.A, prior.b, prior.se / np.sqrt(strength))


def prediction_error(observation: Observation, weights: Array, known: Knowledge) -> float:
    """Sum of squares of what estimates from all other blocks leave of each block's weighted torque."""
    solution = solve(observation, weights, (), known)
    made = moments(observation, weights, solution)
    moved, first, total = made.moved @ solution.root.T, 0, 0.0
    for motor, weight in zip(observation.motors, weights, strict=True):
        T = motor.triangles[motor.rows > 0] * weight
        beta = (solution.beta - moved[first : first + len(T)])[:, motor.columns]
        left = T[:, :, -1] - np.einsum("bij,bj->bi", T[:, :, :-1], beta)
        total, first = total + float((left**2).sum()), first + len(T)
    return total
