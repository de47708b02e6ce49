"""How late a log's torque is beside its positions, from the log itself.

A command is held from one sample to the next, amplifiers and buses take their time: to first order a delay d adds d
times the rate of torque to the residual. A shift of half a sampling period at 1 kHz is enough to bias the viscous
friction of a haptic device by a fifth and more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.estimation import WLS
from haptid.log import Log
from haptid.motion.treatment import Motion, Treatment, treat, with_delay
from haptid.observation.observation import Observation, observe

# Times the parabola is laid anew around the last minimum, and the distance of its points then, samples.
STEPS = (1.0, 0.5, 0.25)
# A delay beyond so many samples is no delay of a drive; the parabola is not to be trusted there.
LONGEST = 50.0
# Groups of blocks, each left out in turn, for the deviation.
GROUPS = 10


@dataclass(frozen=True)
class Delay:
    """How late the torque channel is.

    Attributes:
        seconds: the torque that acts at a sample is the channel's of so much earlier.
        se: its deviation, by leaving out a tenth of the log at a time, s.
    """

    seconds: float
    se: float


def find_delay(model: DynamicModel, logs: Sequence[Log], treatment: Treatment) -> Delay | None:
    """The delay that leaves the least residual; None where the logs do not tell it.

    Args:
        model: the dynamic model.
        logs: recorded by one instrument, at one rate.
        treatment: how; its own `torque_delay_s` is left aside.

    Raises:
        HaptidError: as `treat` and `observe` do.
    """
    dt, motions = float(logs[0].dt), [treat(log, replace(treatment, torque_delay_s=0.0)) for log in logs]
    guess, step = 0.0, STEPS[0]
    trio: list[Observation] = []
    for step in STEPS:
        late = [(guess + k * step) * dt for k in (-1, 0, 1)]
        trio = [_observed(model, motions, seconds) for seconds in late]
        weights = WLS().weights(trio[1])
        lowest = _lowest(trio, weights)
        if lowest is None or abs(guess + step * lowest) > LONGEST:
            return None
        around, guess = guess, guess + step * lowest
    group = np.arange(len(trio[1].blocks)) * GROUPS // len(trio[1].blocks)
    left = [_lowest([o.pick(np.flatnonzero(group != g)) for o in trio], weights) for g in range(GROUPS)]
    found = around + step * np.array([value for value in left if value is not None])
    if len(found) < GROUPS:
        return None
    spread = np.sqrt((GROUPS - 1) / GROUPS * np.sum((found - found.mean()) ** 2))
    return Delay(float(guess * dt), float(spread * dt))


def _observed(model: DynamicModel, motions: Sequence[Motion], delay: float) -> Observation:
    return reduce(add, (observe(model, with_delay(motion, delay)) for motion in motions))


def _lowest(trio: Sequence[Observation], weights: Array) -> float | None:
    """Where the parabola through three residual powers has its minimum, in steps from the middle one."""
    before, here, after = (float(observation.stack(weights)[-1, -1]) ** 2 for observation in trio)
    bend = before - 2 * here + after
    return 0.5 * (before - after) / bend if bend > 0 else None
