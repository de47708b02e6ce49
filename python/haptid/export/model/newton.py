"""Inverse dynamics of the bodies as expressions: recursive Newton-Euler algorithm with customised symbols.

Source: Khalil and Dombre (2002), Modeling, Identification and Control of Robots, section 9.6; with second moments in
place of inertias, and absolute angles in groups of parallel axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.parameters import INERTIAL
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import (
    Turn,
    Vector,
    back,
    combined,
    constant_vector,
    cross,
    dot,
    forth,
    plus,
    rotated,
    vector,
    zero,
)
from haptid.export.model.moments import SecondMoments
from haptid.export.model.tree import Link, Tree


class Spin(NamedTuple):
    """Angular motion of a link.

    Attributes:
        w, wd: angular velocity and acceleration, in the link's frame.
        U: columns of skew(wd) + skew(w)^2.
        D: differences of the squares of w: zz - yy, xx - zz, yy - xx.
    """

    w: Vector
    wd: Vector
    U: tuple[Vector, Vector, Vector]
    D: Vector


class Base(NamedTuple):
    """Angular motion of a group's base, which is fixed to the parent of its first link.

    Attributes:
        w, wd: angular velocity and acceleration, in the base's frame.
        column: third column of U; for the group's links it is only rotated.
    """

    w: Vector
    wd: Vector
    column: Vector


@dataclass(frozen=True, eq=False)
class Bodies:
    """Parameters of the bodies as expressions, in units that make most lengths 1.

    Attributes:
        links: parameters of each link: kind to expression.
        rotors: weights over accelerations, and the inertia.
        length: the unit of length, m.
    """

    links: tuple[dict[str, Expr], ...]
    rotors: tuple[tuple[Array, Expr], ...]
    length: float

    @staticmethod
    def of(moments: SecondMoments, parameters: Sequence[Expr], tree: Tree) -> Bodies:
        """Mass and first moments scaled by powers of the tree's length, precomputed from the parameters."""
        made, length = moments.expressions(parameters), tree.length
        unit = {"MX": length, "MY": length, "MZ": length, "M": length * length}
        links = tuple({kind: made[row] * unit.get(kind, 1.0) for kind, row in kept.items()} for kept in moments.links)
        return Bodies(links, tuple((tree.of_term(term), made[row]) for term, row in moments.rotors), length)

    def of_link(self, i: int, none: Expr) -> tuple[tuple[Expr, ...], Vector, Expr]:
        """Second moments XX XY XZ YY YZ ZZ, first moments and mass of a link, `none` for zero."""
        xx, xy, xz, yy, yz, zz, x, y, z, mass = (self.links[i].get(kind, none) for kind in INERTIAL)
        return (xx, xy, xz, yy, yz, zz), (x, y, z), mass


def inverse_dynamics_expressions(
    tree: Tree, bodies: Bodies, q: list[Expr], qd: list[Expr], qdd: list[Expr], gravity: Array
) -> list[Expr]:
    """Torques of bodies and rotors on the coordinates, (active).

    Args:
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
    """State of the forward and backward recursion."""

    def __init__(
        self, tree: Tree, bodies: Bodies, q: list[Expr], qd: list[Expr], qdd: list[Expr], gravity: Array
    ) -> None:
        self.tree, self.bodies, self.graph = tree, bodies, q[0].graph
        self.q, self.qd, self.qdd = q, qd, qdd
        self.fall = constant_vector(self.graph, -np.asarray(gravity) / bodies.length)
        self.turns = tree.turns(q)
        self.arms = [tree.origin(i, q, bodies.length) for i in range(len(tree.links))]
        self.needed = tree.needed(bool(kept) for kept in bodies.links)
        self.bases: dict[int, Base] = {}
        self.spins: dict[object, Spin] = {}
        self.accelerations: list[Vector] = [zero(self.graph)] * len(tree.links)

    def spin(self, link: Link) -> Spin:
        return self.spins[link.angle]

    def slide(self, link: Link, rates: list[Expr]) -> Expr:
        """Rate (or acceleration) of a prismatic joint, in units of length."""
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
        """Angular motion of a link: the third column of U is only rotated; wd and the rest follow from it and w."""
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
        """Acceleration of the link's origin minus gravity, in its frame."""
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
        """Forces and moments from the tips inwards, projected on the coordinates."""
        none, count = zero(self.graph), len(self.tree.links)
        force, moment, waiting = [none] * count, [none] * count, [none] * count
        tau = [self.graph.number(0.0)] * self.tree.coordinates
        for i in reversed(range(count)):
            link = self.tree.links[i]
            if not self.needed[i]:
                continue
            own_f, own_n = self._inertial(i, link)
            f, n = plus(force[i], own_f), plus(moment[i], own_n)
            tau = self._projected(link, tau, f, n)
            waiting[link.group] = plus(waiting[link.group], forth(self.turns[i], n))
            if link.parent >= 0:
                there = self.tree.inwards(i, self.turns, f)
                force[link.parent] = plus(force[link.parent], there)
                moment[link.parent] = plus(moment[link.parent], cross(self.arms[i], there))
            if link.group == i and link.parent >= 0:
                # Moments of a group's links are summed in the frame of the group's base and passed on together.
                moment[link.parent] = plus(moment[link.parent], rotated(link.rotation, waiting[i]))
        return tau

    def _projected(self, link: Link, tau: list[Expr], f: Vector, n: Vector) -> list[Expr]:
        """Add a joint's force, or its moment on all coordinates of the link's absolute angle."""
        if link.prismatic:
            load, weights = f[2] * (1.0 / self.bodies.length), link.rate
        else:
            load, weights = n[2], link.turn
        return [t + float(w) * load for t, w in zip(tau, weights, strict=True)]

    def _inertial(self, i: int, link: Link) -> tuple[Vector, Vector]:
        """Inertial force and moment of a link about its origin."""
        second, first, mass = self.bodies.of_link(i, self.graph.number(0.0))
        spin, a = self.spin(link), self.accelerations[i]
        force = vector([dot(first, [spin.U[k][row] for k in range(3)]) + mass * a[row] for row in range(3)])
        return force, plus(_moment(second, spin), cross(first, a))


def _moment(second: tuple[Expr, ...], spin: Spin) -> Vector:
    """The vector of the skew-symmetric matrix U E - (U E)', E the second moments."""
    xx, xy, xz, yy, yz, zz = second
    (_, u10, u20), (u01, _, u21), (u02, u12, _) = spin.U
    d = spin.D
    return (
        xy * u20 - xz * u10 + yz * d[0] + yy * u21 - zz * u12,
        xz * d[1] + yz * u01 - xy * u21 + zz * u02 - xx * u20,
        xy * d[2] + xz * u12 - yz * u02 + xx * u10 - yy * u01,
    )
