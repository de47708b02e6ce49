"""Mass matrix as expressions: composite rigid body algorithm (CRBA) in second moments.

Source: Featherstone (2008), Rigid Body Dynamics Algorithms, section 6.2; with base parameters most terms vanish, since
the composite mass is zero almost everywhere.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import Turn, Vector, cross, forth, plus, rotated, vector
from haptid.export.model.newton import Bodies
from haptid.export.model.tree import Link, Tree

# Second moments, symmetric: rows.
_Moments = tuple[Vector, Vector, Vector]


def mass_matrix_expressions(tree: Tree, bodies: Bodies, q: list[Expr], turns: list[Turn]) -> list[list[Expr]]:
    """The mass matrix including rotors, rows of (active, active).

    Args:
        bodies: its parameters.
        q: the coordinates.
        turns: of every link in its parent's frame.
    """
    links, none = tree.links, q[0].graph.number(0.0)
    arms = [tree.origin(i, q, bodies.length) for i in range(len(links))]
    composite = [_own(bodies, i, none) for i in range(len(links))]
    entries: dict[tuple[int, int], Expr] = {}
    for i in reversed(range(len(links))):
        second, first, mass = composite[i]
        n, f = _wrench(links[i], second, first, mass)
        entries[i, i] = f[2] if links[i].prismatic else n[2]
        j = i
        while links[j].parent >= 0:
            n, f = (_inwards(links, turns, j, v) for v in (n, f))
            n = plus(n, cross(arms[j], f))
            j = links[j].parent
            entries[i, j] = f[2] if links[j].prismatic else n[2]
        above = links[i].parent
        if above >= 0:
            composite[above] = _joined(composite[above], _carried(links, turns, i, composite[i], arms[i]))
    return _projected(tree, bodies, entries, none)


def _rotation(link: Link, i: int) -> Array:
    return link.rotation if link.group == i else np.eye(3)


def _inwards(links: tuple[Link, ...], turns: list[Turn], i: int, v: Vector) -> Vector:
    """A vector of a link's frame in its parent's frame."""
    return rotated(_rotation(links[i], i), forth(turns[i], v))


def _own(bodies: Bodies, i: int, none: Expr) -> tuple[_Moments, Vector, Expr]:
    """Second moments as a matrix, first moments and mass of one link."""
    (xx, xy, xz, yy, yz, zz), first, mass = bodies.of_link(i, none)
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), first, mass


def _wrench(link: Link, second: _Moments, first: Vector, mass: Expr) -> tuple[Vector, Vector]:
    """Moment and force for a unit acceleration of a joint, about or along its z axis."""
    none = mass * 0.0
    if link.prismatic:
        return (first[1], -first[0], none), (none, none, mass)
    return (-second[0][2], -second[1][2], second[0][0] + second[1][1]), (-first[1], first[0], none)


def _carried(
    links: tuple[Link, ...], turns: list[Turn], i: int, body: tuple[_Moments, Vector, Expr], arm: Vector
) -> tuple[_Moments, Vector, Expr]:
    """A body in the frame of its link's parent, about that frame's origin."""
    second, first, mass = body
    R = _rotation(links[i], i)
    there = _inwards(links, turns, i, first)
    A = _turned(turns[i], second)
    A = _transposed([rotated(R, row) for row in A])
    A = _transposed([rotated(R, row) for row in A])
    rows: list[list[Expr]] = [[mass] * 3 for _ in range(3)]
    for a in range(3):
        for b in range(a, 3):
            moved = A[b][a] + arm[a] * there[b] + arm[b] * there[a] + (arm[a] * arm[b]) * mass
            rows[a][b] = rows[b][a] = moved
    x, y, z = (there[a] + arm[a] * mass for a in range(3))
    return (vector(rows[0]), vector(rows[1]), vector(rows[2])), (x, y, z), mass


def _turned(turn: Turn, second: _Moments) -> _Moments:
    """Rz E Rz', with three products for the upper left corner."""
    s, c = turn
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = second
    u = s * (xx - yy) + c * (2.0 * xy)
    su = s * u
    x, y, _ = forth(turn, (xz, yz, zz))
    across = c * u - xy
    return ((xx - su, across, x), (across, yy + su, y), (x, y, zz))


def _transposed(rows: list[Vector]) -> _Moments:
    x, y, z = zip(*rows, strict=True)
    return (vector(x), vector(y), vector(z))


def _joined(a: tuple[_Moments, Vector, Expr], b: tuple[_Moments, Vector, Expr]) -> tuple[_Moments, Vector, Expr]:
    x, y, z = (plus(p, q) for p, q in zip(a[0], b[0], strict=True))
    return (x, y, z), plus(a[1], b[1]), a[2] + b[2]


def _projected(tree: Tree, bodies: Bodies, entries: dict[tuple[int, int], Expr], none: Expr) -> list[list[Expr]]:
    """Mass matrix of the coordinates from that of the tree's joints, plus the rotors."""
    rates = [link.rate / bodies.length if link.prismatic else link.rate for link in tree.links]
    made = [[none] * tree.coordinates for _ in range(tree.coordinates)]
    for a in range(tree.coordinates):
        for b in range(a + 1):
            total = none
            for (i, j), value in entries.items():
                weight = rates[i][a] * rates[j][b] + (rates[j][a] * rates[i][b] if i != j else 0.0)
                total = total + float(weight) * value
            for weights, inertia in bodies.rotors:
                total = total + float(weights[a] * weights[b]) * inertia
            made[a][b] = made[b][a] = total
    return made
