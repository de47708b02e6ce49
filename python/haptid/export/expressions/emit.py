"""Expressions as straight-line code: one constant after the other, no loops, no branches, no memory but the stack."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from haptid.export.expressions.dialects import ARITHMETIC, DOUBLE, Dialect, Keeping
from haptid.export.expressions.graph import PARAMETER, RUN, Graph
from haptid.export.model.functions import Code, Function

# An expression used once and no longer than this, characters, is written where it is used.
INLINE = 44


@dataclass(frozen=True, eq=False)
class Emitted:
    """The generated part of the source.

    Attributes:
        constants: length of the array made once from the parameters, at least 1.
        init: statements that fill it.
        bodies: statements of every function, by its name.
    """

    constants: int
    init: tuple[str, ...]
    bodies: Mapping[str, tuple[str, ...]]


def emitted(code: Code, dialect: Keeping, wide: Dialect = DOUBLE) -> Emitted:
    """All functions' statements; what depends on parameters alone goes to the initialisation.

    Args:
        code: the functions.
        dialect: how they are written.
        wide: how the initialisation is, always in double precision.
    """
    graph = code.graph
    places: dict[int, int] = {}
    for function in code.functions:
        for node in sorted(_kept(graph, function)):
            places.setdefault(node, len(places))
    writer = _Writer(graph, wide, {})
    init = writer.statements(places, lambda node: graph.nodes[node].when == PARAMETER)
    # Names and one-operation parameters are read from their place like all others.
    init += [dialect.keep(place, writer.texts[node]) for node, place in places.items()]
    known = {node: dialect.kept(place) for node, place in places.items()}
    bodies = {f.name: tuple(_body(graph, f, dialect, known, dialect.begin())) for f in code.functions}
    return Emitted(max(len(places), 1), tuple(init), bodies)


def straight(code: Code, function: Function, dialect: Dialect) -> list[str]:
    """Statements of one function with everything in it, what depends on parameters alone too."""
    return _body(code.graph, function, dialect, {}, ())


def _kept(graph: Graph, function: Function) -> set[int]:
    """Parameter nodes that a function reads."""
    live = graph.live(function.all)
    read = {arg for node in live if graph.nodes[node].when == RUN for arg in graph.operands(node)}
    read |= {value.node for value in function.all}
    return {node for node in read if graph.nodes[node].when == PARAMETER}


def _body(
    graph: Graph, function: Function, dialect: Dialect, known: Mapping[int, str], begin: Sequence[str]
) -> list[str]:
    """Statements of one function; what is known is read as its text says, after the statements that begin."""
    writer = _Writer(graph, dialect, known)

    def wanted(node: int) -> bool:
        return not known or graph.nodes[node].when == RUN

    lines = writer.statements((value.node for value in function.all), wanted)
    if known and _kept(graph, function):
        lines = [*begin, *lines]
    if function.checks:
        lines += dialect.sound([writer.signed(check.sign, check.node) for check in function.checks])
    outputs = {name: [writer.signed(value.sign, value.node) for value in values] for name, values in function.outputs}
    return [*lines, *dialect.end(outputs, bool(function.checks))]


class _Writer:
    """Text of nodes, in the order in which they were made: operands first."""

    def __init__(self, graph: Graph, dialect: Dialect, known: Mapping[int, str]) -> None:
        self.graph, self.dialect = graph, dialect
        self.texts: dict[int, str] = dict(known)
        self.ops: dict[int, str] = {}

    def statements(self, outputs: Iterable[int], wanted: Callable[[int], bool]) -> list[str]:
        """Declarations of all that outputs need and that is not known yet."""
        graph, outputs = self.graph, list(outputs)
        live = graph.live(graph.at(node) for node in outputs)
        uses = Counter(arg for node in live for arg in graph.operands(node))
        uses.update(outputs)
        lines = []
        for node in sorted(live):
            if node in self.texts:
                continue
            op, args, _ = graph.nodes[node]
            if op in ("number", "name"):
                self.texts[node] = self._leaf(op, args[0])
                continue
            if not wanted(node):
                continue
            text = self._operation(op, graph.operands(node))
            if op in ARITHMETIC and uses[node] == 1 and len(text) <= INLINE:
                self.texts[node], self.ops[node] = text, op
            else:
                lines.append(self.dialect.constant(f"t{node}", text))
                self.texts[node] = f"t{node}"
        return lines

    def signed(self, sign: int, node: int) -> str:
        """A node's text, or minus it."""
        if sign > 0:
            return self.texts[node]
        return f"-({self.texts[node]})" if node in self.ops else f"-{self.texts[node]}"

    def _leaf(self, op: str, value: float | str | int) -> str:
        return self.dialect.literal(float(value)) if op == "number" else self.dialect.named(str(value))

    def _operation(self, op: str, args: tuple[int, ...]) -> str:
        if op in ARITHMETIC:
            return f"{self._operand(op, args[0], left=True)} {op} {self._operand(op, args[1], left=False)}"
        if op == "negative":
            text = self.texts[args[0]]
            return f"-({text})" if args[0] in self.ops else f"-{text}"
        return self.dialect.call(op, [self.texts[arg] for arg in args])

    def _operand(self, op: str, node: int, left: bool) -> str:
        """Brackets wherever C's rules would read it otherwise, and between equals on the right."""
        text, inner = self.texts[node], self.ops.get(node)
        if inner is None:
            return text
        plain = inner in "*/" if op in "+-" else False
        return text if plain or (left and inner == op) else f"({text})"
