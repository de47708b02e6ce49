"""Expression graph: hash-consed nodes (common subexpressions are shared) with constant folding."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from haptid._internal.late import dataclass

# Evaluation time of a node: when the code is generated, once per parameter set, or at every call.
CONSTANT, PARAMETER, RUN = range(3)
# Functions of one number of the C library, in Python for constant folding.
LIBRARY: Mapping[str, Callable[[float], float]] = {
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "tanh": math.tanh,
    "exp": math.exp,
    "sqrt": math.sqrt,
    "fabs": abs,
    "sign": lambda x: float((x > 0) - (x < 0)),
    "above": lambda x: max(x, 0.0),
    "below": lambda x: min(x, 0.0),
}
# Odd functions, f(-x) = -f(x), and even ones: the sign of the argument moves out.
ODD = ("sin", "tan", "tanh", "sign")
EVEN = ("cos", "fabs")


class Node(NamedTuple):
    """One operation.

    Attributes:
        op: "number", "name", "negative", one of + - * / pow, or a function of LIBRARY.
        args: node indices; of a number its value, of a name its text.
        when: CONSTANT, PARAMETER or RUN.
    """

    op: str
    args: tuple[int, ...] | tuple[float] | tuple[str]
    when: int


class Graph:
    """Store of all nodes in topological order: operands come before the nodes that use them."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[str, tuple[object, ...]], int] = {}

    def number(self, value: float) -> Expr:
        """A constant; the sign is stored in the expression, so that x and -x share a node."""
        value = float(value)
        return Expr(self, -1 if value < 0 else 1, self._intern("number", (abs(value),), CONSTANT))

    def name(self, text: str, when: int = RUN) -> Expr:
        """A symbol: an input of the code, or with PARAMETER one of its parameters."""
        return Expr(self, 1, self._intern("name", (text,), when))

    def lift(self, value: Expr | float) -> Expr:
        """The value as an expression."""
        return value if isinstance(value, Expr) else self.number(value)

    def at(self, node: int) -> Expr:
        """A node as an expression."""
        return Expr(self, 1, node)

    def operands(self, node: int) -> tuple[int, ...]:
        """Indices of a node's operands; none for numbers and names."""
        op, args, _ = self.nodes[node]
        return () if op in ("number", "name") else args  # type: ignore[return-value]

    def live(self, outputs: Iterable[Expr]) -> set[int]:
        """All nodes that the outputs depend on."""
        seen: set[int] = set()
        waiting = [out.node for out in outputs]
        while waiting:
            node = waiting.pop()
            if node not in seen:
                seen.add(node)
                waiting += self.operands(node)
        return seen

    def apply(self, function: str, argument: Expr) -> Expr:
        """A function of LIBRARY of an expression."""
        value = argument.value
        if value is not None:
            return self.number(LIBRARY[function](value))
        inside = argument.node if function in (*ODD, *EVEN) else self._plain(argument)
        made = Expr(self, 1, self._intern(function, (inside,), argument.when))
        return -made if argument.sign < 0 and function in ODD else made

    def power(self, base: Expr, exponent: Expr) -> Expr:
        """pow(base, exponent); small integer exponents become products."""
        n = exponent.value
        if n is not None and n == int(n) and 0 <= n <= 4:
            made = self.number(1.0)
            for _ in range(int(n)):
                made = made * base
            return made
        plain = [self._plain(x) for x in (base, exponent)]
        when = max(base.when, exponent.when)
        return Expr(self, 1, self._intern("pow", (plain[0], plain[1]), when))

    def _plain(self, x: Expr) -> int:
        """A node whose value includes the sign of x."""
        return x.node if x.sign > 0 else self._intern("negative", (x.node,), x.when)

    def _intern(self, op: str, args: tuple[object, ...], when: int) -> int:
        key = (op, args)
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = len(self.nodes)
            self.nodes.append(Node(op, args, when))  # type: ignore[arg-type]
        return node

    def add(self, a: Expr, b: Expr) -> Expr:
        """The sum; zeros are dropped, constants folded."""
        va, vb = a.value, b.value
        if va is not None and vb is not None:
            return self.number(va + vb)
        if va == 0:
            return b
        if vb == 0:
            return a
        if a.node == b.node:
            return self.number(0.0) if a.sign != b.sign else self.number(2.0) * a
        if a.node > b.node:
            a, b = b, a
        op = "+" if a.sign == b.sign else "-"
        return Expr(self, a.sign, self._intern(op, (a.node, b.node), max(a.when, b.when)))

    def multiply(self, a: Expr, b: Expr) -> Expr:
        """The product; factors known earlier are collected: k1 (k2 x) becomes (k1 k2) x, and k1 k2 is computed once."""
        va, vb = a.value, b.value
        if va is not None and vb is not None:
            return self.number(va * vb)
        if va == 0 or vb == 0:
            return self.number(0.0)
        if va in (1, -1):
            return Expr(self, a.sign * b.sign, b.node)
        if vb in (1, -1):
            return Expr(self, a.sign * b.sign, a.node)
        if a.when > b.when:
            a, b = b, a
        if a.when < RUN and self.nodes[b.node].op == "*":
            x, y = sorted((self.at(i) for i in self.operands(b.node)), key=lambda e: e.when)
            if x.when < RUN:
                made = (self.at(a.node) * x) * y
                return Expr(self, a.sign * b.sign * made.sign, made.node)
        args = (min(a.node, b.node), max(a.node, b.node))
        return Expr(self, a.sign * b.sign, self._intern("*", args, max(a.when, b.when)))

    def divide(self, a: Expr, b: Expr) -> Expr:
        """The quotient.

        Raises:
            ZeroDivisionError: the divisor is identically zero.
        """
        value = b.value
        if value is not None:
            return a * (1.0 / value)
        if a.value == 0:
            return a
        return Expr(self, a.sign * b.sign, self._intern("/", (a.node, b.node), max(a.when, b.when)))


@dataclass(frozen=True, slots=True, eq=False)
class Expr:
    """An expression: a node of a graph with a sign.

    Attributes:
        graph: the store.
        sign: 1 or -1.
        node: its index.
    """

    graph: Graph
    sign: int
    node: int

    @property
    def value(self) -> float | None:
        """Value of a constant; None for other expressions."""
        op, args, _ = self.graph.nodes[self.node]
        return self.sign * float(args[0]) if op == "number" else None

    @property
    def when(self) -> int:
        """CONSTANT, PARAMETER or RUN."""
        return self.graph.nodes[self.node].when

    def __neg__(self) -> Expr:
        return self if self.value == 0 else Expr(self.graph, -self.sign, self.node)

    def __add__(self, other: Expr | float) -> Expr:
        return self.graph.add(self, self.graph.lift(other))

    __radd__ = __add__

    def __sub__(self, other: Expr | float) -> Expr:
        return self.graph.add(self, -self.graph.lift(other))

    def __rsub__(self, other: Expr | float) -> Expr:
        return self.graph.add(self.graph.lift(other), -self)

    def __mul__(self, other: Expr | float) -> Expr:
        return self.graph.multiply(self, self.graph.lift(other))

    __rmul__ = __mul__

    def __truediv__(self, other: Expr | float) -> Expr:
        return self.graph.divide(self, self.graph.lift(other))

    def __rtruediv__(self, other: Expr | float) -> Expr:
        return self.graph.divide(self.graph.lift(other), self)


@dataclass(frozen=True)
class Operations:
    """Operation count of one call, without operations on parameters alone.

    Attributes:
        multiplications, additions, divisions: subtractions count as additions.
        trigonometric: sines and cosines, each counted.
        others: other functions of the C library.
    """

    multiplications: int
    additions: int
    divisions: int
    trigonometric: int
    others: int

    @property
    def arithmetic(self) -> int:
        """Number of multiplications, additions and divisions."""
        return self.multiplications + self.additions + self.divisions


def operations(graph: Graph, outputs: Iterable[Expr]) -> Operations:
    """Operation count of the outputs at every call, shared subexpressions counted once."""
    found = Counter(graph.nodes[node].op for node in graph.live(outputs) if graph.nodes[node].when == RUN)
    trigonometric = found["sin"] + found["cos"]
    others = sum(found[op] for op in (*LIBRARY, "pow")) - trigonometric
    return Operations(found["*"], found["+"] + found["-"], found["/"], trigonometric, others)


def cost(graph: Graph, outputs: Iterable[Expr]) -> int:
    """Number of multiplications, additions and divisions."""
    return operations(graph, outputs).arithmetic
