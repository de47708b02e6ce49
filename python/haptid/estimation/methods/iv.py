"""Instrumental variables: least squares that noise in the columns does not bias."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import UnexcitedError
from haptid.estimation.least_squares import EXCITED
from haptid.estimation.methods.simulating import ClosedLoop, along, treated_as
from haptid.observation.observation import Observation
from haptid.observation.r_factor import triangle
from haptid.observation.rows import Chunk, Rows


@dataclass(frozen=True)
class IV(ClosedLoop):
    """Two stages: columns explained by instruments, torque by what is explained of the columns.

    Instruments Z are the columns at the motion of the model under the same controller, treated the same: they go with
    the motion, and not with the noise of the measured positions. beta = (Z'W)^-1 Z'y. It is found as least squares of
    y - W beta + Z P beta on Z P, with P = (Z'Z)^-1 Z'W: the same beta, and the residual y - W beta, so that the spread
    over time blocks of these rows is the sandwich of the two-stage estimate.

    Source: Janot, Vandanjon and Gautier (2014), IEEE Trans. Control Systems Technology 22(1), eqs 17 to 21.

    Attributes:
        friction: as of the others, wider: instruments need not be exact.
    """

    friction: float = field(default=0.01, kw_only=True)

    def restate(self, observation: Observation, smoothed: DynamicModel, beta: Array) -> Observation:
        """Rows of the second stage."""
        courses = self.courses(observation, smoothed, beta)
        simulated = along(observation, [treated_as(observation.model, course) for course in courses])
        weights = self.weighting.weights(observation)
        return second_stage(observation, simulated, weights)


def second_stage(observation: Observation, instruments: Observation, weights: Array) -> Observation:
    """Rows whose weighted least squares are the instrumental estimate of the observation.

    Args:
        observation: the rows.
        instruments: rows of the same blocks from another motion.
        weights: of each motor's rows, (motors,).

    Raises:
        UnexcitedError: the instruments leave a direction of the parameters in the dark.
    """
    rows, p = Rows(observation), len(observation.base)
    Z = {stretch.blocks: stretch for stretch in Rows(instruments)}
    corner = np.zeros((2 * p + 1, 2 * p + 1))
    for stretch in rows:
        z = Z[stretch.blocks].W * stretch.used[:, :, None]
        parts = np.concatenate([z, stretch.W, stretch.y[:, :, None]], axis=2) * weights[:, None, None]
        corner = triangle(np.concatenate([corner, parts.reshape(-1, 2 * p + 1)]))
    RZ, QW, Qy = corner[:p, :p], corner[:p, p : 2 * p], corner[:p, -1]
    check(observation, RZ, QW)
    beta = np.asarray(np.linalg.solve(QW, Qy), dtype=np.float64)
    P = np.linalg.solve(RZ, QW)

    def change(stretch: Chunk) -> Chunk:
        explained = (Z[stretch.blocks].W * stretch.used[:, :, None]) @ P
        return stretch.with_rows(explained, stretch.residual(beta) + explained @ beta)

    reached = [np.arange(p) for _ in observation.motors]
    return rows.folded(change, reached)


def check(observation: Observation, *corners: Array) -> None:
    """Raise UnexcitedError where a direction of the parameters is in the dark."""
    for corner in corners:
        scale = np.linalg.norm(corner, axis=0)
        _, values, directions = np.linalg.svd(corner / np.where(scale > 0, scale, 1.0))
        if values[-1] <= EXCITED * values[0]:
            name = observation.base.names[int(np.argmax(np.abs(directions[-1])))]
            raise UnexcitedError(name, float(values[-1] / values[0]), EXCITED)
