"""What the core makes rows of, from the states of the active joints, and slopes by it as slopes by the states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._values import Array
from haptid.device import Device
from haptid.signals import external

# Steps of the differences by position, velocity and acceleration.
STEPS = (1e-6, 1e-5, 1e-4)


@dataclass(frozen=True, eq=False)
class Channels:
    """Channels of a motion, (channels, n) each.

    Attributes:
        device: the mechanism.
        states: positions, velocities and accelerations of the active joints, (3, active, n).
        motion: the same of the coordinates that torque rows belong to, and the columns that Python computes.
        loops: of loops whose rates vary; no channels where there are none.
    """

    device: Device
    states: Array
    motion: tuple[Array, Array, Array, Array]
    loops: Array

    @staticmethod
    def of(device: Device, states: Array) -> Channels:
        """Of a device at these states."""
        c, cd, cdd = (np.ascontiguousarray(device.frame @ x) for x in states)
        loops = device.loops(c, cd)
        loops = np.zeros((0, states.shape[2])) if loops is None else loops
        return Channels(device, states, (c, cd, cdd, external(device, c, cd, cdd)), loops)

    @property
    def _own(self) -> Array:
        """The channels that Python makes, (own, n)."""
        return np.concatenate([self.motion[3], self.loops])

    def by_state(self, by_channel: Array) -> Array:
        """Slopes by states, (3, active, n), from those by channels, (channels, n).

        Exact, but for the channels that Python makes: by differences of these.
        """
        own = self._own
        by_motion, by_own = np.split(by_channel, [len(by_channel) - len(own)])
        made = np.asarray(self.device.frame.T @ by_motion.reshape(self.states.shape))
        for s, step in enumerate(STEPS if len(own) else ()):
            for j in range(self.states.shape[1]):
                there = Channels.of(self.device, moved(self.states, s, j, step))
                made[s, j] += (by_own * (there._own - own)).sum(axis=0) / step
        return made


def moved(states: Array, s: int, j: int, step: float) -> Array:
    """The states with one of them moved."""
    made = states.copy()
    made[s, j] += step
    return made
