"""Loops that are not linear as expressions: gaps of the cuts, closing by Newton's method, and what the closing implies.

With J = [B A] the Jacobian of the gaps by the coordinates c and by the passive positions z, J xd = 0 gives the rates
zd = -A^+ B cd and the accelerations zdd = -A^+ (B cdd + dJ/dt xd); tau_c and tau_z, the torque of the open tree, become
tau_c - B' A'^+ tau_z (Khalil and Dombre 2002, sections 7.5 and 10.5). Nothing is iterated but the positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.loops.formula import FormulaClosure
from haptid.device.loops.linear import Closure
from haptid.device.loops.newton import NewtonClosure
from haptid.device.parts import Cut
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.factoring import shortest
from haptid.export.expressions.graph import Expr, Graph
from haptid.export.expressions.rewriting import derivatives_along, replaced, values_of
from haptid.export.expressions.solving import Orthogonal
from haptid.export.expressions.vectors import Vector, combined, cross, dot
from haptid.export.model.frames import FrameExpressions, frame_expressions
from haptid.export.model.tree import Tree

# Newton steps from the last pose, before one with the matrix of the last of them: enough for rounding at 1 kHz.
_STEPS = 2
# Greatest error bound of passive positions that counts as closed, rad, or sizes of the mechanism.
CLOSED = 1e-5
# Kept from zero: the bound where both of the last steps are zero.
_TINY = 1e-30
# Random positions at which a gap is compared with zero, and what counts as zero, in sizes of the mechanism.
_PLACES, _NOTHING = 4, 1e-10


@dataclass(frozen=True, eq=False)
class Closing:
    """The result of closing loops: see `LoopExpressions.close`.

    Attributes:
        positions: of the passive joints, rad or m.
        bound: on their error, rad or sizes of the mechanism, beyond rounding.
        checks: all positive where the loops are closed, away from singular poses.
    """

    positions: list[Expr]
    bound: Expr
    checks: list[Expr]


@dataclass(frozen=True, eq=False)
class LoopExpressions:
    """Loops at one pose; without any, all of it is empty, and torques are unchanged.

    Attributes:
        tree: of all links.
        x: its coordinates: those of the torque rows, then the passive positions; names.
        xd: their rates; names.
        gaps: of the cuts, m.
        jacobian: of the gaps by all coordinates, rows.
        units: scale of every passive position, rad or m.
    """

    tree: Tree
    x: list[Expr]
    xd: list[Expr]
    gaps: list[Expr]
    jacobian: list[list[Expr]]
    units: Array

    @staticmethod
    def of(model: DynamicModel, tree: Tree, x: list[Expr], xd: list[Expr]) -> LoopExpressions:
        """The cuts between whose frames there are passive positions."""
        closure = model.device.closure
        gaps: list[Expr] = []
        jacobian: list[list[Expr]] = []
        units = closure.offset[:0]
        if not isinstance(closure, Closure):
            units = closure.units[list(tree.passive)]
        if isinstance(closure, FormulaClosure):
            gaps, jacobian = _formulas(model, closure, tree, x)
        elif isinstance(closure, NewtonClosure):
            for cuts, _ in closure.chain.independent(closure.unknown):
                for cut in cuts:
                    equations = _effective(_equations(tree, cut, x, closure.chain.size), x, closure.chain.size)
                    gaps += [gap for gap, _ in equations]
                    jacobian += [row for _, row in equations]
        flat = shortest(x[0].graph, [*gaps, *(entry for row in jacobian for entry in row)])
        n, m = len(gaps), tree.coordinates
        return LoopExpressions(tree, x, xd, flat[:n], [flat[n + m * k : n + m * (k + 1)] for k in range(n)], units)

    @property
    def graph(self) -> Graph:
        return self.x[0].graph

    @cached_property
    def _B(self) -> list[list[Expr]]:
        return [row[: self.tree.active] for row in self.jacobian]

    @cached_property
    def factors(self) -> Orthogonal:
        """Of A."""
        return Orthogonal.of([row[self.tree.active :] for row in self.jacobian])

    @cached_property
    def jacobian_by_rows(self) -> list[list[Expr]]:
        """G, rates of the passive positions by the coordinates, (passive, active)."""
        columns = [[-z for z in self.factors.solve([row[k] for row in self._B])] for k in range(self.tree.active)]
        return [list(row) for row in zip(*columns, strict=True)]

    def rates(self, cd: Sequence[Expr]) -> list[Expr]:
        """Rates of the passive positions."""
        return [-z for z in self.factors.solve([dot(row, cd) for row in self._B])] if self.gaps else []

    def accelerations(self, cdd: Sequence[Expr]) -> list[Expr]:
        """Accelerations of the passive positions, by the rates `xd`."""
        if not self.gaps:
            return []
        moved = [dot(row, self.xd) for row in self.jacobian]
        bias = shortest(self.graph, self._along(moved))
        return [-z for z in self.factors.solve([dot(row, cdd) + b for row, b in zip(self._B, bias, strict=True)])]

    def projected(self, f: Sequence[Expr]) -> list[Expr]:
        """Torques on the coordinates of the rows, from those on the tree's."""
        on_rows, on_passive = list(f[: self.tree.active]), list(f[self.tree.active :])
        if not any(value.value != 0 for value in on_passive):
            return on_rows
        forces = self.factors.transposed(on_passive)
        return [t - dot(column, forces) for t, column in zip(on_rows, zip(*self._B, strict=True), strict=True)]

    def turning(self, p: Sequence[Expr]) -> list[Expr]:
        """(dJ/dt)' A'^+ p_z of a momentum of the tree: what its projection changes by, on the tree's coordinates."""
        if not self.gaps:
            return [self.graph.number(0.0)] * self.tree.coordinates
        names = [self.graph.name(f"force[{k}]") for k in range(len(self.gaps))]
        forces = self.factors.transposed(list(p[self.tree.active :]))
        made = shortest(self.graph, self._along([dot(column, names) for column in zip(*self.jacobian, strict=True)]))
        return replaced(self.graph, made, {name.node: f for name, f in zip(names, forces, strict=True)})

    def close(self, before: list[Expr]) -> Closing:
        """The passive positions, by Newton steps from those before.

        The last step repeats the matrix of the step before it, so that both lengths give the factor by which steps
        shrink, and with it a bound on what is left (Ortega and Rheinboldt 1970, 12.1.2; the factor of the next step
        is about twice that of the last, hence 4).
        """
        z, checks, steps = before, [], []
        for _ in range(_STEPS):
            A, gaps = self._at(z)
            factors = Orthogonal.of(A)
            steps.append(factors.solve(gaps))
            z, checks = [a - b for a, b in zip(z, steps[-1], strict=True)], factors.checks
        steps.append(factors.solve(self._at(z)[1]))
        z = [a - b for a, b in zip(z, steps[-1], strict=True)]
        squares, last = (self._square(step) for step in steps[-2:])
        length, end = (self.graph.apply("sqrt", value) for value in (squares, last))
        bound = 4.0 * last / (length + end + _TINY)
        return Closing(z, bound, [CLOSED - bound, *checks])

    def _along(self, values: list[Expr]) -> list[Expr]:
        """Derivatives along the motion, the rates held."""
        rates = {x.node: rate for x, rate in zip(self.x, self.xd, strict=True)}
        return derivatives_along(self.graph, values, rates)

    def _at(self, z: list[Expr]) -> tuple[list[list[Expr]], list[Expr]]:
        """A and the gaps at other passive positions."""
        n, passive = self.tree.active, len(self.tree.passive)
        there = {x.node: value for x, value in zip(self.x[n:], z, strict=True)}
        flat = replaced(self.graph, [*self.gaps, *(a for row in self.jacobian for a in row[n:])], there)
        gaps, entries = flat[: len(self.gaps)], flat[len(self.gaps) :]
        return [entries[k : k + passive] for k in range(0, len(entries), passive)], gaps

    def _square(self, step: list[Expr]) -> Expr:
        """Squared length of a step, in its units."""
        scaled = [value * (1.0 / float(unit)) for value, unit in zip(step, self.units, strict=True)]
        return dot(scaled, scaled)


def _formulas(
    model: DynamicModel, closure: FormulaClosure, tree: Tree, x: list[Expr]
) -> tuple[list[Expr], list[list[Expr]]]:
    """Gaps of passive positions from their polynomials, and the Jacobian: closing them takes one Newton step."""
    graph, n, to_joints = x[0].graph, tree.active, np.linalg.inv(model.device.row_map)
    at = {symbol: combined(row, x[:n]) for symbol, row in zip(closure.symbols, to_joints, strict=True)}
    gaps, jacobian = [], []
    for i, j in enumerate(tree.passive):
        polynomial = closure.polynomials[j]
        gaps.append(x[n + i] - polynomial.value(at))
        slopes = [graph.lift(polynomial.slope(symbol).value(at)) for symbol in closure.symbols]
        others = [graph.number(float(k == i)) for k in range(len(tree.passive))]
        jacobian.append([*(-combined(column, slopes) for column in to_joints.T), *others])
    return gaps, jacobian


# A gap and its row of the Jacobian.
_Equation = tuple[Expr, list[Expr]]


def _equations(tree: Tree, cut: Cut, x: list[Expr], size: float) -> list[_Equation]:
    """Gaps of a cut, m, angles times the mechanism's size, and their Jacobian where they are closed."""
    root = _common(tree, cut.frame_a.link, cut.frame_b.link)
    a, b = (frame_expressions(tree, frame, x, root) for frame in (cut.frame_a, cut.frame_b))
    apart: Vector = (b.position[0] - a.position[0], b.position[1] - a.position[1], b.position[2] - a.position[2])
    rates = [
        [q - p for p, q in zip(one, other, strict=True)] for one, other in zip(a.jacobian, b.jacobian, strict=True)
    ]
    linear, angular = _columns(rates)
    if cut.kind == "prismatic":
        across = [_measured(axis, apart, linear, _columns(a.jacobian)[1]) for axis in a.axes[:2]]
        return across + [_turned(a, b, k, (k + 1) % 3, angular, size) for k in range(3)]
    made = [(apart[k], [column[k] for column in linear]) for k in range(3)]
    if cut.kind == "revolute":
        made += [_turned(a, b, k, 2, angular, size) for k in range(2)]
    return made


def _effective(equations: list[_Equation], x: list[Expr], size: float) -> list[_Equation]:
    """Without those that hold at any positions, closed or not, as across the plane of a planar loop."""
    graph, rng = x[0].graph, np.random.default_rng(0)
    places = {str(graph.nodes[name.node].args[0]): rng.uniform(-1, 1, _PLACES) for name in x}
    kept = []
    for gap, row in equations:
        values = values_of(graph, [gap, *row], places)
        if max(float(np.abs(value).max()) for value in values) > _NOTHING * size:
            kept.append((gap, row))
    return kept


def _columns(jacobian: list[list[Expr]]) -> tuple[list[Vector], list[Vector]]:
    """Linear and angular velocity per rate of every coordinate."""
    columns = list(zip(*jacobian, strict=True))
    return [column[:3] for column in columns], [column[3:] for column in columns]


def _measured(axis: Vector, apart: Vector, linear: list[Vector], turning: list[Vector]) -> _Equation:
    """The distance along an axis of frame a, which turns."""
    arm = cross(apart, axis)  # a . (v - w x d) = a . v - w . (d x a)
    return dot(axis, apart), [dot(axis, v) - dot(arm, w) for v, w in zip(linear, turning, strict=True)]


def _turned(
    a: FrameExpressions, b: FrameExpressions, own: int, other: int, angular: list[Vector], size: float
) -> _Equation:
    """The cosine between an axis of frame a and another axis of frame b, which is zero where the frames agree."""
    third = 3 - own - other
    sign = 1.0 if (own - other) % 3 == 1 else -1.0  # w . (b x a)
    row = [(sign * size) * dot(a.axes[third], w) for w in angular]
    return size * dot(a.axes[own], b.axes[other]), row


def _common(tree: Tree, one: int, other: int) -> int:
    """The last link that carries both, -1 for the base."""
    carriers: list[list[int]] = []
    for link in (one, other):
        found = [-1]
        while link >= 0:
            found.insert(1, link)
            link = tree.links[link].parent
        carriers.append(found)
    one_way, other_way = carriers
    return max(i for i, j in zip(one_way, other_way, strict=False) if i == j)
