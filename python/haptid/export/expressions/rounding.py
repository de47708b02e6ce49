"""Bounds of the rounding errors of generated code in single precision, over a box of its inputs.

Every node has an interval of its values and a bound of its error, carried forward from operands to results. Components
of vectors that joints turn, c x + s y, are bounded together: a turned vector is as long as before. Without it bounds
would grow by sqrt(2) to 2 at every joint, outwards and back.

Source: Higham (2002), Accuracy and Stability of Numerical Algorithms, sections 2.2 and 3.3; Moore, Kearfott and Cloud
(2009), Introduction to Interval Analysis, section 2.3.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from haptid.export.expressions.functions_in_intervals import Interval, through
from haptid.export.expressions.graph import RUN, Expr, Graph
from haptid.export.expressions.rewriting import values_of

# Relative rounding error of single precision, with that of the double precision that it is compared with.
UNIT = 2.0**-24 + 2.0**-53
# Absolute one near zero, where small numbers may be flushed to it.
_SMALLEST = 2.0**-126
# Of the bounds, for the rounding of their own computation and products of three small numbers.
_MARGIN = 1.0 + 1e-6
_NOTHING_KNOWN = Interval(-math.inf, math.inf)

Nodes = tuple[int, ...]


class _Product(NamedTuple):
    """A sine or cosine times an operand, a term of a sum with its sign."""

    sign: int
    operand: int
    wave: int
    node: int


# The cosine's and the sine's product of one angle.
_Turn = dict[str, _Product]


class _Row(NamedTuple):
    """A node as a sum: turns by their angle, and all other terms with their factors."""

    turns: dict[int, _Turn]
    rest: list[tuple[int, int]]


def error_bounds(
    graph: Graph,
    outputs: Sequence[Expr],
    inputs: Mapping[str, Interval],
    parameters: Mapping[str, float],
) -> list[float]:
    """Bounds of the differences of single from double precision; infinite where none is known.

    Args:
        outputs: computed in both precisions from the same inputs.
        inputs: ranges of the names that are read at every call; of others nothing is known.
        parameters: values of the names that are not; computed in double precision and rounded.
    """
    analysis = _Analysis(graph, inputs)
    live = sorted(graph.live(outputs))
    known = [node for node in live if graph.nodes[node].when < RUN]
    values = values_of(graph, [graph.at(node) for node in known], {k: np.asarray(x) for k, x in parameters.items()})
    for node, value in zip(known, values, strict=True):
        analysis.rounded(node, float(value))
    for node in live:
        if graph.nodes[node].when == RUN:
            analysis.visit(node)
    return [_MARGIN * analysis.error[out.node] for out in outputs]


class _Analysis:
    """Ranges and errors of all nodes that were visited, operands first."""

    def __init__(self, graph: Graph, inputs: Mapping[str, Interval]) -> None:
        self.graph, self.inputs = graph, inputs
        self.range: dict[int, Interval] = {}
        self.size: dict[int, float] = {}
        self.error: dict[int, float] = {}
        # Errors over values, of numbers, names, their sums and products of those; of others none is known.
        self.relative: dict[int, float] = {}
        # Of sums: factors of their terms, and of the sums within them, each of which is rounded.
        self.terms: dict[int, dict[int, int]] = {}
        self.sums: dict[int, dict[int, int]] = {}
        self._lengths: dict[tuple[Nodes, bool], float] = {}

    def rounded(self, node: int, value: float) -> None:
        """A number that is stored in single precision."""
        with np.errstate(over="ignore"):
            stored = float(np.float32(value))
        self._keep(node, Interval(value, value), abs(stored - value))
        self.relative[node] = UNIT

    def visit(self, node: int) -> None:
        """Range and error from those of the operands."""
        op, args = self.graph.nodes[node].op, self.graph.operands(node)
        if op == "name":
            known = self.inputs.get(str(self.graph.nodes[node].args[0]))
            self._keep(node, known or _NOTHING_KNOWN, 0.0 if known else math.inf)
            self.relative[node] = 0.0
        elif not all(math.isfinite(self.error[arg]) for arg in args):
            self._keep(node, _NOTHING_KNOWN, math.inf)
        elif op in ("+", "-"):
            self._sum(node, op, args)
        elif op == "*":
            self._product(node, args)
        else:
            ranges, errors = [self.range[arg] for arg in args], [self.error[arg] for arg in args]
            relative = self.relative.get(args[0], math.inf)
            made, error, ulps = through(op, ranges, errors, relative)
            if ulps == 0:
                self.relative[node] = relative
            size = made.size + error
            last = min(2.0 * size, 1.0) if made.size <= 1.0 else 2.0 * size
            self._keep(node, made, error + ulps * (UNIT * last + _SMALLEST))

    def _keep(self, node: int, range_: Interval, error: float) -> None:
        self.range[node], self.size[node] = range_, range_.size
        self.error[node] = error if math.isfinite(error + range_.size) else math.inf

    def _product(self, node: int, args: tuple[int, ...]) -> None:
        a, b = args
        made = self.range[a].square() if a == b else self.range[a] * self.range[b]
        error = self.size[a] * self.error[b] + self.size[b] * self.error[a] + self.error[a] * self.error[b]
        self._keep(node, made, error + UNIT * (made.size + error) + _SMALLEST)
        self.relative[node] = _MARGIN * sum(self.relative.get(arg, math.inf) for arg in args) + UNIT

    def _sum(self, node: int, op: str, args: tuple[int, ...]) -> None:
        """The smaller of operand by operand, and of the whole sum as turned vectors."""
        left, right = args
        sign = 1 if op == "+" else -1
        self._flatten(node, ((left, 1), (right, sign)))
        plain = self.range[left] + (self.range[right] if sign > 0 else -self.range[right])
        self.range[node], self.size[node] = plain, plain.size
        most = self._length((node,), errors=False)
        made = Interval(max(plain.low, -most), min(plain.high, most))
        self.size[node] = made.size
        error = min(self.error[left] + self.error[right], self._length((node,), errors=True))
        self._keep(node, made, error + UNIT * (made.size + error) + _SMALLEST)
        if self.error[left] == self.error[right] == 0.0:
            self.relative[node] = UNIT

    def _flatten(self, node: int, args: Sequence[tuple[int, int]]) -> None:
        terms: dict[int, int] = {}
        sums = {node: 1}
        for arg, sign in args:
            for into, found in ((terms, self.terms.get(arg, {arg: 1})), (sums, self.sums.get(arg, {}))):
                for key, factor in found.items():
                    into[key] = into.get(key, 0) + sign * factor
        self.terms[node], self.sums[node] = {key: factor for key, factor in terms.items() if factor}, sums

    def _length(self, nodes: Nodes, errors: bool) -> float:
        """Bound of the root of the sum of squares of some nodes' values, or of their errors."""
        key = (nodes, errors)
        if key in self._lengths:
            return self._lengths[key]
        each = self.error if errors else self.size
        plain = math.inf if any(node not in each for node in nodes) else math.hypot(*(each[node] for node in nodes))
        rows = [self._row(node) for node in nodes]
        apart = [sum(abs(factor) * each[term] for factor, term in row.rest) for row in rows]
        if errors:
            apart = [x + self._own(node, row) for x, node, row in zip(apart, nodes, rows, strict=True)]
        made = math.hypot(*apart)
        for operands in _turned(rows):
            once = tuple(sorted(set(operands)))
            again = list(operands)
            for operand in once:
                again.remove(operand)
            made += math.hypot(self._length(once, errors), *(each[x] for x in again))
        if math.isfinite(plain):
            self._lengths[key] = min(plain, made)
        return min(plain, made)

    def _row(self, node: int) -> _Row:
        row = _Row({}, [])
        for term, factor in self.terms.get(node, {node: 1}).items():
            found = self._turning(term, row) if abs(factor) == 1 else None
            if found is None:
                row.rest.append((factor, term))
            else:
                angle, wave, operand = found
                function = self.graph.nodes[wave].op
                row.turns.setdefault(angle, {})[function] = _Product(factor, operand, wave, term)
        return row

    def _turning(self, term: int, row: _Row) -> tuple[int, int, int] | None:
        """Angle, sine or cosine, and operand of a product that has a place in the row; first where its partner is."""
        if self.graph.nodes[term].op != "*" or self.graph.nodes[term].when < RUN:
            return None
        a, b = self.graph.operands(term)
        found = []
        for wave, operand in ((a, b), (b, a)):
            function = self.graph.nodes[wave].op
            if function in ("sin", "cos"):
                angle = self.graph.operands(wave)[0]
                if function not in row.turns.get(angle, {}):
                    found.append((angle, wave, operand))
        return max(found, key=lambda each: each[0] in row.turns, default=None)

    def _own(self, node: int, row: _Row) -> float:
        """Errors of a sum that are not those of its operands: of sines and cosines, and of rounding."""
        made = 0.0
        for each in (product for turn in row.turns.values() for product in turn.values()):
            waving = (self.size[each.operand] + self.error[each.operand]) * self.error[each.wave]
            made += waving + UNIT * (self.size[each.node] + waving + self.error[each.operand]) + _SMALLEST
        for inner, factor in self.sums.get(node, {}).items():
            if inner in self.error:  # the last rounding of a sum is added to its error by its visit
                made += abs(factor) * (UNIT * (self.size[inner] + self.error[inner]) + _SMALLEST)
        return made


def _turned(rows: Sequence[_Row]) -> list[list[int]]:
    """Operands of the turned vectors in the rows, so many vectors as a row has turns, an operand for each component.

    Two rows c x + s y and c y - s x are the components of one turned vector (x, y).
    """
    common = [angle for row in rows for angle in row.turns]
    ordered = [sorted(row.turns, key=lambda angle: (-common.count(angle), angle)) for row in rows]
    made = []
    for k in range(max(map(len, ordered), default=0)):
        alone: list[tuple[int, int | None, int | None, int]] = []
        operands: list[int] = []
        for row, angles in zip(rows, ordered, strict=True):
            if k >= len(angles):
                continue
            turn = row.turns[angles[k]]
            x, y = (turn[name].operand if name in turn else None for name in ("cos", "sin"))
            sign = math.prod(product.sign for product in turn.values())
            # Where one of x and y is zero, either sign is that of a rotation.
            partners = [(angles[k], y, x, s) for s in ((-sign,) if None not in (x, y) else (1, -1))]
            partner = next((each for each in partners if each in alone), None)
            if partner is not None:
                alone.remove(partner)
            else:
                alone.append((angles[k], x, y, sign))
                operands += [operand for operand in (x, y) if operand is not None]
        made.append(operands)
    return made
