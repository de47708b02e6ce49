"""Inverse dynamics of the bodies as expressions: Newton and Euler's recursion, link after link.

Source: Khalil and Dombre (2002), Modeling, Identification and Control of Robots, section 9.6, with customised
symbols; second moments in place of inertias, and groups of parallel axes with absolute angles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from haptid._internal.arrays import Array
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import (
    Turn,
    Vector,
    back,
    combined,
    constant,
    cross,
    dot,
    forth,
    plus,
    rotated,
    zero,
)
from haptid.export.model.moments import Moments
from haptid.export.model.tree import Link, Tree


class Spin(NamedTuple):
    """How a link turns.

    Attributes:
        w, wd: angular velocity and acceleration, in the link's frame.
        U: skew(wd) + skew(w)^2, its columns.
        D: differences of the squares of w: zz - yy, xx - zz, yy - xx.
    """

    w: Vector
    wd: Vector
    U: tuple[Vector, Vector, Vector]
    D: Vector


class Base(NamedTuple):
    """How a group's base turns: with the parent of its first link.

    Attributes:
        w, wd: angular velocity and acceleration, in the base's frame.
        column: third column of U, which only rotates with the group's links.
    """

    w: Vector
    wd: Vector
    column: Vector


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies' parameters as expressions, in units that make most lengths 1.

    Attributes:
        links: what each link has: kind to expression.
        rotors: weights over accelerations and the inertia.
        length: the unit of length, m.
    """

    links: tuple[dict[str, Expr], ...]
    rotors: tuple[tuple[Array, Expr], ...]
    length: float

    @staticmethod
    def of(moments: Moments, parameters: Sequence[Expr], length: float) -> Bodies:
        """Moments of order zero and one times the length or its square: parameters made once."""
        made = moments.expressions(parameters)
        unit = {"MX": length, "MY": length, "MZ": length, "M": length * length}
        links = tuple({kind: made[row] * unit.get(kind, 1.0) for kind, row in kept.items()} for kept in moments.links)
        return Bodies(links, tuple((weights, made[row]) for weights, row in moments.rotors), length)


def inverse_dynamics(
    tree: Tree, bodies: Bodies, q: list[Expr], qd: list[Expr], qdd: list[Expr], gravity: Array
) -> list[Expr]:
    """Torques of bodies and rotors on the coordinates, (active).

    Args:
        tree: the mechanism.
        bodies: its parameters.
        q, qd, qdd: the coordinates and their rates.
        gravity: in the base frame, (3,), m/s^2; zero to leave it out.
    """
    recursion = _Recursion(tree, bodies, q, qd, qdd, gravity)
    recursion.forward()
    tau = recursion.backward()
    for weights, inertia in bodies.rotors:
        turned = inertia * combined(weights, qdd)
        tau = [t + float(w) * turned for t, w in zip(tau, weights, strict=True)]
    return tau


class _Recursion:
    """State of one pass out to the tips and back."""

    def __init__(
        self, tree: Tree, bodies: Bodies, q: list[Expr], qd: list[Expr], qdd: list[Expr], gravity: Array
    ) -> None:
        self.tree, self.bodies, self.graph = tree, bodies, q[0].graph
        self.q, self.qd, self.qdd = q, qd, qdd
        self.fall = constant(self.graph, -np.asarray(gravity) / bodies.length)
        self.turns = tree.turns(q)
        self.arms = [tree.origin(i, q, bodies.length) for i in range(len(tree.links))]
        self.needed = tree.needed(bool(kept) for kept in bodies.links)
        self.bases: dict[int, Base] = {}
        self.spins: dict[object, Spin] = {}
        self.accelerations: list[Vector] = [zero(self.graph)] * len(tree.links)

    def spin(self, link: Link) -> Spin:
        return self.spins[link.angle]

    def slide(self, link: Link, rates: list[Expr]) -> Expr:
        """How fast a joint slides, or how that changes, in units of length."""
        return combined(link.rate, rates) * (1.0 / self.bodies.length)

    def forward(self) -> None:
        """Velocities and accelerations, from the base outwards."""
        for i, link in enumerate(self.tree.links):
            if not self.needed[i]:
                continue
            if link.group == i:
                self.bases[i] = self._base(link)
            if link.angle not in self.spins:
                self.spins[link.angle] = self._spin(link, self.bases[link.group], self.turns[i])
            self.accelerations[i] = self._acceleration(i, link)

    def _base(self, link: Link) -> Base:
        if link.parent < 0:
            return Base(zero(self.graph), zero(self.graph), zero(self.graph))
        above, R = self.spin(self.tree.links[link.parent]), link.rotation
        column = tuple(combined(R[:, 2], [above.U[k][row] for k in range(3)]) for row in range(3))
        return Base(rotated(R.T, above.w), rotated(R.T, above.wd), rotated(R.T, column))  # type: ignore[arg-type]

    def _spin(self, link: Link, base: Base, turn: Turn) -> Spin:
        """The third column of U is carried by the turn alone; from it and w come wd and the rest."""
        x, y, z = back(turn, base.w)
        w = (x, y, z + combined(link.turn, self.qd))
        xx, zz = w[0] * w[0], w[2] * w[2]
        xy, xz, yz = w[0] * w[1], w[0] * w[2], w[1] * w[2]
        u = back(turn, base.column)
        wd = (yz - u[1], u[0] - xz, base.wd[2] + combined(link.turn, self.qdd))
        yy = -u[2] - xx
        U = ((-(yy + zz), xy + wd[2], xz - wd[1]), (xy - wd[2], -(xx + zz), yz + wd[0]), u)
        return Spin(w, wd, U, (zz - yy, xx - zz, yy - xx))

    def _acceleration(self, i: int, link: Link) -> Vector:
        """Of the link's origin, less gravity, in its frame."""
        made = self.fall
        if link.parent >= 0:
            above, arm = self.spin(self.tree.links[link.parent]), self.arms[i]
            x, y, z = (dot(arm, [above.U[k][row] for k in range(3)]) for row in range(3))
            made = plus(self.accelerations[link.parent], (x, y, z))
        made = self.tree.outwards(i, self.turns, made)
        if link.prismatic:
            rate = self.slide(link, self.qd)
            spin = self.spin(link)
            coriolis = (2.0 * spin.w[1] * rate, -2.0 * spin.w[0] * rate, self.slide(link, self.qdd))
            made = plus(made, coriolis)
        return made

    def backward(self) -> list[Expr]:
        """Forces and moments, from the tips inwards, and what they do to the coordinates."""
        none, count = zero(self.graph), len(self.tree.links)
        force, moment, waiting = [none] * count, [none] * count, [none] * count
        tau = [self.graph.number(0.0)] * self.tree.active
        for i in reversed(range(count)):
            link = self.tree.links[i]
            if not self.needed[i]:
                continue
            own_f, own_n = self._inertial(i, link)
            f, n = plus(force[i], own_f), plus(moment[i], own_n)
            tau = self._felt(link, tau, f, n)
            waiting[link.group] = plus(waiting[link.group], forth(self.turns[i], n))
            if link.parent >= 0:
                there = self.tree.inwards(i, self.turns, f)
                force[link.parent] = plus(force[link.parent], there)
                moment[link.parent] = plus(moment[link.parent], cross(self.arms[i], there))
            if link.group == i and link.parent >= 0:
                # The moments of a group's links go on together: until there they share the base's frame.
                moment[link.parent] = plus(moment[link.parent], rotated(link.rotation, waiting[i]))
        return tau

    def _felt(self, link: Link, tau: list[Expr], f: Vector, n: Vector) -> list[Expr]:
        """A moment turns every coordinate in the link's absolute angle; a sliding joint feels the force."""
        if link.prismatic:
            felt, weights = f[2] * (1.0 / self.bodies.length), link.rate
        else:
            felt, weights = n[2], link.turn
        return [t + float(w) * felt for t, w in zip(tau, weights, strict=True)]

    def _inertial(self, i: int, link: Link) -> tuple[Vector, Vector]:
        """Force and moment about the link's origin that its own motion needs."""
        kept, spin = self.bodies.links[i], self.spin(link)
        none = self.graph.number(0.0)
        first = (kept.get("MX", none), kept.get("MY", none), kept.get("MZ", none))
        mass, a = kept.get("M", none), self.accelerations[i]
        rows = [dot(first, [spin.U[k][row] for k in range(3)]) + mass * a[row] for row in range(3)]
        return (rows[0], rows[1], rows[2]), plus(_moment(kept, spin, none), cross(first, a))


def _moment(kept: dict[str, Expr], spin: Spin, none: Expr) -> Vector:
    """What U E - (U E)' stands for, as a vector."""
    xx, xy, xz, yy, yz, zz = (kept.get(kind, none) for kind in ("XX", "XY", "XZ", "YY", "YZ", "ZZ"))
    (_, u10, u20), (u01, _, u21), (u02, u12, _) = spin.U
    d = spin.D
    return (
        xy * u20 - xz * u10 + yz * d[0] + yy * u21 - zz * u12,
        xz * d[1] + yz * u01 - xy * u21 + zz * u02 - xx * u20,
        xy * d[2] + xz * u12 - yz * u02 + xx * u10 - yy * u01,
    )
