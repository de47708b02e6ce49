"""Algebraic factoring: sums and products are flattened, common factors taken out, and the expressions rebuilt."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from haptid.export.expressions.graph import RUN, Expr, Graph, cost

# A product in a sum: its sign, and the factor nodes.
Term = tuple[int, tuple[int, ...]]
# Rounds of factoring; more give no improvement.
_ROUNDS = 3


def shortest(graph: Graph, outputs: Sequence[Expr]) -> list[Expr]:
    """The outputs unchanged or factored in up to ROUNDS rounds, whichever is cheapest."""
    forms = [list(outputs)]
    for _ in range(_ROUNDS):
        forms.append(factored(graph, forms[-1]))
    return min(forms, key=lambda form: cost(graph, form))


def factored(graph: Graph, outputs: Sequence[Expr]) -> list[Expr]:
    """The same outputs, with a b + a c written as a (b + c)."""
    rewriting = _Rewriting(graph, outputs)
    made = [(out.sign, rewriting.expression(out.node)) for out in outputs]
    return [expr if sign > 0 else -expr for sign, expr in made]


class _Rewriting:
    """One pass over the outputs: sums and products that are used once are merged into their user."""

    def __init__(self, graph: Graph, outputs: Sequence[Expr]) -> None:
        self.graph = graph
        self.uses = Counter(out.node for out in outputs)
        for node in graph.live(outputs):
            for arg in graph.operands(node):  # `update` takes five times as long for one or two
                self.uses[arg] += 1
        self.made: dict[int, Expr] = {}

    def expression(self, node: int) -> Expr:
        """The rewritten node, memoised."""
        if node not in self.made:
            self.made[node] = self._rewritten(node)
        return self.made[node]

    def _rewritten(self, node: int) -> Expr:
        graph, (op, _, when) = self.graph, self.graph.nodes[node]
        args = graph.operands(node)
        if when < RUN or not args:
            return graph.at(node)
        if op in "+-":
            return self._sum(self._terms(node, 1))
        if op == "*":
            return self._product(self._factors(node))
        inner = [self.expression(arg) for arg in args]
        if op == "/":
            return inner[0] / inner[1]
        if op == "pow":
            return graph.power(inner[0], inner[1])
        return -inner[0] if op == "negative" else graph.apply(op, inner[0])

    def _merges(self, node: int, ops: str) -> bool:
        known = self.graph.nodes[node]
        return known.op in ops and known.when == RUN and self.uses[node] == 1

    def _terms(self, node: int, sign: int) -> list[Term]:
        """The products of a flattened sum."""
        left, right = self.graph.operands(node)
        found: list[Term] = []
        for arg, s in ((left, sign), (right, sign if self.graph.nodes[node].op == "+" else -sign)):
            if self._merges(arg, "+-"):
                found += self._terms(arg, s)
            else:
                found.append((s, self._factors(arg)))
        return found

    def _factors(self, node: int) -> tuple[int, ...]:
        """The factors of a flattened product."""
        if self.graph.nodes[node].op != "*" or self.graph.nodes[node].when < RUN:
            return (node,)
        found: list[int] = []
        for arg in self.graph.operands(node):
            found += self._factors(arg) if self._merges(arg, "*") else (arg,)
        return tuple(sorted(found))

    def _product(self, factors: tuple[int, ...]) -> Expr:
        made = self.graph.number(1.0)
        for factor in sorted(factors, key=lambda node: (self.graph.nodes[node].when == RUN, node)):
            made = made * self.expression(factor)
        return made

    def _sum(self, terms: list[Term]) -> Expr:
        """Take out the factor that most products share, then recurse on both parts."""
        shared = Counter(node for _, factors in terms for node in set(factors))
        best = max(shared, default=-1, key=lambda node: (shared[node], self.graph.nodes[node].when == RUN, -node))
        if shared[best] > 1 and len(terms) > 1:
            inside = [(sign, _without(factors, best)) for sign, factors in terms if best in factors]
            outside = [term for term in terms if best not in term[1]]
            made = self.expression(best) * self._sum(inside)
            return made + self._sum(outside) if outside else made
        made = self.graph.number(0.0)
        for sign, factors in sorted(terms, key=lambda term: (self._latest(term[1]), term[1])):
            product = self._product(factors)
            made = made + product if sign > 0 else made - product
        return made

    def _latest(self, factors: tuple[int, ...]) -> int:
        return max((self.graph.nodes[node].when for node in factors), default=0)


def _without(factors: tuple[int, ...], node: int) -> tuple[int, ...]:
    """The factors without one occurrence of a node."""
    k = factors.index(node)
    return factors[:k] + factors[k + 1 :]
