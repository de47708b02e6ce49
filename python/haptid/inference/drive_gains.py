"""Drive gain identification: true torque per command of each motor, from logs without and with a known payload."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, freeze, read_only
from haptid.device.priors import PriorBody
from haptid.dynamics.model import DynamicModel
from haptid.errors import ConvergenceError, ModelMismatchError
from haptid.estimation.intervals.cluster_robust import clustered
from haptid.estimation.least_squares import Solution, check_excited
from haptid.observation.known_payload import payload_torque
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.r_factor import triangle
from haptid.uncertainty.quantities import LEVEL, half_width

# Gauss-Newton: largest number of steps, and relative change of the scales at convergence.
MOST_STEPS, _CONVERGED = 50, 1e-10


@dataclass(frozen=True, eq=False)
class DriveGains:
    """Ratio of each motor's true gain to that of the device file.

    Attributes:
        model: with the gains of its file.
        labels: "motor 1", (motors,).
        factor: true gain over the file's, (motors,).
        covariance: cluster-robust, (motors, motors).
        dof: degrees of freedom of the intervals, (motors,).
        beta: base parameters of the device without payload, at the true gains, (p,), SI.
    """

    model: DynamicModel
    labels: tuple[str, ...]
    factor: Array
    covariance: Array
    dof: Array
    beta: Array

    def __post_init__(self) -> None:
        for name in ("factor", "covariance", "dof", "beta"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def conf_int(self, level: float = LEVEL) -> Array:
        """Confidence intervals of the factors, (motors, 2)."""
        half = half_width(np.sqrt(np.diag(self.covariance)), self.dof, level)
        return freeze(np.column_stack([self.factor - half, self.factor + half]))

    def summary(self) -> str:
        """A line for each motor."""
        return "\n".join(
            f"{label}: {factor:.4f} of the file's gain, 95 % interval {low:.4f} .. {high:.4f}"
            for label, factor, (low, high) in zip(self.labels, self.factor, self.conf_int(), strict=True)
        )


def drive_gains(bare: Observation, loaded: Observation, link: str, body: PriorBody) -> DriveGains:
    """Gains of the motors from a known payload.

    The torque computed with the file's gains is s W (beta + loaded shift), where `shift` is what the payload adds to
    the base parameters and s one over the factor. Without a payload the scale of s and beta is not identifiable; the
    payload makes it so for each motor that it loads. Torque noise stays on the left side, so it causes no bias.
    Gauss-Newton on beta and s, on the R factors of the blocks.

    Source: Gautier and Briot (2014), ASME Journal of Dynamic Systems, Measurement, and Control 136(5), for the
    experiment.

    Args:
        bare: rows of logs without the payload.
        loaded: rows of logs with it, of the same device.
        link, body: as for `haptid.observation.known_payload.payload_torque`.

    Raises:
        ModelMismatchError: the observations are of two devices.
        UnknownNameError, DeviceError: as `payload_torque`.
        IdentifiabilityError: a direction of the parameters is not excited, or a motor is not loaded by the payload.
        ConvergenceError: Gauss-Newton did not converge.
    """
    model = bare.model
    if not loaded.model.is_same_as(model):
        raise ModelMismatchError(
            f"these are of two devices, {model.device.name!r} and {loaded.model.device.name!r}, or of one device "
            "read twice.",
            found=(model.device.name, loaded.model.device.name),
            advice="Read the device once, and make every observation with it.",
        )
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
        if np.abs(moved).max() < _CONVERGED * np.abs(scale).max():
            break
    else:
        raise ConvergenceError(
            f"the gains still change by {np.abs(moved).max():.2g} after {MOST_STEPS} steps, limit {_CONVERGED:.2g}.",
            found=float(np.abs(moved).max()),
            limit=_CONVERGED,
            advice="Record longer, with a heavier payload that loads every motor.",
        )
    motors = np.eye(p + many)[p:]
    made = clustered(replace(both, motors=tuple(rows)), weights, solution, motors)
    factor = 1.0 / scale
    change = np.diag(factor**2)
    labels = tuple(motor.label for motor in both.motors)
    return DriveGains(model, labels, factor, change @ made.covariance @ change, made.dof, beta)


def _linearised(motor: MotorRows, own: int, scale: float, beta: Array, shift: Array, carrying: np.ndarray) -> MotorRows:
    """A motor's rows, linearised in the base parameters and the change of its scale, which has the column `own`."""
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
    """Least-squares solution of all motors' rows: base parameters, then one scale for each motor."""
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
