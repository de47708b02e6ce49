"""Motions for the bench, from formulas with exact rates: smooth from rest at the start to rest at the end.

Every kind is a small frozen type; `plan` makes a `Trajectory` of it. Figures are one for all active joints, or one for
each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.model import DynamicModel
from haptid.errors import FigureCountError, TrajectoryTooShortError

Figures = tuple[float, ...]
Rates = tuple[Array, Array, Array]
# How sharp the corners of a triangle are: 1 is a true corner, without bound on the acceleration.
SHARPNESS = 0.98
# Frequencies of a multisine are drawn this share around a geometric series, so that no two motions repeat each other.
SPREAD = 0.08


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A planned motion of the active joints on a uniform grid.

    Attributes:
        dt: step, s.
        q, qd, qdd: position, velocity and acceleration, each (n, active), SI.
    """

    dt: float
    q: Array
    qd: Array
    qdd: Array

    def __post_init__(self) -> None:
        for name in ("q", "qd", "qdd"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
            expect(name, getattr(self, name).shape, self.q.shape)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return freeze(np.asarray(self.dt * np.arange(len(self)), dtype=float))


class Kind(Protocol):
    """What every kind of motion can do."""

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Position, velocity and acceleration of the joints of these names, each (n, joints)."""


def plan(kind: Kind, model: DynamicModel, dt: float, rng: np.random.Generator) -> Trajectory:
    """The motion of a device's active joints.

    Args:
        kind: of motion.
        model: what moves.
        dt: step, s.
        rng: for phases and frequencies.

    Raises:
        FigureCountError: a setting has not one figure for each active joint.
        TrajectoryTooShortError: no time is left between start and stop.
    """
    return Trajectory(dt, *kind.motion([model.device.joints[j].name for j in model.device.active], dt, rng))


@dataclass(frozen=True)
class Multisine:
    """A sum of sines for each joint, slower ones larger: excites inertia, gravity and friction together.

    Attributes:
        seconds: duration, s.
        centre, amplitude: greatest distance from the centre, rad or m.
        frequencies_hz: lowest and highest.
        count: sines a joint.
        speed: greatest velocity, which lowers the amplitude where needed, rad/s or m/s; None for no limit.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float
    centre: Figures
    amplitude: Figures
    frequencies_hz: tuple[float, float] = (0.25, 2.4)
    count: int = 4
    speed: Figures | None = None
    ramp: float = 1.5

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Phases and frequencies from `rng`."""
        t, joints = _times(self.seconds, dt), len(names)
        series = np.geomspace(*self.frequencies_hz, self.count)
        f = series * (1 + SPREAD * rng.uniform(-1, 1, (joints, self.count)))
        omega, phase = 2 * np.pi * f[:, :, None], rng.uniform(0, 2 * np.pi, (joints, self.count, 1))
        angle, weight = omega * t + phase, (f[:, :1] / f)[:, :, None]
        x = np.sum(weight * np.sin(angle), axis=1).T
        xd = np.sum(weight * omega * np.cos(angle), axis=1).T
        xdd = np.sum(-weight * omega**2 * np.sin(angle), axis=1).T
        scale = spread("amplitude", self.amplitude, names) / np.abs(x).max(axis=0)
        if self.speed is not None:
            scale = np.minimum(scale, spread("speed", self.speed, names) / np.abs(xd).max(axis=0))
        return _windowed(t, self.ramp, spread("centre", self.centre, names), (scale * x, scale * xd, scale * xdd))


@dataclass(frozen=True)
class Triangles:
    """Nearly constant velocity to and fro, corners rounded: gravity and friction.

    Attributes:
        seconds: duration, s.
        centre, amplitude: rad or m.
        frequency_hz: of the triangle; the speed is four times amplitude times frequency.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float
    centre: Figures
    amplitude: Figures
    frequency_hz: Figures
    ramp: float = 1.5

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Phases from `rng`."""
        t = _times(self.seconds, dt)
        phase = rng.uniform(0, 2 * np.pi, len(names))
        waves = triangle(t, spread("frequency_hz", self.frequency_hz, names), phase)
        size = spread("amplitude", self.amplitude, names)
        x, xd, xdd = (size * wave for wave in waves)
        return _windowed(t, self.ramp, spread("centre", self.centre, names), (x, xd, xdd))


@dataclass(frozen=True)
class TrianglesAndSines:
    """Triangles with a smaller multisine on them: all parameters in one motion (Janot et al. 2007).

    Attributes:
        triangles: the slow part.
        sines: the fast part, about a centre of zero, for as long.
    """

    triangles: Triangles
    sines: Multisine

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """The sum of the two."""
        q, qd, qdd = (
            slow + fast
            for slow, fast in zip(self.triangles.motion(names, dt, rng), self.sines.motion(names, dt, rng), strict=True)
        )
        return q, qd, qdd


@dataclass(frozen=True)
class Fourier:
    """A finite Fourier series for each joint, all of one period, faded in and out.

    Source: Swevers et al. (1997), IEEE Trans. Robotics and Automation 13(5), with amplitudes of position.

    Attributes:
        seconds: duration, s.
        centre: rad or m.
        fundamental_hz: one over the period.
        sine, cosine: amplitudes of the first, second, ... harmonic, for each joint, rad or m.
        ramp: duration of the start, and of the stop, s.
    """

    seconds: float
    centre: Figures
    fundamental_hz: float
    sine: tuple[Figures, ...]
    cosine: tuple[Figures, ...]
    ramp: float = 1.5

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Nothing is drawn.

        Raises:
            FigureCountError: not one series for each joint, or sines and cosines of different length.
        """
        del rng
        sine, cosine = (series(name, getattr(self, name), names) for name in ("sine", "cosine"))
        if sine.shape != cosine.shape:
            raise FigureCountError("cosine", cosine.shape[1], [f"harmonic {k + 1}" for k in range(sine.shape[1])])
        t = _times(self.seconds, dt)
        omega = 2 * np.pi * self.fundamental_hz * np.arange(1, sine.shape[1] + 1)
        s, c = np.sin(omega * t[:, None]), np.cos(omega * t[:, None])
        x = s @ sine.T + c @ cosine.T
        xd = c @ (omega * sine).T - s @ (omega * cosine).T
        xdd = -s @ (omega**2 * sine).T - c @ (omega**2 * cosine).T
        return _windowed(t, self.ramp, spread("centre", self.centre, names), (x, xd, xdd))


@dataclass(frozen=True)
class Sweep:
    """Each joint in turn, to and fro at one constant velocity after the other: friction against velocity.

    Attributes:
        centre, amplitude: rad or m.
        speeds: velocities, rad/s or m/s.
        ramp: duration of every change of velocity, s.
    """

    centre: Figures
    amplitude: Figures
    speeds: Figures
    ramp: float = 0.5

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Nothing is drawn."""
        del rng
        size = spread("amplitude", self.amplitude, names)
        pieces: list[tuple[int, float, float, float]] = []  # joint, start, distance, speed; speed 0 for a smooth move
        at = 0.0
        for j, reach in enumerate(size):
            pieces.append((j, at, -reach, 0.0))
            at += 2 * self.ramp
            for speed in self.speeds:
                for way in (2 * reach, -2 * reach):
                    pieces.append((j, at, way, speed))
                    at += abs(way) / speed + self.ramp
            pieces.append((j, at, reach, 0.0))
            at += 2 * self.ramp
        t = _times(at, dt)
        made = np.zeros((3, len(t), len(names)))
        made[0] = spread("centre", self.centre, names)
        for j, start, way, speed in pieces:
            moved = run(t - start, way, speed, self.ramp) if speed else move(t - start, way, 2 * self.ramp)
            made[:, :, j] += moved
        return made[0], made[1], made[2]


@dataclass(frozen=True)
class Grid:
    """Poses of a grid, held still one after the other: gravity, and stiction.

    Attributes:
        centre, amplitude: rad or m.
        points: positions of each joint.
        dwell, move: duration of every pose, and of every change, s.
    """

    centre: Figures
    amplitude: Figures
    points: int = 3
    dwell: float = 1.0
    move: float = 1.0

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Nothing is drawn; neighbours in time are neighbours on the grid."""
        del rng
        centre, size = spread("centre", self.centre, names), spread("amplitude", self.amplitude, names)
        steps = np.linspace(-1, 1, self.points) if self.points > 1 else np.zeros(1)
        poses = [np.zeros(len(names)), *_snake(steps, len(names)), np.zeros(len(names))]
        t = _times((len(poses) - 1) * (self.move + self.dwell), dt)
        made = np.zeros((3, len(t), len(names)))
        made[0] = centre + size * poses[0]
        for k, (here, there) in enumerate(pairwise(poses)):
            s = np.array(move(t - k * (self.move + self.dwell), 1.0, self.move))
            made += s[:, :, None] * (size * (there - here))
        return made[0], made[1], made[2]


def spread(name: str, figures: Sequence[float], names: list[str]) -> Array:
    """One figure for each name, (names,)."""
    values = np.asarray(figures, dtype=float)
    if values.size not in (1, len(names)):
        raise FigureCountError(name, values.size, names)
    return np.ascontiguousarray(np.broadcast_to(values, len(names)))


def series(name: str, figures: Sequence[Figures], names: list[str]) -> Array:
    """One series of as many terms for each name, (names, terms)."""
    if len(figures) != len(names):
        raise FigureCountError(name, len(figures), names)
    for of, one in zip(names, figures, strict=True):
        if len(one) != len(figures[0]):
            raise FigureCountError(f"{name} of {of}", len(one), [f"harmonic {k + 1}" for k in range(len(figures[0]))])
    return np.array(figures, dtype=float).reshape(len(names), -1)


def triangle(t: Array, frequency_hz: Array, phase: Array) -> Rates:
    """A triangle of unit amplitude with rounded corners, asin(k sin) / asin(k), and its rates, each (n, joints)."""
    omega = 2 * np.pi * frequency_hz
    angle = t[:, None] * omega + phase
    s, se, sdd = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
    s, se, sdd = SHARPNESS * s, SHARPNESS * se, SHARPNESS * sdd
    root, peak = np.sqrt(1 - s**2), np.arcsin(SHARPNESS)
    return np.arcsin(s) / peak, se / root / peak, (sdd / root + s * se**2 / root**3) / peak


def move(t: Array, distance: float, seconds: float) -> Rates:
    """From rest to rest by a quintic, beginning at t = 0, each (n,)."""
    u = np.clip(t / seconds, 0, 1)
    s, se, sdd = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
    return distance * s, distance / seconds * se, distance / seconds**2 * sdd


def run(t: Array, distance: float, speed: float, ramp: float) -> Rates:
    """From rest to rest at a constant velocity, reached and left by a smooth step, beginning at t = 0, each (n,)."""
    velocity, lasts = np.sign(distance) * speed, abs(distance) / speed
    up, down = (_step(t, ramp), _step(t - lasts, ramp))
    x, xd, xdd = (a - b for a, b in zip(up, down, strict=True))
    return velocity * x, velocity * xd, velocity * xdd


def _step(t: Array, seconds: float) -> Rates:
    """Integral, value and rate of a smooth step from 0 to 1 that begins at t = 0, each (n,)."""
    u = np.clip(t / seconds, 0, 1)
    integral = seconds * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - seconds, 0)
    return np.asarray(integral), u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / seconds


def _snake(steps: Array, joints: int) -> list[Array]:
    """Points of a grid, each but one coordinate away from the one before."""
    found: list[Array] = []
    for index in product(range(len(steps)), repeat=joints):
        turned = [i if sum(index[:k]) % 2 == 0 else len(steps) - 1 - i for k, i in enumerate(index)]
        found.append(np.array([steps[i] for i in turned]))
    return found


def _times(seconds: float, dt: float) -> Array:
    return np.asarray(dt * np.arange(round(seconds / dt) + 1), dtype=float)


def _windowed(t: Array, ramp: float, centre: Array, motion: Rates) -> Rates:
    """Motion about the centre, faded in and out over `ramp` by a window with three continuous derivatives."""
    if t[-1] < 2 * ramp or ramp <= 0:
        raise TrajectoryTooShortError(float(t[-1]), 2 * ramp)
    first, last = np.clip(t / ramp, 0, 1), np.clip((t[-1] - t) / ramp, 0, 1)
    u, way = np.where(first < 1, first, last), np.where(first < 1, 1.0, -1.0)
    w = (u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3))[:, None]
    wd = (way * 140 * u**3 * (1 - u) ** 3 / ramp)[:, None]
    wdd = (420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / ramp**2)[:, None]
    x, xd, xdd = motion
    return centre + w * x, w * xd + wd * x, w * xdd + 2 * wd * xd + wdd * x
