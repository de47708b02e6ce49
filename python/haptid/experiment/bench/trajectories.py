"""Planned motions for the bench with analytical derivatives, smooth from rest to rest.

Every kind of motion is a small frozen type; `plan` makes a `Trajectory` of it. Settings have one value for all active
joints, or one for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import Protocol

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.elastic import rotors, without_torsion
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExperimentError, TrajectoryError

Figures = tuple[float, ...]
Rates = tuple[Array, Array, Array]
# Sharpness of a triangle's corners: 1 is a true corner, with unbounded acceleration.
SHARPNESS = 0.98
# Largest speed and acceleration of a quintic move of unit distance and duration; shortest move between poses, s.
QUINTIC_SPEED, QUINTIC_ACCELERATION, _LEAST_MOVE = 1.875, 10 / np.sqrt(3), 0.2
# Relative spread of a multisine's frequencies around a geometric series, so that two motions do not share frequencies.
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
        freeze_fields(self, "q", qd=self.q.shape, qdd=self.q.shape)

    def __len__(self) -> int:
        return len(self.q)

    @property
    def t(self) -> Array:
        """Sample times, (n,), s."""
        return freeze(np.asarray(self.dt * np.arange(len(self)), dtype=float))


class TrajectoryKind(Protocol):
    """Protocol of a kind of motion."""

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Position, velocity and acceleration of the joints of these names, each (n, joints)."""


def plan(kind: TrajectoryKind, model: DynamicModel, dt: float, rng: np.random.Generator) -> Trajectory:
    """Plan the motion of the active joints; rotors of elastic motors follow without torsion.

    Args:
        kind: of motion.
        dt: step, s.
        rng: for phases and frequencies.

    Raises:
        ExperimentError: a setting has neither one value nor one for each active joint.
        TrajectoryError: the duration is shorter than the two ramps.
    """
    device = model.device
    links = np.delete(device.active, rotors(device)).tolist()
    rates = kind.motion([device.joints[j].name for j in links], dt, rng)
    return Trajectory(dt, *(without_torsion(device, x, order == 0) for order, x in enumerate(rates)))


@dataclass(frozen=True)
class Multisine:
    """Multisine for each joint, amplitudes inverse to frequency: excites inertia, gravity and friction together.

    Attributes:
        seconds: duration, s.
        centre, amplitude: centre, and maximum distance from it, rad or m.
        frequencies_hz: lowest and highest.
        count: number of sines per joint.
        speed: maximum velocity, lowers the amplitude where needed, rad/s or m/s; None for no limit.
        ramp: duration of the start, and of the stop, s.
        period: s, after which the motion repeats between start and stop; None where it does not.
    """

    seconds: float
    centre: Figures
    amplitude: Figures
    frequencies_hz: tuple[float, float] = (0.25, 2.4)
    count: int = 4
    speed: Figures | None = None
    ramp: float = 1.5
    period: float | None = None

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Phases, and frequencies of a motion that does not repeat, from `rng`."""
        t, joints = _times(self.seconds, dt), len(names)
        if self.period is None:
            series = np.geomspace(*self.frequencies_hz, self.count)
            f = series * (1 + SPREAD * rng.uniform(-1, 1, (joints, self.count)))
        else:
            f = np.tile(self._multiples(self.period), (joints, 1))
        omega, phase = 2 * np.pi * f[:, :, None], rng.uniform(0, 2 * np.pi, (joints, self.count, 1))
        angle, weight = omega * t + phase, (f[:, :1] / f)[:, :, None]
        x = np.sum(weight * np.sin(angle), axis=1).T
        xd = np.sum(weight * omega * np.cos(angle), axis=1).T
        xdd = np.sum(-weight * omega**2 * np.sin(angle), axis=1).T
        scale = per_coordinate("amplitude", self.amplitude, names) / np.abs(x).max(axis=0)
        if self.speed is not None:
            scale = np.minimum(scale, per_coordinate("speed", self.speed, names) / np.abs(xd).max(axis=0))
        return _windowed(
            t, self.ramp, per_coordinate("centre", self.centre, names), (scale * x, scale * xd, scale * xdd)
        )

    def _multiples(self, period: float) -> Array:
        """The multiples of one over the period that are nearest to a geometric series, each once, (count,), Hz."""
        low, high = self.frequencies_hz
        first, last = max(1, int(np.ceil(low * period - 1e-9))), int(np.floor(high * period + 1e-9))
        room = max(last - first + 1, 0)
        if self.count > room:
            raise ExperimentError(
                f"a period of {period:g} s has {room} frequencies from {low:g} to {high:g} Hz, for {self.count} sines.",
                where="trajectory",
                found=float(self.count),
                limit=float(room),
                advice=f"Take a period of at least {_enough(self.count, self.frequencies_hz):g} s, or fewer sines.",
            )
        order = np.arange(self.count)
        k = np.clip(np.round(np.geomspace(first, last, self.count)), first + order, last - order[::-1])
        # Neighbours that fall on one multiple move up: the rest of the series has room by the limit above.
        return np.asarray(np.maximum.accumulate(k - order) + order) / period


def _enough(count: int, band: tuple[float, float]) -> float:
    """Shortest period, rounded up to 0.01 s, for which a frequency band contains at least `count` harmonics, s."""
    low, high = band
    return float(np.ceil(100 * (count / (high - low) if high > low else count / high)) / 100)


@dataclass(frozen=True)
class Triangles:
    """Triangular motion with rounded corners (nearly constant velocity): excites gravity and friction.

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
        waves = _triangle(t, per_coordinate("frequency_hz", self.frequency_hz, names), phase)
        amplitude = per_coordinate("amplitude", self.amplitude, names)
        x, xd, xdd = (amplitude * wave for wave in waves)
        return _windowed(t, self.ramp, per_coordinate("centre", self.centre, names), (x, xd, xdd))


@dataclass(frozen=True)
class TrianglesAndSines:
    """Triangles plus a smaller multisine: excites all parameters in one motion (Janot et al. 2007).

    Attributes:
        triangles: the slow part.
        sines: the fast part, centred on zero, of the same duration.
    """

    triangles: Triangles
    sines: Multisine

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Sum of the two."""
        q, qd, qdd = (
            slow + fast
            for slow, fast in zip(self.triangles.motion(names, dt, rng), self.sines.motion(names, dt, rng), strict=True)
        )
        return q, qd, qdd


@dataclass(frozen=True)
class Fourier:
    """Finite Fourier series for each joint, of one common period, faded in and out.

    Source: Swevers et al. (1997), IEEE Trans. Robotics and Automation 13(5), with amplitudes of position.

    Attributes:
        seconds: duration, s.
        centre: rad or m.
        fundamental_hz: one over the period.
        sine, cosine: amplitudes of the first, second, ... harmonic, for each joint, rad or m.
        ramp: duration of the start, and of the stop, s.
        start: pose of rest before the motion and after it, rad or m; None for the centre.
    """

    seconds: float
    centre: Figures
    fundamental_hz: float
    sine: tuple[Figures, ...]
    cosine: tuple[Figures, ...]
    ramp: float = 1.5
    start: Figures | None = None

    @property
    def highest_hz(self) -> float:
        """Frequency of the last harmonic."""
        return self.fundamental_hz * max(map(len, self.sine), default=0)

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Deterministic.

        Raises:
            ExperimentError: not one series for each joint, or sines and cosines of different length.
        """
        del rng
        sine, cosine = (series(name, getattr(self, name), names) for name in ("sine", "cosine"))
        if sine.shape != cosine.shape:
            raise _value_count("cosine", cosine.shape[1], [f"harmonic {k + 1}" for k in range(sine.shape[1])])
        t = _times(self.seconds, dt)
        omega = 2 * np.pi * self.fundamental_hz * np.arange(1, sine.shape[1] + 1)
        s, c = np.sin(omega * t[:, None]), np.cos(omega * t[:, None])
        x = s @ sine.T + c @ cosine.T
        xd = c @ (omega * sine).T - s @ (omega * cosine).T
        xdd = -s @ (omega**2 * sine).T - c @ (omega**2 * cosine).T
        centre = per_coordinate("centre", self.centre, names)
        rest = centre if self.start is None else per_coordinate("start", self.start, names)
        return _windowed(t, self.ramp, rest, (x + (centre - rest), xd, xdd))


@dataclass(frozen=True)
class Sweep:
    """Constant-velocity strokes in both directions, joint after joint, speed after speed: friction against velocity.

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
        """Deterministic."""
        del rng
        # (joint, start, distance, speed) of every stroke; speed 0 for a quintic move between strokes.
        strokes: list[tuple[int, float, float, float]] = []
        at = 0.0
        for j, reach in enumerate(per_coordinate("amplitude", self.amplitude, names)):
            strokes.append((j, at, -reach, 0.0))
            at += 2 * self.ramp
            for speed in self.speeds:
                for distance in (2 * reach, -2 * reach):
                    strokes.append((j, at, distance, speed))
                    at += abs(distance) / speed + self.ramp
            strokes.append((j, at, reach, 0.0))
            at += 2 * self.ramp
        t = _times(at, dt)
        made = np.zeros((3, len(t), len(names)))
        made[0] = per_coordinate("centre", self.centre, names)
        for j, start, distance, speed in strokes:
            moved = run(t - start, distance, speed, self.ramp) if speed else move(t - start, distance, 2 * self.ramp)
            made[:, :, j] += moved
        return made[0], made[1], made[2]


@dataclass(frozen=True)
class HeldPoses:
    """Held poses, one after the other, each joint in a straight line between them: gravity and stiction.

    Attributes:
        poses: one position for each active joint in each, rad or m; the first and the last are not held.
        speed: maximum of each joint on the way, rad/s or m/s.
        acceleration: maximum of each joint on the way, rad/s^2 or m/s^2; None for no limit.
        dwell: duration of every hold, s.
        approach: every pose is reached twice, from this distance below in all joints and from this distance above, so
            that friction separates from gravity, rad or m; None reaches it once, from the pose before.
    """

    poses: tuple[Figures, ...]
    speed: Figures
    acceleration: Figures | None = None
    dwell: float = 1.0
    approach: Figures | None = None

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Deterministic."""
        del rng
        stops, seconds = self.stops(names)
        return _held(stops, seconds, dt)

    def stops(self, names: list[str]) -> tuple[list[tuple[Array, float]], list[float]]:
        """Where the joints stop and for how long, s; and the duration of every move between two of them, s.

        Raises:
            ExperimentError: not one position for each joint, or fewer than two poses.
        """
        if len(self.poses) < 2:
            raise _value_count("poses", len(self.poses), ["the first", "the last"])
        poses = [per_coordinate("poses", pose, names) for pose in self.poses]
        offset = None if self.approach is None else per_coordinate("approach", self.approach, names)
        stops = [(poses[0], 0.0), *_both_sides(poses[1:-1], self.dwell, offset), (poses[-1], self.dwell)]
        speed = per_coordinate("speed", self.speed, names)
        most = per_coordinate("acceleration", self.acceleration or (np.inf,), names)
        seconds = []
        for (here, _), (there, _) in pairwise(stops):
            distance = np.abs(there - here)
            by_rates = (QUINTIC_SPEED * distance / speed, np.sqrt(QUINTIC_ACCELERATION * distance / most))
            seconds.append(max(_LEAST_MOVE, *(float(x.max()) for x in by_rates)))
        return stops, seconds


@dataclass(frozen=True)
class Grid:
    """Held poses on a grid; consecutive ones are neighbours.

    Attributes:
        centre, amplitude: rad or m.
        points: positions of each joint.
        dwell, move: duration of every hold, and of every move between poses, s.
        approach: see `HeldPoses`.
    """

    centre: Figures
    amplitude: Figures
    points: int = 3
    dwell: float = 1.0
    move: float = 1.0
    approach: Figures | None = None

    def motion(self, names: list[str], dt: float, rng: np.random.Generator) -> Rates:
        """Deterministic."""
        del rng
        centre, amplitude = (
            per_coordinate("centre", self.centre, names),
            per_coordinate("amplitude", self.amplitude, names),
        )
        steps = np.linspace(-1, 1, self.points) if self.points > 1 else np.zeros(1)
        poses = [centre + amplitude * pose for pose in _snake(steps, len(names))]
        offset = None if self.approach is None else per_coordinate("approach", self.approach, names)
        stops = [(centre, 0.0), *_both_sides(poses, self.dwell, offset), (centre, self.dwell)]
        return _held(stops, [self.move] * (len(stops) - 1), dt)


def _both_sides(poses: list[Array], dwell: float, offset: Array | None) -> list[tuple[Array, float]]:
    """Stops at poses, each from both sides where a distance is given."""
    if offset is None:
        return [(pose, dwell) for pose in poses]
    return [stop for pose in poses for side in (-offset, offset) for stop in ((pose + side, 0.0), (pose, dwell))]


def _held(stops: list[tuple[Array, float]], seconds: list[float], dt: float) -> Rates:
    """Quintic moves, of these durations, between stops."""
    t = _times(sum(seconds) + sum(dwell for _, dwell in stops[1:]), dt)
    made = np.zeros((3, len(t), len(stops[0][0])))
    made[0] = stops[0][0]
    start = 0.0
    for ((here, _), (there, dwell)), lasts in zip(pairwise(stops), seconds, strict=True):
        s = np.array(move(t - start, 1.0, lasts))
        made += s[:, :, None] * (there - here)
        start += lasts + dwell
    return made[0], made[1], made[2]


def per_coordinate(name: str, figures: Sequence[float], names: list[str]) -> Array:
    """Broadcast one value to all names, or check that there is one for each, (names,)."""
    values = np.asarray(figures, dtype=float)
    if values.size not in (1, len(names)):
        raise _value_count(name, values.size, names)
    return np.ascontiguousarray(np.broadcast_to(values, len(names)))


def series(name: str, figures: Sequence[Figures], names: list[str]) -> Array:
    """Fourier amplitudes as an array, (names, terms); every name has a series of the same length."""
    if len(figures) != len(names):
        raise _value_count(name, len(figures), names)
    for of, one in zip(names, figures, strict=True):
        if len(one) != len(figures[0]):
            raise _value_count(f"{name} of {of}", len(one), [f"harmonic {k + 1}" for k in range(len(figures[0]))])
    return np.array(figures, dtype=float).reshape(len(names), -1)


def _triangle(t: Array, frequency_hz: Array, phase: Array) -> Rates:
    """Unit triangle wave with rounded corners, asin(k sin) / asin(k), and its two derivatives, each (n, joints)."""
    omega = 2 * np.pi * frequency_hz
    angle = t[:, None] * omega + phase
    s, ds, dds = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
    s, ds, dds = SHARPNESS * s, SHARPNESS * ds, SHARPNESS * dds
    root, peak = np.sqrt(1 - s**2), np.arcsin(SHARPNESS)
    return np.arcsin(s) / peak, ds / root / peak, (dds / root + s * ds**2 / root**3) / peak


def move(t: Array, distance: float, seconds: float) -> Rates:
    """Quintic move from rest to rest, starting at t = 0, each (n,)."""
    u = np.clip(t / seconds, 0, 1)
    s, ds, dds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
    return distance * s, distance / seconds * ds, distance / seconds**2 * dds


def run(t: Array, distance: float, speed: float, ramp: float) -> Rates:
    """Constant-velocity stroke from rest to rest with smooth steps at both ends, starting at t = 0, each (n,)."""
    velocity, lasts = np.sign(distance) * speed, abs(distance) / speed
    up, down = (_step(t, ramp), _step(t - lasts, ramp))
    x, xd, xdd = (a - b for a, b in zip(up, down, strict=True))
    return velocity * x, velocity * xd, velocity * xdd


def _step(t: Array, seconds: float) -> Rates:
    """Integral, value and derivative of a smooth step from 0 to 1 that starts at t = 0, each (n,)."""
    u = np.clip(t / seconds, 0, 1)
    integral = seconds * u**4 * (2.5 - 3 * u + u**2) + np.maximum(t - seconds, 0)
    return np.asarray(integral), u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / seconds


def _snake(steps: Array, joints: int) -> list[Array]:
    """Points of a grid in boustrophedon order: consecutive points differ in one coordinate."""
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
        raise TrajectoryError(
            f"the motion lasts {float(t[-1]):g} s, but its smooth start and stop take {2 * ramp:g} s.",
            where="seconds",
            found=float(t[-1]),
            limit=2 * ramp,
            advice="Make it longer, or shorten `ramp`.",
        )
    first, last = np.clip(t / ramp, 0, 1), np.clip((t[-1] - t) / ramp, 0, 1)
    u, sign = np.where(first < 1, first, last), np.where(first < 1, 1.0, -1.0)
    w = (u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3))[:, None]
    wd = (sign * 140 * u**3 * (1 - u) ** 3 / ramp)[:, None]
    wdd = (420 * u**2 * (1 - u) ** 2 * (1 - 2 * u) / ramp**2)[:, None]
    x, xd, xdd = motion
    return centre + w * x, w * xd + wd * x, w * xdd + 2 * wd * xd + wdd * x


def _value_count(what: str, got: int, names: list[str]) -> ExperimentError:
    return ExperimentError(
        f"{what} has {got} values; write one for all, or {len(names)}, for {', '.join(names)}.",
        where=what,
        found=got,
        limit=len(names),
    )
