"""Dry friction with presliding: a force that builds up over a distance after every reversal, and depends on history."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Laws of a state between -1 and 1 that follows the displacement, and their searchable constants.
LAWS = {
    "dahl": ("distance",),
    "maxwell-slip": ("distance",),
    "lugre": ("distance", "velocity", "breakaway"),
}


@dataclass(frozen=True)
class Presliding:
    """Column of dry friction with presliding: sgn(v) after sliding far enough, between -1 and 1 before.

    With the displacement x and the direction s of a step, the state h of each law is integrated exactly:

    - Dahl: dh/dx = (1 - s h) / distance. Source: Dahl (1968), Aerospace Corp. TOR-0158(3107-18), with exponent 1.
    - Maxwell-slip: dh/dx = 1 / distance within -1 <= h <= 1. Several of them in parallel, with their own distances, are
      the generalised model. Source: Lampaert, Swevers and Al-Bender (2002), IEEE Trans. Automatic Control 47(4), of
      constant break-away force.
    - LuGre: dh/dx = (1 - s h / G(v)) / distance, G = 1 + (breakaway - 1) exp(-(v / velocity)^2), without the damping of
      the bristles. Source: Canudas de Wit, Olsson, Astrom and Lischinsky (1995), IEEE Trans. Automatic Control 40(3),
      (1)-(2), with the parameter as Coulomb friction and sigma0 = parameter / distance.

    Where no history is known, the column is that of sliding, smoothed by `width`.

    Attributes:
        law: one of LAWS.
        distance: over which the force builds up, rad or m.
        velocity: Stribeck velocity of LuGre friction, rad/s or m/s.
        breakaway: force at the start of sliding over Coulomb friction, of LuGre friction.
        width: tanh(v / width) replaces sgn v where no history is known, rad/s or m/s; 0 is sgn.
    """

    law: str
    distance: float
    velocity: float = 1.0
    breakaway: float = 1.0
    width: float = 0.0

    @property
    def text(self) -> str:
        """The law with its constants."""
        return f"{self.law} ({', '.join(f'{name} {getattr(self, name):g}' for name in LAWS[self.law])})"

    def with_constant(self, name: str, value: float) -> Presliding:
        """The same law with another value of a constant."""
        return replace(self, **{name: value})  # type: ignore[arg-type]

    def sliding(self, v: Array) -> Array:
        """The column of steady sliding, (samples,), from velocities."""
        return np.asarray((np.tanh(v / self.width) if self.width else np.sign(v)) * self._level(v))

    def along(self, x: Array, v: Array) -> Array:
        """The column along consecutive samples, (samples,), from positions and velocities; it begins at zero."""
        steps = np.diff(x)
        if self.law == "maxwell-slip":
            return _stop(np.cumsum(steps / self.distance))
        level = self._level(0.5 * (v[1:] + v[:-1]))
        decay = np.exp(-np.abs(steps) / (self.distance * level))
        return _recursion(decay, np.sign(steps) * level * (1.0 - decay))

    def after(self, h: float, step: float, v: float) -> float:
        """The column after one more step of the position, from its value before; v is the velocity on the way."""
        if self.law == "maxwell-slip":
            return min(1.0, max(-1.0, h + step / self.distance))
        level = float(self._level(np.array([v]))[0])
        sliding = float(np.sign(step)) * level
        return sliding + (h - sliding) * float(np.exp(-abs(step) / (self.distance * level)))

    def _level(self, v: Array) -> Array:
        """Magnitude of steady sliding at a velocity, over Coulomb friction."""
        if self.law != "lugre":
            return np.ones_like(v)
        return np.asarray(1.0 + (self.breakaway - 1.0) * np.exp(-((v / self.velocity) ** 2)))


def _recursion(decay: Array, added: Array) -> Array:
    """h[0] = 0, h[k + 1] = decay[k] h[k] + added[k]: a bidiagonal system, solved forwards."""
    samples = len(decay) + 1
    band = np.ones((2, samples))
    band[1, :-1] = -decay
    from scipy.linalg import lapack  # a third of what `haptid model` would load, and few devices have such friction

    solution, _ = lapack.dtbtrs(band, np.concatenate([[0.0], added])[:, None], uplo="L")
    return np.ascontiguousarray(solution[:, 0])


def _stop(u: Array) -> Array:
    """The stop operator h[k + 1] = clip(h[k] + u[k + 1] - u[k], -1, 1) from h[0] = 0, (samples,); u without its 0.

    Between turning points u is monotone, so that one bound applies to the whole stretch: the loop is over these alone.
    """
    u = np.concatenate([[0.0], u])
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u)))) + 1
    ends = np.concatenate([turns, [len(u) - 1]])
    starts = np.concatenate([[0], turns])
    h, offsets = 0.0, []
    for change, begin in zip((u[ends] - u[starts]).tolist(), u[starts].tolist(), strict=True):
        offsets.append(h - begin)
        h = min(1.0, max(-1.0, h + change))
    lengths = ends - starts
    lengths[-1] += 1
    return np.asarray(np.clip(u + np.repeat(offsets, lengths), -1.0, 1.0))
