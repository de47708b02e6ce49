"""Pose and Jacobian of a frame as expressions: of the handle in the base, of the frames of a cut in a common link.

In a group of parallel axes each link's absolute angle moves only its own bar, which keeps the Jacobian short.
"""

from __future__ import annotations

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.parts import Frame
from haptid.export.expressions.graph import Expr
from haptid.export.expressions.vectors import Turn, Vector, constant_vector, cross, forth, plus, rotated, zero
from haptid.export.model.tree import Link, Tree


@dataclass(frozen=True)
class FrameExpressions:
    """Pose and Jacobian of a frame, seen from a link that carries it.

    Attributes:
        position: of its origin, m.
        rotation: of its axes, rows of (3, 3).
        jacobian: rows of (6, coordinates): linear, then angular velocity per rate of the coordinates.
    """

    position: Vector
    rotation: tuple[Vector, Vector, Vector]
    jacobian: list[list[Expr]]

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Its x, y and z axis."""
        a, b, c = self.rotation
        return ((a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2]))


def frame_expressions(tree: Tree, frame: Frame, q: list[Expr], root: int = -1) -> FrameExpressions:
    """Pose and Jacobian of a frame.

    Args:
        frame: on its link.
        q: the coordinates.
        root: the link it is seen from, -1 for the base: from its origin, along the axes of the base of its group.
    """
    view = _View(tree, tree.turns(q), root)
    chain: list[int] = []
    i = frame.link
    while i != root:
        chain.insert(0, i)
        i = tree.links[i].parent
    bars = [view.of(tree.links[i].parent, tree.origin(i, q, 1.0)) for i in chain]
    bars.append(view.constant(frame.link, frame.translation))
    position = zero(q[0].graph)
    for bar in bars:
        position = plus(position, bar)
    axes = [view.constant(frame.link, column) for column in frame.rotation.T]
    x, y, z = ((axes[0][k], axes[1][k], axes[2][k]) for k in range(3))
    return FrameExpressions(position, (x, y, z), [list(row) for row in zip(*view.columns(chain, bars), strict=True)])


@dataclass(frozen=True, eq=False)
class _View:
    """Vectors as seen from a link.

    Attributes:
        tree: of all links.
        turns: of every link in its group's base.
        root: the link, -1 for the base.
    """

    tree: Tree
    turns: list[Turn]
    root: int

    def constant(self, link: int, values: Array) -> Vector:
        """A vector fixed to a link."""
        return self.of(link, constant_vector(self.turns[0][0].graph, values))

    def of(self, link: int, v: Vector) -> Vector:
        """A vector of a link's frame."""
        links = self.tree.links
        while link >= 0:
            # Within a group one rotation leads to its base.
            v, head = forth(self.turns[link], v), links[link].group
            if self.root >= 0 and head == links[self.root].group:
                break
            v, link = rotated(links[head].rotation, v), links[head].parent
        return v

    def columns(self, chain: list[int], bars: list[Vector]) -> list[list[Expr]]:
        """Columns of the Jacobian, (coordinates, 6).

        Args:
            chain: links from the root to the frame.
            bars: from the root to the first link's origin, from each origin to the next, and to the frame's.
        """
        graph, links = bars[0][0].graph, self.tree.links
        columns = [[graph.number(0.0)] * 6 for _ in range(self.tree.coordinates)]
        beyond = zero(graph)
        for k in reversed(range(len(chain))):
            link = links[chain[k]]
            beyond = plus(beyond, bars[k + 1])
            axis = self.of(chain[k], constant_vector(graph, (0.0, 0.0, 1.0)))
            # The next link of the same group has its own absolute angle, which moves everything beyond it.
            joined = k + 1 < len(chain) and links[chain[k + 1]].group == link.group
            linear = axis if link.prismatic else cross(axis, bars[k + 1] if joined else beyond)
            turned = zero(graph) if link.prismatic or joined else axis
            for column, weight in zip(columns, self._rates(link), strict=True):
                for row, value in enumerate((*linear, *turned)):
                    column[row] = column[row] + float(weight) * value
        return columns

    def _rates(self, link: Link) -> Array:
        """Rates of a link by the coordinates: sliding, or turning about the axis of its group without the root's."""
        if link.prismatic:
            return link.rate
        root = self.tree.links[self.root] if self.root >= 0 else None
        return link.turn - root.turn if root is not None and root.group == link.group else link.turn
