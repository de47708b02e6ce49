"""Families of motions that a search can walk through: a point of the unit cube is a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid.experiment.bench.trajectories import Fourier, Kind, Multisine, Triangles, TrianglesAndSines
from haptid.experiment.excitation.limits import Bounds

# Centres are sought in this share of the range, about its middle; further out the strokes would be small.
MIDDLE = 0.5
# Least stroke, as a share of what the centre leaves.
LEAST = 0.3
# A triangle's rounded corners make it this much steeper than four times amplitude times frequency.
STEEPER = 1.13
# Share of the greatest speed that a motion is drawn with.
FILLED = 0.9
# A waveform is looked at in so many points of its shortest period.
POINTS = 16


class Family(Protocol):
    """Motions of one sort."""

    @property
    def affine(self) -> bool:
        """Whether positions, velocities and accelerations are affine in the point of the unit cube."""

    def size(self, joints: int) -> int:
        """Numbers that make one motion of so many joints."""

    def start(self, bounds: Bounds, rng: np.random.Generator) -> Array:
        """A point drawn at random, (size,)."""

    def kind(self, x: Array, bounds: Bounds) -> Kind:
        """The motion at a point of the unit cube, (size,), with strokes and speeds about within the bounds."""


@dataclass(frozen=True)
class FourierSeries:
    """Finite Fourier series of one period, all amplitudes free.

    Source: Swevers et al. (1997), IEEE Trans. Robotics and Automation 13(5).

    Attributes:
        seconds: duration, s: a period and two ramps tell all there is to tell.
        fundamental_hz: one over the period.
        count: harmonics.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float = 13.0
    fundamental_hz: float = 0.1
    count: int = 20
    ramp: float = 1.5

    @property
    def affine(self) -> bool:
        """See Family."""
        return True

    def size(self, joints: int) -> int:
        """A centre, and two amplitudes a harmonic, for each joint."""
        return joints * (1 + 2 * self.count)

    def start(self, bounds: Bounds, rng: np.random.Generator) -> Array:
        """A centre about the middle, and amplitudes that fill the stroke there, or the speed where that is less."""
        joints = len(bounds.names)
        place, reach = rng.random((2, joints))
        centre, stroke = placed(place, reach, bounds)
        low, high = bounds.position.T
        shape, most = rng.normal(size=(joints, 2, self.count)), self._most(bounds)
        angle = np.linspace(0, 2 * np.pi, POINTS * self.count, endpoint=False)[:, None] * np.arange(1, self.count + 1)
        omega, s, c = self._omega, np.sin(angle), np.cos(angle)
        shape *= most
        position = np.abs(shape[:, 0] @ s.T + shape[:, 1] @ c.T).max(axis=1)
        speed = np.abs((omega * shape[:, 0]) @ c.T - (omega * shape[:, 1]) @ s.T).max(axis=1)
        shape *= np.minimum(stroke / position, FILLED * bounds.speed / speed)[:, None, None]
        return np.concatenate([(centre - low) / (high - low), (0.5 + 0.5 * shape / most).ravel()])

    def kind(self, x: Array, bounds: Bounds) -> Fourier:
        """The centre anywhere in the range; amplitudes as large as the range and the speed leave one harmonic."""
        joints = len(bounds.names)
        low, high = bounds.position.T
        centre = low + x[:joints] * (high - low)
        shape = (2 * x[joints:] - 1).reshape(joints, 2, self.count) * self._most(bounds)
        sine, cosine = (tuple(map(tuple, shape[:, k].tolist())) for k in (0, 1))
        return Fourier(self.seconds, tuple(centre.tolist()), self.fundamental_hz, sine, cosine, self.ramp)

    @property
    def _omega(self) -> Array:
        """Of every harmonic, rad/s."""
        return np.asarray(2 * np.pi * self.fundamental_hz * np.arange(1, self.count + 1))

    def _most(self, bounds: Bounds) -> Array:
        """Largest amplitude of every harmonic on its own, (joints, 1, count)."""
        half = np.ptp(bounds.position, axis=1)[:, None, None] / 2
        return np.asarray(np.minimum(half, bounds.speed[:, None, None] / self._omega))


@dataclass(frozen=True)
class TrianglesWithSines:
    """Triangles with multisines on them, as in Janot et al. (2007): centres, strokes and frequencies free.

    Attributes:
        seconds: duration, s.
        slow_hz: lowest and highest frequency of the triangles.
        fast_hz: lowest and highest frequency of the sines.
        count: sines a joint.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float = 30.0
    slow_hz: tuple[float, float] = (0.1, 0.6)
    fast_hz: tuple[float, float] = (0.3, 3.0)
    count: int = 4
    ramp: float = 1.5

    @property
    def affine(self) -> bool:
        """See Family."""
        return False

    def start(self, bounds: Bounds, rng: np.random.Generator) -> Array:
        """Anywhere."""
        return rng.random(self.size(len(bounds.names)))

    def size(self, joints: int) -> int:
        """A centre, a stroke, the sines' share of it and the triangle's frequency for each joint; two frequencies."""
        return 4 * joints + 2

    def kind(self, x: Array, bounds: Bounds) -> TrianglesAndSines:
        """Sines get the speed that the triangles leave, and at least a tenth."""
        joints = len(bounds.names)
        place, reach, share, pace = x[: 4 * joints].reshape(4, joints)
        centre, stroke = placed(place, reach, bounds)
        large = (0.9 - 0.8 * share) * stroke
        slowest, fastest = self.slow_hz
        frequency = slowest * (fastest / slowest) ** pace
        frequency = np.minimum(frequency, 0.9 * bounds.speed / (4 * STEEPER * large))
        left = bounds.speed - 4 * STEEPER * large * frequency
        lowest, highest = self.fast_hz
        low, high = np.sort(lowest * (highest / lowest) ** x[-2:])
        triangles = Triangles(self.seconds, _figures(centre), _figures(large), _figures(frequency), self.ramp)
        band = (float(low), float(max(high, 1.5 * low)))
        sines = Multisine(self.seconds, (0.0,), _figures(stroke - large), band, self.count, _figures(left), self.ramp)
        return TrianglesAndSines(triangles, sines)


def placed(centre: Array, stroke: Array, bounds: Bounds) -> tuple[Array, Array]:
    """Centres and strokes, each (active,), rad or m, from numbers between 0 and 1."""
    low, high = bounds.position.T
    middle = 0.5 * (low + high) + MIDDLE * (high - low) * (centre - 0.5)
    room = np.minimum(high - middle, middle - low)
    return middle, room * (LEAST + (1 - LEAST) * stroke)


def _figures(values: Array) -> tuple[float, ...]:
    return tuple(float(v) for v in values)
