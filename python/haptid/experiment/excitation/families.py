"""Parametrised families of exciting motions: every point of the unit cube is a motion."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.experiment.bench.trajectories import (
    Figures,
    Fourier,
    Multisine,
    TrajectoryKind,
    Triangles,
    TrianglesAndSines,
)
from haptid.experiment.excitation.limits import MotionBounds

# Centres lie in this share of the range, about its middle; further out the strokes would be small.
MIDDLE = 0.5
# Minimum stroke, relative to the room that the centre leaves.
_LEAST = 0.3
# Slope of a triangle with rounded corners, relative to four times amplitude times frequency.
STEEPER = 1.13
# Share of the maximum speed that initial motions use.
FILLED = 0.9
# A Fourier series has no random phases.
_NO_PHASES = np.random.default_rng(0)
# Points per shortest period at which a waveform is evaluated.
_POINTS = 16


@dataclass(frozen=True, eq=False)
class Basis:
    """States of a motion as an affine function of its point, joint by joint, so that the search makes no plan.

    Attributes:
        offset: states at the point of zeros, (3, active, n).
        own: which entries of the point move each joint, (k,) for each.
        functions: states by these entries, (3 n, k) for each joint.
    """

    offset: Array
    own: tuple[Array, ...]
    functions: tuple[Array, ...]

    def states(self, x: Array) -> Array:
        """Positions, velocities and accelerations, (3, active, n), at a point, (size,)."""
        made = self.offset.copy()
        for j, (own, functions) in enumerate(zip(self.own, self.functions, strict=True)):
            made[:, j] += (functions @ x[own]).reshape(3, -1)
        return made

    def gradient(self, by_state: Array, size: int) -> Array:
        """Gradient by the point, (size,), from that by the states, (3, active, n)."""
        made = np.zeros(size)
        for j, (own, functions) in enumerate(zip(self.own, self.functions, strict=True)):
            made[own] += by_state[:, j].ravel() @ functions
        return made

    def rows(self, sample: np.ndarray, slopes: Array, size: int) -> Array:
        """Derivatives by the point, (m, size), of what has derivatives by the states of single samples.

        Args:
            sample: which, (m,).
            slopes: derivatives by their states, (3, active, m).
            size: of a point.
        """
        made = np.zeros((len(sample), size))
        for j, (own, functions) in enumerate(zip(self.own, self.functions, strict=True)):
            at = functions.reshape(3, -1, len(own))[:, sample]
            made[:, own] = np.einsum("sm,smk->mk", slopes[:, j], at)
        return made


class Family(Protocol):
    """Protocol of a parametrised family of motions."""

    def basis(self, bounds: MotionBounds, dt: float) -> Basis | None:
        """The states as an affine function of the point of the unit cube, in steps of dt, s; None where they bend."""

    @property
    def least_rows_hz(self) -> float:
        """Rows per second below which the sums over the rows depend on them."""

    def peaks(self, dt: float) -> float:
        """How far peaks between rows in steps of dt, s, may lie above those at rows, relative to these."""

    def size(self, joints: int) -> int:
        """Number of parameters of a motion."""

    def start(self, bounds: MotionBounds, rng: np.random.Generator) -> Array:
        """A random point, (size,)."""

    def kind(self, x: Array, bounds: MotionBounds) -> TrajectoryKind:
        """The motion at a point of the unit cube, (size,), with strokes and speeds roughly within the bounds."""


@dataclass(frozen=True)
class FourierSeries:
    """Finite Fourier series of one common period, all amplitudes free.

    Source: Swevers et al. (1997), IEEE Trans. Robotics and Automation 13(5).

    Attributes:
        seconds: duration, s: one period plus two ramps has all the information of a longer motion.
        fundamental_hz: one over the period.
        count: harmonics.
        ramp: duration of the start, and of the stop, s.
        start_pose: pose of rest before and after the motion, of each active joint, rad or m; None for the centre.
    """

    seconds: float = 13.0
    fundamental_hz: float = 0.1
    count: int = 20
    ramp: float = 1.5
    start_pose: Figures | None = None

    def basis(self, bounds: MotionBounds, dt: float) -> Basis:
        """See Family."""
        joints, size = len(bounds.names), 2 * self.count
        units = np.eye(size).reshape(size, 2, self.count)
        sine, cosine = (tuple(map(tuple, units[:, k].tolist())) for k in (0, 1))
        wave = Fourier(self.seconds, (0.0,), self.fundamental_hz, sine, cosine, self.ramp)
        waves = np.array(wave.motion([f"{k}" for k in range(size)], dt, _NO_PHASES))
        resting = self.kind(np.full(self.size(joints), 0.5), bounds)
        names = bounds.names
        level = np.array(replace(resting, centre=tuple(bounds.position[:, 0])).motion(names, dt, _NO_PHASES))
        upper = np.array(replace(resting, centre=tuple(bounds.position[:, 1])).motion(names, dt, _NO_PHASES))
        own, functions, offset = [], [], np.ascontiguousarray(level.transpose(0, 2, 1))
        for j, most in enumerate(np.tile(self._most(bounds), (1, 2, 1)).reshape(joints, size)):
            own.append(np.r_[j, joints + j * size : joints + (j + 1) * size])
            made = np.concatenate([(upper - level)[:, :, j, None], 2 * most * waves], axis=2).reshape(-1, 1 + size)
            functions.append(np.ascontiguousarray(made))
            offset[:, j] -= waves @ most
        return Basis(offset, tuple(own), tuple(functions))

    def size(self, joints: int) -> int:
        """A centre, and two amplitudes per harmonic, for each joint."""
        return joints * (1 + 2 * self.count)

    def start(self, bounds: MotionBounds, rng: np.random.Generator) -> Array:
        """A centre near the middle, and amplitudes that use the available stroke or the maximum speed."""
        joints = len(bounds.names)
        place, reach = rng.random((2, joints))
        centre, stroke = _placed(place, reach, bounds)
        low, high = bounds.position.T
        shape, most = rng.normal(size=(joints, 2, self.count)), self._most(bounds)
        angle = np.linspace(0, 2 * np.pi, _POINTS * self.count, endpoint=False)[:, None] * np.arange(1, self.count + 1)
        omega, s, c = self._omega, np.sin(angle), np.cos(angle)
        shape *= most
        position = np.abs(shape[:, 0] @ s.T + shape[:, 1] @ c.T).max(axis=1)
        speed = np.abs((omega * shape[:, 0]) @ c.T - (omega * shape[:, 1]) @ s.T).max(axis=1)
        shape *= np.minimum(stroke / position, FILLED * bounds.speed / speed)[:, None, None]
        return np.concatenate([(centre - low) / (high - low), (0.5 + 0.5 * shape / most).ravel()])

    def kind(self, x: Array, bounds: MotionBounds) -> Fourier:
        """The centre anywhere in the range; amplitudes up to what range and speed allow a single harmonic."""
        joints = len(bounds.names)
        low, high = bounds.position.T
        centre = low + x[:joints] * (high - low)
        shape = (2 * x[joints:] - 1).reshape(joints, 2, self.count) * self._most(bounds)
        sine, cosine = (tuple(map(tuple, shape[:, k].tolist())) for k in (0, 1))
        return Fourier(
            self.seconds, tuple(centre.tolist()), self.fundamental_hz, sine, cosine, self.ramp, self.start_pose
        )

    @property
    def least_rows_hz(self) -> float:
        """See Family: rows are products of up to four states."""
        return 6.0 * self.highest_hz

    def peaks(self, dt: float) -> float:
        """See Family: halfway between two rows, the last harmonic is this far above them."""
        return 1.0 - math.cos(math.pi * self.highest_hz * dt)

    @property
    def highest_hz(self) -> float:
        """Frequency of the last harmonic."""
        return self.count * self.fundamental_hz

    @property
    def _omega(self) -> Array:
        """Angular frequency of every harmonic, rad/s."""
        return np.asarray(2 * np.pi * self.fundamental_hz * np.arange(1, self.count + 1))

    def _most(self, bounds: MotionBounds) -> Array:
        """Maximum amplitude of every harmonic on its own, (joints, 1, count)."""
        half = np.ptp(bounds.position, axis=1)[:, None, None] / 2
        return np.asarray(np.minimum(half, bounds.speed[:, None, None] / self._omega))


@dataclass(frozen=True)
class TrianglesWithSines:
    """Triangles plus multisines, as in Janot et al. (2007): centres, strokes and frequencies free.

    Attributes:
        seconds: duration, s.
        slow_hz: lowest and highest frequency of the triangles.
        fast_hz: lowest and highest frequency of the sines.
        count: number of sines per joint.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float = 30.0
    slow_hz: tuple[float, float] = (0.1, 0.6)
    fast_hz: tuple[float, float] = (0.3, 3.0)
    count: int = 4
    ramp: float = 1.5

    @property
    def least_rows_hz(self) -> float:
        """See Family: the corners of triangles have harmonics of their own."""
        return math.inf

    def peaks(self, dt: float) -> float:
        """See Family."""
        return 1.0 - math.cos(math.pi * self.fast_hz[1] * dt)

    def basis(self, bounds: MotionBounds, dt: float) -> None:
        """See Family."""
        del bounds, dt

    def start(self, bounds: MotionBounds, rng: np.random.Generator) -> Array:
        """Uniform in the unit cube."""
        return rng.random(self.size(len(bounds.names)))

    def size(self, joints: int) -> int:
        """Centre, stroke, the sines' share of it and the triangle's frequency for each joint; two frequencies."""
        return 4 * joints + 2

    def kind(self, x: Array, bounds: MotionBounds) -> TrianglesAndSines:
        """The sines get the speed that the triangles leave, and at least a tenth of the stroke."""
        joints = len(bounds.names)
        place, reach, share, pace = x[: 4 * joints].reshape(4, joints)
        centre, stroke = _placed(place, reach, bounds)
        large = (0.9 - 0.8 * share) * stroke
        slowest, fastest = self.slow_hz
        frequency = slowest * (fastest / slowest) ** pace
        frequency = np.minimum(frequency, 0.9 * bounds.speed / (4 * STEEPER * large))
        left = bounds.speed - 4 * STEEPER * large * frequency
        lowest, highest = self.fast_hz
        low, high = np.sort(lowest * (highest / lowest) ** x[-2:])
        centres, amplitudes, frequencies = (tuple(x.tolist()) for x in (centre, large, frequency))
        band = (float(low), float(max(high, 1.5 * low)))
        strokes, speeds = (tuple(x.tolist()) for x in (stroke - large, left))
        return TrianglesAndSines(
            Triangles(self.seconds, centres, amplitudes, frequencies, self.ramp),
            Multisine(self.seconds, (0.0,), strokes, band, self.count, speeds, self.ramp),
        )


def _placed(centre: Array, stroke: Array, bounds: MotionBounds) -> tuple[Array, Array]:
    """Centres and strokes, each (active,), rad or m, from numbers between 0 and 1."""
    low, high = bounds.position.T
    middle = 0.5 * (low + high) + MIDDLE * (high - low) * (centre - 0.5)
    room = np.minimum(high - middle, middle - low)
    return middle, room * (_LEAST + (1 - _LEAST) * stroke)
