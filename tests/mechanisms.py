"""Random mechanisms: trees with branches and prismatic joints, open or tied by linear closures, and their oracle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from haptid import _core

INERTIA = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
QUARTER_TURNS = [
    np.eye(3),
    Rotation.from_euler("x", 90, degrees=True).as_matrix(),
    Rotation.from_euler("x", -90, degrees=True).as_matrix(),
]


@dataclass(frozen=True, eq=False)
class Random:
    """A mechanism drawn from a seed.

    Attributes:
        parent, rotation, translation, prismatic: the tree, in normal form.
        rates, offset: q = rates @ c + offset.
        mass, com, inertia: of each link, about its centre of mass: physical by construction.
        gravity: (3,).
    """

    parent: list[int]
    rotation: np.ndarray
    translation: np.ndarray
    prismatic: list[bool]
    rates: np.ndarray
    offset: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    inertia: np.ndarray
    gravity: np.ndarray

    def core(self, backend: str | None = None, terms: tuple = ()) -> _core.Mechanism:
        return _core.Mechanism(
            self.parent,
            self.rotation,
            self.translation,
            self.prismatic,
            list(self.gravity),
            self.rates,
            self.offset,
            list(terms),
            backend,
        )

    @cached_property
    def chi(self) -> np.ndarray:
        """Standard parameters of all links: XX XY XZ YY YZ ZZ MX MY MZ M, about the link's origin."""
        parts = []
        for m, c, inertia in zip(self.mass, self.com, self.inertia, strict=True):
            at_origin = inertia + m * (c @ c * np.eye(3) - np.outer(c, c))
            parts.append([*(at_origin[i] for i in INERTIA), *(m * c), m])
        return np.concatenate(parts)

    @property
    def coordinates(self) -> int:
        return self.rates.shape[1]

    def torque(self, c: np.ndarray, cd: np.ndarray, cdd: np.ndarray) -> np.ndarray:
        none = np.zeros((0, c.shape[1]))
        columns = list(range(10 * len(self.parent)))
        return np.einsum("apk,p->ak", self.core().regressor(c, cd, cdd, none, columns), self.chi)

    def mass_matrix(self, c: np.ndarray) -> np.ndarray:
        """From the regressor alone: the torque of unit accelerations less that of none, (n, n) at one position."""
        n = self.coordinates
        at = np.repeat(c[:, None], n + 1, axis=1)
        accelerations = np.column_stack([np.zeros(n), np.eye(n)])
        tau = self.torque(at, np.zeros_like(at), accelerations)
        return tau[:, 1:] - tau[:, :1]


def draw(seed: int, joints: int, closed: bool, chain: bool = False) -> Random:
    """A mechanism whose links are numbered depth first (Pinocchio's mass matrix is wrong otherwise)."""
    rng = np.random.default_rng(seed)
    parent = [-1]
    for i in range(1, joints):
        above = i - 1
        while not chain and above >= 0 and rng.random() < 0.35:
            above = parent[above]
        parent.append(above)
    general = Rotation.random(joints, random_state=rng).as_matrix()
    rotation = np.array([general[i] if rng.random() < 0.4 else QUARTER_TURNS[rng.integers(3)] for i in range(joints)])
    translation = rng.normal(size=(joints, 3)) * 0.3 * (rng.random((joints, 1)) < 0.7)
    coordinates = int(rng.integers(1, joints + 1)) if closed else joints
    rates = rng.integers(-1, 2, (joints, coordinates)).astype(float) if closed else np.eye(joints)
    spread = rng.normal(size=(joints, 3, 3))
    inertia = 0.02 * np.eye(3) + 0.05 * spread @ spread.transpose(0, 2, 1)
    # A body's moments about its centre obey the triangle inequality: use J = trace(E) I - E of a positive E.
    inertia = np.trace(inertia, axis1=1, axis2=2)[:, None, None] * np.eye(3) - inertia
    return Random(
        parent=parent,
        rotation=rotation,
        translation=translation,
        prismatic=[bool(b) for b in rng.random(joints) < 0.3],
        rates=rates,
        offset=rng.normal(size=joints) if closed else np.zeros(joints),
        mass=rng.uniform(0.3, 2.0, joints),
        com=rng.uniform(-0.1, 0.1, (joints, 3)),
        inertia=inertia,
        gravity=rng.normal(size=3) * 9.81,
    )


def mechanisms(most: int = 12, closed: bool | None = None) -> st.SearchStrategy[Random]:
    """Trees and closed chains of 1 to `most` joints."""
    ties = st.booleans() if closed is None else st.just(closed)
    return st.builds(draw, st.integers(0, 2**32 - 1), st.integers(1, most), ties)


def states(mechanism: Random, samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    c, cd, cdd = rng.normal(size=(3, mechanism.coordinates, samples))
    return c, cd, cdd
