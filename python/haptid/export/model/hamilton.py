"""Generalised momentum p = M qd and the derivatives of the kinetic energy as expressions, without accelerations.

With the twist v of a link and the momentum H of all bodies that its joint carries, p = S . H, and the derivative of the
kinetic energy by the coordinate is (v x S) . H: tau = dp/dt + g - C' qd, where C' qd is that derivative.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 2.10 and 5.3; De Luca and Mattone (2005), eq. (8).
"""

from __future__ import annotations

from haptid._internal.late import dataclass
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import Turn, Vector, back, combined, cross, dot, forth, plus, rotated, zero
from haptid.export.model.newton import Bodies
from haptid.export.model.tree import Link, Tree


@dataclass(frozen=True)
class Twist:
    """Angular velocity and velocity of a link's origin, in its frame, in units of length."""

    w: Vector
    v: Vector


def momentum_expressions(
    tree: Tree, bodies: Bodies, q: list[Expr], qd: list[Expr], turns: list[Turn]
) -> tuple[list[Expr], list[Expr]]:
    """Generalised momentum and the derivatives of the kinetic energy by the coordinates, each (active).

    Args:
        bodies: its parameters.
        q, qd: the coordinates and their rates.
        turns: of every link in its group's base.
    """
    needed = tree.needed(bool(kept) for kept in bodies.links)
    arms = [tree.origin(i, q, bodies.length) for i in range(len(tree.links))]
    twists = _twists(tree, bodies, qd, turns, arms, needed)
    p, slope = _gathered(tree, bodies, turns, arms, twists)
    for weights, inertia in bodies.rotors:
        turned = inertia * combined(weights, qd)
        p = [x + float(w) * turned for x, w in zip(p, weights, strict=True)]
    return p, slope


def _twists(
    tree: Tree, bodies: Bodies, qd: list[Expr], turns: list[Turn], arms: list[Vector], needed: list[bool]
) -> dict[int, Twist]:
    """Twists of all links that carry inertia, from the base outwards."""
    none = zero(qd[0].graph)
    made: dict[int, Twist] = {}
    bases: dict[int, Vector] = {}
    spins: dict[object, Vector] = {}
    for i, link in enumerate(tree.links):
        if not needed[i]:
            continue
        above = made[link.parent] if link.parent >= 0 else Twist(none, none)
        if link.group == i:
            bases[i] = rotated(link.rotation.T, above.w)
        if link.angle not in spins:
            x, y, z = back(turns[i], bases[link.group])
            spins[link.angle] = (x, y, z + combined(link.turn, qd))
        v = plus(above.v, cross(above.w, arms[i])) if link.parent >= 0 else none
        x, y, z = tree.outwards(i, turns, v) if link.parent >= 0 else v
        if link.prismatic:
            z = z + combined(link.rate, qd) * (1.0 / bodies.length)
        made[i] = Twist(spins[link.angle], (x, y, z))
    return made


def _gathered(
    tree: Tree, bodies: Bodies, turns: list[Turn], arms: list[Vector], twists: dict[int, Twist]
) -> tuple[list[Expr], list[Expr]]:
    """Momenta from the tips inwards, and the energy derivatives, projected on the coordinates."""
    none, count = turns[0][0] * 0.0, len(tree.links)
    linear, angular, waiting = ([(none, none, none)] * count for _ in range(3))
    p, slope = [none] * tree.coordinates, [none] * tree.coordinates
    for i in sorted(twists, reverse=True):
        link, twist = tree.links[i], twists[i]
        own, own_about = _own(bodies, i, twist, none)
        h, k = plus(linear[i], own), plus(angular[i], own_about)
        p = _shared(p, link, bodies.length, h[2], k[2])
        # (v x S) . H with S = z: rotation about the group's base, and translation of the origin.
        about = twist.w[1] * k[0] - twist.w[0] * k[1]
        along = twist.v[1] * h[0] - twist.v[0] * h[1]
        slides = twist.w[1] * h[0] - twist.w[0] * h[1]
        slope = _shared(slope, link, bodies.length, slides, about)
        if not link.prismatic:
            slope = [s + float(w) * along for s, w in zip(slope, link.rate, strict=True)]
        waiting[link.group] = plus(waiting[link.group], forth(turns[i], k))
        if link.parent >= 0:
            there = tree.inwards(i, turns, h)
            linear[link.parent] = plus(linear[link.parent], there)
            angular[link.parent] = plus(angular[link.parent], cross(arms[i], there))
        if link.group == i and link.parent >= 0:
            angular[link.parent] = plus(angular[link.parent], rotated(link.rotation, waiting[i]))
    return p, slope


def _shared(into: list[Expr], link: Link, length: float, slides: Expr, turns: Expr) -> list[Expr]:
    """Add a joint's component to the coordinates that move it."""
    if link.prismatic:
        return [x + float(w) * (slides * (1.0 / length)) for x, w in zip(into, link.rate, strict=True)]
    return [x + float(w) * turns for x, w in zip(into, link.turn, strict=True)]


def _own(bodies: Bodies, i: int, twist: Twist, none: Expr) -> tuple[Vector, Vector]:
    """Linear and angular momentum of a link about its origin: J w = tr(E) w - E w."""
    (xx, xy, xz, yy, yz, zz), first, mass = bodies.of_link(i, none)
    w = twist.w
    x, y, z = cross(w, first)
    linear = (x + mass * twist.v[0], y + mass * twist.v[1], z + mass * twist.v[2])
    turned = (
        dot((yy + zz, -xy, -xz), w),
        dot((-xy, xx + zz, -yz), w),
        dot((-xz, -yz, xx + yy), w),
    )
    return linear, plus(turned, cross(first, twist.v))
