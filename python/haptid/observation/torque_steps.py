"""Error of torques by the steps of their channels: a residual below it is no accuracy."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array
from haptid.log import Log
from haptid.motion.channels import torque_map
from haptid.observation.plan import Plan

# Samples of a log that are looked at, at most.
_ENOUGH = 1 << 18
# Standard deviation of an error that is spread evenly over a step, in steps.
_EVEN = 12.0**-0.5
# Of each log, its channels' steps and the share of samples at which they change.
_STEPS: WeakKeyDictionary[Log, tuple[Array, Array]] = WeakKeyDictionary()


def rounding_of(plan: Plan) -> Array:
    """RMS error of each coordinate's treated torque by the steps of the channels, (coordinates,), N m or N.

    The error of a channel that steps at every sample is white, and the filter takes most of it away. One that changes
    seldom has errors that last from step to step, and the filter leaves them: between the two, the errors that a filter
    averages over are as many as the steps within its length. Zero without a log, and where the pose changes shares.
    """
    device, log = plan.model.device, plan.motion.log
    if log is None or (log.channels.torque.side == "motor" and device.drive_varies.any()):
        return np.zeros(len(device.active))
    step, changes = steps_of(log)
    length = 1.0 / float(np.sum(plan.taps**2))
    error = step * _EVEN / np.sqrt(np.maximum(changes * length, 1.0))
    return np.asarray(np.sqrt(torque_map(device, log) ** 2 @ error**2))


def steps_of(log: Log) -> tuple[Array, Array]:
    """The least step of each torque channel, in its own unit, and the share of samples that change, (channels,) each.

    A channel that never changes may be anything between zero and twice its value: its value is its step.
    """
    if log not in _STEPS:
        tau = np.asarray(log.torque[:_ENOUGH])
        steps = np.abs(np.diff(tau, axis=0))
        least = np.where(steps > 0, steps, np.inf).min(axis=0, initial=np.inf)
        _STEPS[log] = np.where(np.isfinite(least), least, np.abs(tau[0])), (steps > 0).mean(axis=0)
    return _STEPS[log]
