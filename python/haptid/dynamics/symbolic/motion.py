"""How the joints of a mechanism move, modulo a prime: all of them from the active ones, at exact points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from haptid.dynamics.symbolic.laurent import Laurent
from haptid.dynamics.symbolic.residues import Field, Residues


@dataclass(frozen=True, eq=False)
class States:
    """Joints at states drawn at random, all of them residues.

    The position of a turning joint is drawn apart from its cosine and sine: no polynomial ties them.

    Attributes:
        cos, sin: of turning joints, (joints, n); one and zero for sliding ones.
        slide: of sliding joints, (joints, n); zero for turning ones.
        position, velocity, acceleration: (joints, n).
        G: rates of all joints by active one, (joints, n, active).
        active: position, velocity and acceleration of the active joints, (3, active, n).
    """

    cos: Residues
    sin: Residues
    slide: Residues
    position: Residues
    velocity: Residues
    acceleration: Residues
    G: Residues
    active: Residues


class Motion(Protocol):
    """What a closed chain needs to tell of its loops; a loop of another kind is another class with these two."""

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """What it depends on besides the placements of joints and of the frames of cuts."""

    def states(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int) -> States:
        """States drawn at random, one for each of `count` sets of lengths.

        Args:
            field: the residues' prime.
            rng: where they are drawn from.
            values: residues of all symbols, (count,) each.
            count: number of states.
        """


@dataclass(frozen=True)
class LinearMotion:
    """Every joint a linear function of the active ones: q = G qa + offset.

    Attributes:
        prismatic: of every joint.
        rates: G, by joint and active joint.
        multiples: angle of a turning joint in units of each active joint's, whole numbers, by joint and active joint.
        turns: cosine and sine of every turning joint's offset.
        offsets: of every joint, as a length or an angle.
    """

    prismatic: tuple[bool, ...]
    rates: tuple[tuple[Laurent, ...], ...]
    multiples: tuple[tuple[int, ...], ...]
    turns: tuple[tuple[Laurent, Laurent], ...]
    offsets: tuple[Laurent, ...]

    @property
    def depends(self) -> tuple[Laurent, ...]:
        """See Motion."""
        return (*self.offsets, *(part for row in (*self.rates, *self.turns) for part in row))

    def states(self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int) -> States:
        """See Motion."""
        actives = len(self.rates[0])
        active = field.draw(rng, 3, actives, count)
        G: Residues = np.array([[entry.modulo(field, values, count) for entry in row] for row in self.rates])
        moved = np.zeros((3, len(self.rates), count), dtype=np.int64)
        for k in range(actives):  # one product at a time: a sum over many active joints could overflow
            moved = field.reduce(moved + G[:, k] * active[:, None, k])
        offsets: Residues = np.array([offset.modulo(field, values, count) for offset in self.offsets])
        position = field.reduce(moved[0] + offsets)
        cos, sin = self._angles(field, rng, values, count)
        slide = np.where(np.array(self.prismatic)[:, None], position, 0)
        return States(cos, sin, slide, position, moved[1], moved[2], np.moveaxis(G, 1, 2), active)

    def _angles(
        self, field: Field, rng: np.random.Generator, values: Mapping[str, Residues], count: int
    ) -> tuple[Residues, Residues]:
        units = [field.circle(rng, count) for _ in self.rates[0]]
        cos = np.ones((len(self.rates), count), dtype=np.int64)
        sin = np.zeros_like(cos)
        for j, (multiples, prismatic) in enumerate(zip(self.multiples, self.prismatic, strict=True)):
            if prismatic:
                continue
            c, s = self.turns[j]
            angle = (c.modulo(field, values, count), s.modulo(field, values, count))
            for unit, times in zip(units, multiples, strict=True):
                if times:
                    angle = field.sum_of_angles(angle, field.multiple_of_angle(unit, times))
            cos[j], sin[j] = angle
        return cos, sin
