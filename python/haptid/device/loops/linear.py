"""How all joints follow the active ones: positions and rates, and the closure whose rates are constant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, expect, read_only
from haptid.device.device import Cut


@dataclass(frozen=True, eq=False)
class Followed:
    """Where all joints are, and how they follow the active ones there.

    Attributes:
        q: positions of all joints, (joints, samples), rad or m.
        G: dq/dqa, (joints, active) where it is constant, else (samples, joints, active).
        Gd: its rate of change with time, the same shape.
    """

    q: Array
    G: Array
    Gd: Array

    def velocity(self, qda: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples)."""
        return _times(self.G, qda)

    def acceleration(self, qda: Array, qdda: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones' velocity and acceleration."""
        return _times(self.G, qdda) + _times(self.Gd, qda)

    def by(self, B: Array) -> Followed:
        """The same by coordinates c = B qa, (active, active)."""
        to_joints = np.linalg.inv(B)
        return Followed(self.q, self.G @ to_joints, self.Gd @ to_joints)


def _times(G: Array, x: Array) -> Array:
    return np.asarray(G @ x if G.ndim == 2 else np.einsum("sja,as->js", G, x))


@dataclass(frozen=True, eq=False)
class Closure:
    """How all joints follow the active ones where no rate varies: q_tree = G qa + offset.

    Attributes:
        G: (joints, active).
        offset: (joints,), rad or m.
        error: greatest closure error over random poses, m; 0 where there is no cut to test.
        relations: readable, such as "q3 = pi/2 - q2 + q7"; one for each passive joint.
        cuts: the joints that were cut.
    """

    G: Array
    offset: Array
    error: float
    relations: tuple[str, ...]
    cuts: tuple[Cut, ...]

    def __post_init__(self) -> None:
        expect("offset", self.offset.shape, (self.G.shape[0],))
        for name in ("G", "offset"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def constant(self) -> Array:
        """Rates that do not vary, (joints, active)."""
        return self.G

    @property
    def varying(self) -> np.ndarray:
        """Which rates vary with the pose, (joints, active): none."""
        return np.zeros(self.G.shape, dtype=bool)

    def positions(self, qa: Array) -> Array:
        """Of all joints, (joints, samples), from the active ones', (active, samples), rad or m."""
        return np.asarray(self.G @ qa + self.offset[:, None])

    def follow(self, qa: Array, qda: Array | None = None) -> Followed:
        """Positions of all joints and their rates, from the active joints' positions and velocities."""
        del qda
        return Followed(self.positions(qa), self.G, np.zeros_like(self.G))

    def closes(self, qa: Array) -> np.ndarray:
        """Whether the loops close, (samples,): at every pose."""
        return np.ones(qa.shape[1], dtype=bool)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Random poses of the active joints, (active, count): the whole circle, whatever their limits."""
        return rng.uniform(-np.pi, np.pi, (self.G.shape[1], count))
