"""Least squares in the parameters and delays, again and again with other positions of the same logs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.motion.motion import with_positions
from haptid.observation.observation import MotorRows, Observation, observe
from haptid.treatment_choice.delay_columns import delay_columns
from haptid.treatment_choice.delay_estimate import Delays, delay_prior
from haptid.treatment_choice.first_fit import memory_of, solve_excited
from haptid.treatment_choice.nuisance_problem import NuisanceProblem


@dataclass(frozen=True, eq=False)
class Refit:
    """Least squares in the parameters and delays, again and again with other positions.

    Attributes:
        rows: as they were measured.
        chi: parameters of the core's columns that the delays' columns are computed with, (r,), SI.
        beta: parameters of the fit to the rows, (p,), SI.
        se: standard errors of parameters and delays, (p + delays,), SI.
        weights: of each motor's rows, less for residuals with memory, (motors,).
        known: prior rows of the delays, (delays, p + delays + 1).
        noise_hz: frequency above which the torque without dry friction is noise, Hz.
    """

    rows: Observation
    chi: Array
    beta: Array
    se: Array
    weights: Array
    known: Array
    noise_hz: float

    @staticmethod
    def of(estimate: Estimate, delays: Delays | None) -> Refit:
        """From an estimate, and the delays of its treatment; None for those that were given."""
        rows, beta = estimate.observation, estimate.free
        delays = delays if delays is not None and delays.accepted else None
        many, p = 0 if delays is None else len(delays.seconds), len(beta)
        known = np.zeros((many, p + many + 1))
        se = estimate.se
        if delays is not None:
            known[:, p:-1] = np.linalg.inv(np.linalg.cholesky(delay_prior(many, delays.dt)))
            se = np.append(se, delays.se)
        step = rows.motions[0].treatment.decimation * rows.motions[0].dt
        weights = estimate.weights / np.sqrt(max(memory_of(estimate) / step, 1.0))
        noise_hz = np.inf if delays is None else delays.noise_hz
        return Refit(rows, raw_parameters(rows.model, beta), beta, se, weights, known, noise_hz)

    def motors(self, positions: Sequence[Array]) -> Sequence[MotorRows]:
        """R factors with other positions of the logs."""
        model = self.rows.model
        motions = [with_positions(motion, q) for motion, q in zip(self.rows.motions, positions, strict=True)]
        if not len(self.known):
            return observe(model, *motions).motors
        columns = [delay_columns(model, motion, noise_hz=self.noise_hz) for motion in motions]
        return NuisanceProblem.of(model, motions, self.beta, self.chi, columns).rows.motors

    def least_squares(self, positions: Sequence[Array]) -> Array:
        """Parameters and the change of the delays with other positions of the logs, (p + delays,), SI."""
        return solve_excited(self.motors(positions), self.weights, self.known).beta

    def by_block(self, motors: Sequence[MotorRows], at: Array) -> Array:
        """Step from parameters and delays to their least squares, the part of each block, (blocks, p + delays), SI."""
        root = solve_excited(motors, self.weights, self.known).root
        scores = np.zeros((len(motors[0].r_factors), len(at)))
        for motor, weight in zip(motors, self.weights, strict=True):
            W, y = motor.r_factors[:, :, :-1], motor.r_factors[:, :, -1]
            left = y - W @ at[motor.columns]
            scores[:, motor.columns] += weight**2 * np.einsum("bij,bi->bj", W, left)
        return np.asarray(scores @ root @ root.T)
