"""What motors really give for a command, from logs without and with a known load."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, stats

from haptid._internal.arrays import Array, freeze, read_only
from haptid.device.priors import Body
from haptid.dynamics.model import DynamicModel
from haptid.errors import DifferentModelError, GainSettlingError
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.least_squares import Solution, check_excited
from haptid.observation.known_payload import payload_torque
from haptid.observation.observation import MotorRows, Observation, triangle

# Gauss-Newton's steps, and the change of the factors at which they end.
MOST_STEPS, SETTLED = 50, 1e-10


@dataclass(frozen=True, eq=False)
class DriveGains:
    """True gain of each motor over that of the device file.

    Attributes:
        model: with the gains of its file.
        labels: "motor 1", (motors,).
        factor: (motors,).
        covariance: honest, (motors, motors).
        dof: degrees of freedom of the intervals, (motors,).
        beta: base parameters of the device without load, in true units, (p,), SI.
    """

    model: DynamicModel
    labels: tuple[str, ...]
    factor: Array
    covariance: Array
    dof: Array
    beta: Array

    def __post_init__(self) -> None:
        for name in ("factor", "covariance", "freedom", "beta"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @cached_property
    def interval95(self) -> Array:
        """95 % intervals of the factors, (motors, 2)."""
        half = stats.t.ppf(0.975, self.dof) * np.sqrt(np.diag(self.covariance))
        return freeze(np.column_stack([self.factor - half, self.factor + half]))

    def summary(self) -> str:
        """A line for each motor."""
        lines = []
        for label, factor, (low, high) in zip(self.labels, self.factor, self.interval95, strict=True):
            lines.append(f"{label}: {factor:.4f} of the file's gain, 95 % interval {low:.4f} .. {high:.4f}")
        return "\n".join(lines)


def drive_gains(bare: Observation, loaded: Observation, link: str, body: Body) -> DriveGains:
    """Gains of the motors from a known load.

    Torque tau that the file's gains make of a motor's command is s W (beta + loaded shift), with `shift` what the load
    adds to the base parameters and s one over the factor. Without a load, s and beta have no scale; the load gives
    each motor that feels it one. The torque's noise stays on the left side, where it biases nothing: Gauss-Newton on
    beta and s, by triangles of the blocks.

    Source: Gautier and Briot (2014), ASME Journal of Dynamic Systems, Measurement, and Control 136(5), for the
    experiment.

    Args:
        bare: rows of logs without the load.
        loaded: rows of logs with it, on the same device.
        link, body: as for `haptid.observation.known_payload.payload_torque`.

    Raises:
        DifferentModelError: the observations are of two devices.
        UnknownLinkError, LoadSymmetryError: as `payload_torque`.
        UnexcitedError: the logs leave a direction of the parameters in the dark, or a motor does not feel the load.
        GainSettlingError: the search did not come to rest.
    """
    model = bare.model
    if not loaded.model.is_same_as(model):
        raise DifferentModelError(model.device.name, loaded.model.device.name)
    both, shift = bare + loaded, payload_torque(model, link, body)
    carrying = np.arange(len(both.blocks)) >= len(bare.blocks)
    p, many = len(model.base), len(both.motors)
    scale, beta, weights = np.ones(many), np.zeros(p), np.ones(many)
    for _ in range(MOST_STEPS):
        rows = [_linearised(m, p + k, scale[k], beta, shift, carrying) for k, m in enumerate(both.motors)]
        solution = _solved(model, rows, weights)
        beta, moved = solution.beta[:p], solution.beta[p:]
        scale = scale + moved
        weights = np.array([np.sqrt(m.rows.sum()) / m.residual(solution.beta) for m in rows])
        if np.abs(moved).max() < SETTLED * np.abs(scale).max():
            break
    else:
        raise GainSettlingError(float(np.abs(moved).max()), SETTLED, MOST_STEPS)
    motors = np.eye(p + many)[p:]
    made = clustered(replace(both, motors=tuple(rows)), weights, solution, motors)
    factor = 1.0 / scale
    change = np.diag(factor**2)
    labels = tuple(motor.label for motor in both.motors)
    return DriveGains(model, labels, factor, change @ made.covariance @ change, made.dof, beta)


def _linearised(motor: MotorRows, own: int, scale: float, beta: Array, shift: Array, carrying: np.ndarray) -> MotorRows:
    """A motor's rows as a linear model of the base parameters and of the change of its scale, in column `own`."""
    R, z = motor.triangles[:, :, :-1], motor.triangles[:, :, -1]
    load = R @ shift[motor.columns] * carrying[:, None]
    slope = R @ beta[motor.columns] + load
    wide = np.concatenate([scale * R, slope[:, :, None], (z - scale * load)[:, :, None]], axis=2)
    size = wide.shape[2]
    squares = np.zeros((len(wide), size, size))
    reduced = np.asarray(np.linalg.qr(wide, mode="r"))
    squares[:, : reduced.shape[1]] = reduced
    return replace(motor, columns=np.append(motor.columns, own), triangles=squares)


def _solved(model: DynamicModel, rows: list[MotorRows], weights: Array) -> Solution:
    """Least squares of all motors' rows; base parameters first, then one scale for each motor."""
    size = len(model.base) + len(rows)
    parts = []
    for motor, weight in zip(rows, weights, strict=True):
        wide = np.zeros((len(motor.whole), size + 1))
        wide[:, np.append(motor.columns, size)] = weight * motor.whole
        parts.append(wide)
    whole = triangle(np.concatenate(parts))
    R, z = whole[:-1, :-1], whole[:-1, -1]
    check_excited([*model.base.names, *(f"the gain of {motor.label}" for motor in rows)], R)
    root = linalg.solve_triangular(R, np.eye(size))
    dof = int(sum(motor.rows.sum() for motor in rows)) - size
    return Solution(root @ z, R, root, abs(float(whole[-1, -1])), dof)
