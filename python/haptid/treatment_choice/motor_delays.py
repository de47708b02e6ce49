"""Delays of the torque channels of logs from the motor side, from the same rows as the parameters.

A spring and a delay turn the torque's phase alike where motion is slow, and friction and damping of motors go with the
delay. The rate of each channel's torque along the last simulation is one more column, and its coefficient what is
missing of the delay. What noise adds to the columns of the parameters is subtracted, and what it adds to the delay's
score: nothing as long as it does not move the motors, because a derivative of noise is orthogonal to it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation import WLS, Estimate
from haptid.estimation.methods.motor_side import MotorFit
from haptid.treatment_choice.delay_estimate import delay_prior, delay_setting, likely_delays, usual_delay

# Changes of the delays that are negligible, samples and standard errors.
_STILL, _SMALL = 0.005, 0.1


@dataclass(frozen=True, eq=False)
class MotorDelays:
    """Delays of the torque channels by the rows of a fit.

    Attributes:
        seconds: (channels,), s; the fit had others, to first order.
        covariance: theirs, (channels, channels), s^2.
        still: whether they are those of the fit.
        moved: by how much the errors of each time block move the parameters through them, (blocks, p), SI.
        rest: by how much one standard error of what is uncertain besides moves the parameters, (channels, p), SI.
        beta: parameters with these delays, to first order, (p,).
    """

    seconds: Array
    covariance: Array
    still: bool
    moved: Array
    rest: Array
    beta: Array

    @property
    def setting(self) -> float | tuple[float, ...]:
        """`Treatment.torque_delay_s`."""
        return delay_setting(self.seconds)

    @property
    def sentence(self) -> str:
        """The delays as text."""
        ms, se = (", ".join(f"{1e3 * x:.3f}" for x in own) for own in (self.seconds, np.sqrt(np.diag(self.covariance))))
        return f"The delay of the torque was estimated with the parameters: {ms} ms (standard error {se} ms)."


def motor_delays(fitted: Estimate) -> MotorDelays:
    """What the rows of a fit say of the delays of its torque channels.

    Args:
        fitted: by `MotorSide(delays=True)`, from logs.
    """
    fit, beta, p = fitted.fit, fitted.beta, len(fitted.beta)
    assert isinstance(fit, MotorFit)
    A, s = _normal_equations(fit, beta)
    total, channels = A.sum(axis=0), A.shape[1] - p
    root = np.linalg.inv(total[:p, :p])
    by_delay = -root @ total[:p, p:]
    scores = s[:, p:] + s[:, :p] @ by_delay
    # Rows count as many as are independent: as many as make the variance of the parameters that of their blocks.
    memory = max(1.0, float(np.mean(np.sum((s[:, :p] @ root) ** 2, axis=0) / np.diag(root))))
    logs = [motion.log for motion in fitted.observation.motions if motion.log is not None]
    dt, mean = max(float(log.dt) for log in logs), usual_delay(logs)
    now = np.broadcast_to(fitted.observation.motions[0].treatment.torque_delay_s, (channels,))
    known = np.linalg.inv(delay_prior(channels, dt))
    spread = np.linalg.inv((total[p:, p:] + total[p:, :p] @ by_delay) / memory + known)
    each = scores / memory @ spread
    by_rows = each.T @ each * len(each) / max(len(each) - 1, 1)
    whole = by_rows + spread @ known @ spread
    off = now - mean + each.sum(axis=0) - spread @ known @ (now - mean)
    likely, covariance = likely_delays(off, whole, dt)
    # The mixture of priors draws the delays towards the hold, and what moves them with them.
    drawn = np.linalg.solve(whole, covariance)
    values, vectors = np.linalg.eigh(covariance - drawn.T @ by_rows @ drawn)
    rest = (by_delay @ (vectors * np.sqrt(np.maximum(values, 0.0)))).T
    seconds = mean + likely
    still = bool((np.abs(seconds - now) < np.maximum(_STILL * dt, _SMALL * np.sqrt(np.diag(covariance)))).all())
    moved = each @ drawn @ by_delay.T
    return MotorDelays(seconds, covariance, still, moved, rest, beta + by_delay @ (seconds - now))


def with_motor_delays(fitted: Estimate) -> Estimate:
    """The estimate with the uncertainty of the delays in its intervals, where they were estimated from its rows.

    Args:
        fitted: by `MotorSide`, without other nuisances.
    """
    if not isinstance(fitted.fit, MotorFit):
        return fitted
    found = motor_delays(fitted)
    made = fitted.with_moved_nuisances(found.moved).with_nuisance("torque delay", found.rest)
    return replace(made, notes=(*made.notes, found.sentence))


def _normal_equations(fit: MotorFit, beta: Array) -> tuple[Array, Array]:
    """W'W and W'e of each time block, parameters first and delays behind, less the noise of the columns.

    Returns:
        (blocks, p + channels, p + channels) and (blocks, p + channels).
    """
    p, size = len(beta), len(fit.wide.motors[0].columns)
    at = np.append(beta, np.zeros(size - p))
    A, s = np.zeros((len(fit.wide.blocks), size, size)), np.zeros((len(fit.wide.blocks), size))
    for k, motor in enumerate(fit.wide.motors):
        weight = WLS().weight(motor, at)
        T = weight * motor.r_factors
        X = T[:, :, :-1]
        A += X.transpose(0, 2, 1) @ X
        s += np.einsum("bij,bi->bj", X, T[:, :, -1] - X @ at)
        if fit.noise is not None:
            N = (weight / fit.weights[k]) ** 2 * fit.noise[k]
            A[:, :p, :p] -= N[:, :-1, :-1]
            s[:, :p] -= N[:, :-1, -1] - N[:, :-1, :-1] @ beta
            s[:, p:] += (weight / fit.weights[k]) ** 2 * fit.late[k]
    return A, s
