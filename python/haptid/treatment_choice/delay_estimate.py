"""Estimate of the delay of a log's torque with respect to its positions.

A command is constant from one sample to the next (zero-order hold), and amplifiers and buses add latency: to first
order a delay d adds d * dtau/dt to the residual. Half a sampling period at 1 kHz is enough to bias the viscous friction
of a haptic device by a fifth and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS
from haptid.log import Log
from haptid.motion.treatment import Treatment, treat, with_delay
from haptid.observation.observation import Observation, observe

# Distance of the parabola's points in each iteration around the last minimum, samples.
_STEPS = (1.0, 0.5, 0.25)
# Longest delay, samples; a longer one is not the delay of a drive, and the parabola is not valid there.
_LONGEST = 50.0
# Groups of blocks for the jackknife standard error.
GROUPS = 10


@dataclass(frozen=True)
class Delay:
    """Delay of the torque channel.

    Attributes:
        seconds: the acting torque at a sample is the channel's of so much earlier, s.
        se: its standard error, by a jackknife over tenths of the log, s.
    """

    seconds: float
    se: float


def find_delay(model: DynamicModel, logs: Sequence[Log], treatment: Treatment) -> Delay | None:
    """The delay with the least residual; None where it is not identifiable from the logs.

    Args:
        model: the dynamic model.
        logs: recorded by one instrument, at one rate.
        treatment: settings; its own `torque_delay_s` is ignored.

    Raises:
        HaptidError: as `treat` and `observe`.
    """
    dt, motions = float(logs[0].dt), [treat(log, replace(treatment, torque_delay_s=0.0)) for log in logs]
    guess, step = 0.0, _STEPS[0]
    trio: list[Observation] = []
    for step in _STEPS:
        late = [(guess + k * step) * dt for k in (-1, 0, 1)]
        trio = [observe(model, *(with_delay(motion, seconds) for motion in motions)) for seconds in late]
        weights = WLS().weights(trio[1])
        lowest = _lowest(trio, weights)
        if lowest is None or abs(guess + step * lowest) > _LONGEST:
            return None
        around, guess = guess, guess + step * lowest
    group = np.arange(len(trio[1].blocks)) * GROUPS // len(trio[1].blocks)
    left = [_lowest([o.pick(np.flatnonzero(group != g)) for o in trio], weights) for g in range(GROUPS)]
    found = around + step * np.array([value for value in left if value is not None])
    if len(found) < GROUPS:
        return None
    spread = np.sqrt((GROUPS - 1) / GROUPS * np.sum((found - found.mean()) ** 2))
    return Delay(float(guess * dt), float(spread * dt))


def _lowest(trio: Sequence[Observation], weights: Array) -> float | None:
    """Minimum of the parabola through three sums of squares, in steps from the middle one; None where there is none."""
    before, here, after = (float(observation.stack(weights)[-1, -1]) ** 2 for observation in trio)
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend > 0 else None
