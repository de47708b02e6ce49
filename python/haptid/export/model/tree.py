"""Kinematic tree for code generation: links with parallel axes in groups, one absolute angle per orientation.

Its coordinates are those of the torque rows, then the positions of the passive joints that loops determine at every
pose; all other joints follow these at constant rates (`haptid.export.model.passive`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device.terms.term import TermColumn
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import (
    NEAR,
    Turn,
    Vector,
    back,
    combined,
    constant_vector,
    forth,
    plus,
    rotated,
    snapped,
)
from haptid.export.model.passive import passive_joints


@dataclass(frozen=True, eq=False)
class Link:
    """A link of the tree.

    A link whose axis is parallel to its parent's belongs to the parent's group: its orientation is that of the group's
    base rotated about z by one angle, a linear combination of the coordinates.

    Attributes:
        parent: its index, -1 for the base.
        prismatic: whether its joint is prismatic.
        group: index of the first link of its group.
        rotation: of the group's base in the frame of the first link's parent, (3, 3).
        arm: its origin in the parent's link frame at zero joint position, (3,), m.
        rate: joint rate per coordinate rate, (coordinates,).
        joint_offset: joint position where the coordinates are zero, rad or m.
        turn: angle about z in the group's base per coordinate, (coordinates,); zero for a prismatic joint.
        offset: that angle where the coordinates are zero, rad.
    """

    parent: int
    prismatic: bool
    group: int
    rotation: Array
    arm: Array
    rate: Array
    joint_offset: float
    turn: Array
    offset: float

    @property
    def angle(self) -> tuple[int, tuple[float, ...], float]:
        """Key of the link's orientation: equal for links of equal orientation."""
        return (self.group, tuple(self.turn), self.offset)


@dataclass(frozen=True, eq=False)
class Tree:
    """The links of a device.

    Attributes:
        links: parents before children.
        active: number of coordinates of the torque rows.
        passive: indices of the joints whose positions are the other coordinates.
        gravity: in the base frame, (3,), m/s^2.
    """

    links: tuple[Link, ...]
    active: int
    passive: tuple[int, ...]
    gravity: Array

    @property
    def coordinates(self) -> int:
        """Number of coordinates."""
        return self.active + len(self.passive)

    def of_term(self, term: TermColumn) -> Array:
        """The coordinate of a term as a combination of the tree's coordinates, (coordinates,)."""
        if term.joint is not None:
            return self.links[term.joint].rate
        return np.concatenate([term.weights, np.zeros(len(self.passive))])

    @cached_property
    def length(self) -> float:
        """Unit of length, m: the most frequent distance between frames, so that most arms are 1."""
        arms = [abs(float(x)) for link in self.links if link.parent >= 0 for x in link.arm]
        seen = Counter(round(x, 12) for x in arms if x)
        return max(seen, key=lambda x: (seen[x], x)) if seen else 1.0

    def origin(self, i: int, q: list[Expr], length: float) -> Vector:
        """Origin of a link in its parent's frame, including the prismatic displacement, in units of a length."""
        link, graph = self.links[i], q[0].graph
        made = constant_vector(graph, link.arm / length)
        if link.prismatic:
            slid = (combined(link.rate, q) + link.joint_offset) * (1.0 / length)
            made = plus(made, rotated(link.rotation, (graph.number(0.0), graph.number(0.0), slid)))
        return made

    def outwards(self, i: int, turns: list[Turn], v: Vector) -> Vector:
        """A vector of the parent's frame in the link's frame."""
        link = self.links[i]
        there = rotated(link.rotation.T, v) if link.group == i else forth(turns[link.parent], v)
        return back(turns[i], there)

    def inwards(self, i: int, turns: list[Turn], v: Vector) -> Vector:
        """A vector of a link's frame in its parent's frame; the parent of the first links is the base."""
        link, there = self.links[i], forth(turns[i], v)
        return rotated(link.rotation, there) if link.group == i else back(turns[link.parent], there)

    def turns(self, q: list[Expr]) -> list[Turn]:
        """Sine and cosine of every link's absolute angle in its group."""
        return [sine_cosine(link.turn, link.offset, q) for link in self.links]

    def relative(self, q: list[Expr]) -> list[Turn]:
        """Sine and cosine of every link's angle to its parent's frame."""
        return [sine_cosine(*self._relative(link, i), q) for i, link in enumerate(self.links)]

    def differences(self, turns: list[Turn]) -> list[Turn]:
        """The same as `relative`, from the sines and cosines of `turns`."""
        made = []
        for i, (link, (s, c)) in enumerate(zip(self.links, turns, strict=True)):
            if link.group != i:
                sp, cp = turns[link.parent]
                s, c = s * cp - c * sp, c * cp + s * sp
            made.append((s, c))
        return made

    def _relative(self, link: Link, i: int) -> tuple[Array, float]:
        if link.group == i:
            return link.turn, link.offset
        above = self.links[link.parent]
        return link.turn - above.turn, link.offset - above.offset

    def needed(self, wanted: Iterable[bool]) -> list[bool]:
        """The links that are wanted, and all their ancestors."""
        made = list(wanted)
        for i in reversed(range(len(self.links))):
            parent = self.links[i].parent
            if made[i] and parent >= 0:
                made[parent] = True
        return made


def tree_of(model: DynamicModel) -> Tree:
    """The device's tree."""
    links: list[Link] = []
    passive = passive_joints(model)
    rates, offsets = np.zeros((len(model.device.joints), passive.rates.shape[1])), model.device.closure.offset.copy()
    rates[:, : len(model.device.active)] = snapped(model.device.rates)
    rates[list(passive.joints)], offsets[list(passive.joints)] = passive.rates, passive.offset
    for i, joint in enumerate(model.device.joints):
        rate, offset = rates[i], float(offsets[i])
        rotation, group, turn, angle = snapped(joint.rotation), i, rate, offset
        above = links[joint.parent] if joint.parent >= 0 else None
        if joint.prismatic:
            turn, angle = np.zeros_like(rate), 0.0
        elif above is not None and not above.prismatic and rotation[2, 2] == 1.0:
            group, turn = above.group, above.turn + rate
            angle = above.offset + offset + float(np.arctan2(rotation[1, 0], rotation[0, 0]))
            rotation = above.rotation
        links.append(
            Link(
                parent=joint.parent,
                prismatic=joint.prismatic,
                group=group,
                rotation=freeze(rotation),
                arm=freeze(snapped(joint.translation)),
                rate=freeze(rate),
                joint_offset=offset,
                turn=freeze(np.asarray(snapped(turn))),
                offset=angle,
            )
        )
    return Tree(tuple(links), len(model.device.active), passive.found, model.device.gravity)


def sine_cosine(weights: Array, offset: float, q: list[Expr]) -> Turn:
    """Sine and cosine of weights . q + offset; multiples of a right angle in the offset need no operations."""
    graph = q[0].graph
    first = next((w for w in weights if w), 1.0)
    angle = combined(np.sign(first) * weights, q)
    s, c = np.sign(first) * graph.apply("sin", angle), graph.apply("cos", angle)
    quarters = round(offset / (np.pi / 2))
    if abs(offset - quarters * np.pi / 2) < NEAR:
        return ((s, c), (c, -s), (-s, -c), (-c, s))[quarters % 4]
    so, co = float(np.sin(offset)), float(np.cos(offset))
    return s * co + c * so, c * co - s * so
