"""Pose and Jacobian of the handle as expressions.

In a group of parallel axes each link's absolute angle moves only its own bar, which keeps the Jacobian short.
"""

from __future__ import annotations

from dataclasses import dataclass

from haptid.device import Handle
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import Turn, Vector, constant_vector, cross, forth, plus, rotated, zero
from haptid.export.model.tree import Tree


@dataclass(frozen=True)
class HandleExpressions:
    """Pose and Jacobian of the handle in the base frame.

    Attributes:
        position: of its origin, m.
        rotation: of its frame, rows of (3, 3).
        jacobian: rows of (6, active): linear, then angular velocity per rate of the coordinates.
    """

    position: Vector
    rotation: tuple[Vector, Vector, Vector]
    jacobian: list[list[Expr]]


def handle_expressions(tree: Tree, handle: Handle, q: list[Expr]) -> HandleExpressions:
    """The handle's pose and Jacobian.

    Args:
        handle: frame of the handle in its link.
        q: the coordinates.
    """
    graph, turns = q[0].graph, tree.turns(q)
    chain: list[int] = []
    i = handle.link
    while i >= 0:
        chain.insert(0, i)
        i = tree.links[i].parent
    bars = [_in_base(tree, turns, tree.links[i].parent, tree.origin(i, q, 1.0)) for i in chain]
    bars.append(_in_base(tree, turns, handle.link, constant_vector(graph, handle.translation)))
    position = zero(graph)
    for bar in bars:
        position = plus(position, bar)
    axes = [_in_base(tree, turns, handle.link, constant_vector(graph, column)) for column in handle.rotation.T]
    x, y, z = ((axes[0][k], axes[1][k], axes[2][k]) for k in range(3))
    columns = _columns(tree, turns, chain, bars)
    return HandleExpressions(position, (x, y, z), [list(row) for row in zip(*columns, strict=True)])


def _columns(tree: Tree, turns: list[Turn], chain: list[int], bars: list[Vector]) -> list[list[Expr]]:
    """Columns of the Jacobian, (active, 6).

    Args:
        turns: of every link in its group's base.
        chain: links from the base to the handle.
        bars: from the base to the first link's origin, from each origin to the next, and to the handle's.
    """
    graph, links = bars[0][0].graph, tree.links
    columns = [[graph.number(0.0)] * 6 for _ in range(tree.active)]
    beyond = zero(graph)
    for k in reversed(range(len(chain))):
        link = links[chain[k]]
        beyond = plus(beyond, bars[k + 1])
        axis = _in_base(tree, turns, chain[k], constant_vector(graph, (0.0, 0.0, 1.0)))
        # The next link of the same group has its own absolute angle, which moves everything beyond it.
        joined = k + 1 < len(chain) and links[chain[k + 1]].group == link.group
        linear = axis if link.prismatic else cross(axis, bars[k + 1] if joined else beyond)
        turned = zero(graph) if link.prismatic or joined else axis
        weights = link.rate if link.prismatic else link.turn
        for column, weight in zip(columns, weights, strict=True):
            for row, value in enumerate((*linear, *turned)):
                column[row] = column[row] + float(weight) * value
    return columns


def _in_base(tree: Tree, turns: list[Turn], link: int, v: Vector) -> Vector:
    """A vector of a link's frame in the base frame; -1 for the base itself."""
    while link >= 0:
        # Within a group one rotation leads to its base.
        head = tree.links[link].group
        v = rotated(tree.links[head].rotation, forth(turns[link], v))
        link = tree.links[head].parent
    return v
