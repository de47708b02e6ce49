"""What the core makes rows of, from a motion of the coordinates, and slopes by it as slopes by that motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.device import Device
from haptid.motion.channels import external

# Steps of the differences by position, velocity and acceleration.
STEPS = (1e-6, 1e-5, 1e-4)


@dataclass(frozen=True, eq=False)
class CoreChannels:
    """Channels of a motion, (channels, n) each.

    Attributes:
        device: the mechanism.
        motion: positions, velocities and accelerations of the coordinates that torque rows belong to, (3, rows, n).
        own: the columns that Python computes, (externals, n).
        loops: of loops whose rates vary; no channels where there are none.
    """

    device: Device
    motion: Array
    own: Array
    loops: Array

    @staticmethod
    def of(device: Device, motion: Array) -> CoreChannels:
        """Of a device in a motion of its coordinates, (3, rows, n)."""
        c, cd, cdd = motion = np.ascontiguousarray(motion)
        loops = device.loops(c, cd)
        loops = np.zeros((0, motion.shape[2])) if loops is None else loops
        return CoreChannels(device, motion, external(device, c, cd, cdd), loops)

    def torque_slopes(self, chi: Array) -> Array:
        """Slopes of every row's torque by the motion, (rows, 3, rows, n), of parameters of the core's columns, (r,)."""
        columns = np.flatnonzero(chi)
        made = self.device.mechanism.torque_slopes(
            *self.motion, self.own, columns.tolist(), chi[columns].tolist(), self.loops
        )
        return self.by_motion(made)

    def by_motion(self, by_channel: Array) -> Array:
        """Slopes by the motion, (..., 3, rows, n), from those by channels, (..., channels, n).

        Exact, but for the channels that Python makes: by central differences of these.
        """
        made, by_made = np.split(by_channel, [self.motion.shape[0] * self.motion.shape[1]], axis=-2)
        made = made.reshape(*made.shape[:-2], *self.motion.shape).copy()
        for s, step in enumerate(STEPS if by_made.size else ()):
            for j in range(self.motion.shape[1]):
                change = self._python_made(s, j, step) - self._python_made(s, j, -step)
                made[..., s, j, :] += (by_made * change).sum(axis=-2) / (2 * step)
        return made

    def _python_made(self, s: int, j: int, step: float) -> Array:
        """The channels that Python makes, (own, n), where one position, velocity or acceleration is another."""
        there = CoreChannels.of(self.device, moved(self.motion, s, j, step))
        return np.concatenate([there.own, there.loops])


def moved(motion: Array, s: int, j: int, step: float) -> Array:
    """The motion with one position, velocity or acceleration moved."""
    made = motion.copy()
    made[s, j] += step
    return made
