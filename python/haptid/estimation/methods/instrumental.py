"""Instrumental variables: two-stage least squares, unbiased by noise in the columns."""

from __future__ import annotations

from dataclasses import field

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.estimation.least_squares import check_excited
from haptid.estimation.methods.simulation_based import ClosedLoop, simulate_along, treated_as
from haptid.observation.observation import Observation
from haptid.observation.r_factor import r_factor
from haptid.observation.rows import Chunk, Rows


@dataclass(frozen=True)
class IV(ClosedLoop):
    """Two-stage least squares: columns regressed on instruments, torque on the fitted columns.

    Instruments Z are the columns at the motion of the model under the same controller, treated the same: they are
    correlated with the motion, and not with the noise of the measured positions. beta = (Z'W)^-1 Z'y. It is computed
    as least squares of y - W beta + Z P beta on Z P, with P = (Z'Z)^-1 Z'W: the same beta, and the residual y - W beta,
    so that the cluster-robust covariance of these rows is that of the two-stage estimate.

    Source: Janot, Vandanjon and Gautier (2014), IEEE Trans. Control Systems Technology 22(1), eqs 17 to 21.

    Attributes:
        friction: as of the others, with more smoothing: instruments need not be exact.
    """

    friction: float = field(default=0.01, kw_only=True)

    def linearised_rows(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of the second stage."""
        courses = self.courses(observation, smoothed, beta)
        simulated = simulate_along(observation, [treated_as(observation.model, course) for course in courses])
        weights = self.weighting.weights(observation)
        return second_stage(observation, simulated, weights)


def second_stage(observation: Observation, instruments: Observation, weights: Array) -> Observation:
    """Rows whose weighted least squares are the instrumental-variables estimate of the observation.

    Args:
        instruments: rows of the same blocks from another motion.
        weights: of each motor's rows, (motors,).

    Raises:
        IdentifiabilityError: the instruments do not excite a direction of the parameters.
    """
    rows, p = Rows(observation), len(observation.base)
    Z = {chunk.blocks: chunk for chunk in Rows(instruments)}
    corner = np.zeros((2 * p + 1, 2 * p + 1))
    for chunk in rows:
        z = Z[chunk.blocks].W * chunk.used[:, :, None]
        parts = np.concatenate([z, chunk.W, chunk.y[:, :, None]], axis=2) * weights[:, None, None]
        corner = r_factor(np.concatenate([corner, parts.reshape(-1, 2 * p + 1)]))
    RZ, QW, Qy = corner[:p, :p], corner[:p, p : 2 * p], corner[:p, -1]
    for corner in (RZ, QW):
        check_excited(observation.base.names, corner)
    beta = np.asarray(np.linalg.solve(QW, Qy), dtype=np.float64)
    P = np.linalg.solve(RZ, QW)

    def change(chunk: Chunk) -> Chunk:
        fitted = (Z[chunk.blocks].W * chunk.used[:, :, None]) @ P
        return chunk.with_rows(fitted, chunk.residual(beta) + fitted @ beta)

    reached = [np.arange(p) for _ in observation.motors]
    return rows.folded(change, reached)
