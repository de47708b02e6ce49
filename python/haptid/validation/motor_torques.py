"""Torques of redundant motors: measured, predicted by the distribution law, and the measured preload apart.

The motion determines B' Gamma only. What of the measured torques moves nothing (the preload) is no error of the model;
a prediction for each motor requires the distribution law of the device file.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, expect
from haptid._internal.late import dataclass
from haptid.dynamics.inverse import raw_parameters
from haptid.errors import IncompleteDeviceError
from haptid.estimation import Estimate
from haptid.motion.channels import motor_torque
from haptid.motion.motion import Motion
from haptid.observation.augmented import torque_of
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk, chunks, gathered


@dataclass(frozen=True)
class MotorShare:
    """Torque of one redundant motor along a motion, at the joint side, N m or N.

    Attributes:
        name: of the motor.
        unit: N m or N.
        rms: of the measured torque.
        error: rms of measured minus predicted torque.
        preload: mean of the measured torque in balance.
        preload_rms: its root mean square.
    """

    name: str
    unit: str
    rms: float
    error: float
    preload: float
    preload_rms: float


@dataclass(frozen=True, eq=False)
class MotorTorques:
    """Torques of redundant motors at the rows of a motion, at the joint side, each (motors, rows), N m or N.

    Attributes:
        names, units: of the motors.
        t: times, (rows,), s.
        measured: treated as the rows are.
        predicted: by the estimate and the distribution law.
        preload: the part of the measured torques that moves nothing.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array
    preload: Array

    def __post_init__(self) -> None:
        for name in ("measured", "predicted", "preload"):
            expect(name, getattr(self, name).shape, (len(self.names), len(self.t)))

    @property
    def shares(self) -> tuple[MotorShare, ...]:
        """Figures of each motor."""
        error = self.measured - self.predicted
        figures = (_rms(self.measured), _rms(error), self.preload.mean(axis=1), _rms(self.preload))
        return tuple(
            MotorShare(name, unit, *(float(figure[k]) for figure in figures))
            for k, (name, unit) in enumerate(zip(self.names, self.units, strict=True))
        )


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(x**2, axis=1)))


def motor_torques(estimate: Estimate, motion: Motion) -> MotorTorques:
    """Torques of redundant motors along a motion.

    Args:
        estimate: that predicts.
        motion: of a log with one torque for each motor.

    Raises:
        IncompleteDeviceError: the device file has no distribution law.
        LogMismatchError: the log has torques of joints, or none.
        MissingAccelerationError: velocity is by a causal differentiator.
    """
    device, chi = estimate.model.device, raw_parameters(estimate.model, estimate.beta)
    rows = ((s.t, *_parts(s, chi)) for s in chunks(estimate.model, motion))
    t, measured, predicted, preload = gathered(rows, Plan.of(estimate.model, motion).rows)
    units = tuple(device.drive_units[k] for k in device.driven)
    return MotorTorques(tuple(m.name for m in device.motors), units, t, measured, predicted, preload)


def _parts(s: Chunk, chi: Array) -> tuple[Array, Array, Array]:
    """Measured, predicted and balanced torque of the motors, filtered and decimated, (motors, rows) each."""
    device, motion = s.model.device, s.plan.motion
    low, high = s.plan.window(s.start, s.stop)
    if motion.log is None:
        raise IncompleteDeviceError(
            "the motion comes from no log, so the torques of single motors are not known.",
            where="motion",
            advice="Give a motion that was treated from a log.",
        )
    measured = motor_torque(device, motion.log, np.ascontiguousarray(motion.tau[low:high].T))
    cdd = np.zeros_like(s.c) if s.cdd is None else s.cdd
    predicted = device.drive_torque(s.c, torque_of(s.model, chi, s.c, s.cd, cdd, s.plan.history(low, high)))
    B = device.drive_jacobian(s.c)[..., device.driven, :]
    law = device.law.of(device.driven)
    preload = law.balanced(B if B.ndim == 3 else B[None], np.ascontiguousarray(measured.T)).T
    return s.filtered(measured), s.filtered(predicted), s.filtered(preload)


def motor_shares(estimate: Estimate, motion: Motion) -> tuple[MotorShare, ...]:
    """Figures of redundant motors along a motion; none where motors are not redundant or not distinguishable."""
    device, log = estimate.model.device, motion.log
    distributed = device.redundant and device.distribution is not None
    determined = distributed and log is not None and not motion.treatment.momentum
    return motor_torques(estimate, motion).shares if determined and log and log.channels.torque.side == "motor" else ()
