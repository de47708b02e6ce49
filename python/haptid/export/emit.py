"""Expressions as C99: one constant after the other, no loops, no branches, no memory but the stack."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from haptid.export.functions import Code, Function
from haptid.export.graph import PARAMETER, RUN, Graph

# An expression used once and no longer than this, characters, is written where it is used.
INLINE = 44
ARITHMETIC = ("+", "-", "*", "/")


@dataclass(frozen=True)
class Dialect:
    """How numbers look.

    Attributes:
        real: the type.
        suffix: of literals and of the C library's functions.
    """

    real: str
    suffix: str

    def literal(self, value: float) -> str:
        """A number that reads back as itself."""
        return repr(value) + self.suffix


DOUBLE = Dialect("double", "")
SINGLE = Dialect("float", "f")


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


def emitted(code: Code, dialect: Dialect) -> Emitted:
    """All functions' statements; what depends on parameters alone goes to the initialisation, always in double."""
    graph = code.graph
    places: dict[int, int] = {}
    for function in code.functions:
        for node in sorted(_kept(graph, function)):
            places.setdefault(node, len(places))
    writer = _Writer(graph, DOUBLE, {})
    init = writer.statements(places, lambda node: graph.nodes[node].when == PARAMETER)
    # Names and one-operation parameters are read from their place like all others.
    cast = "" if dialect is DOUBLE else f"({dialect.real})"
    init += [f"model->k[{place}] = {cast}{_bracketed(writer.texts[node], cast)};" for node, place in places.items()]
    bodies = {function.name: tuple(_body(graph, function, dialect, places)) for function in code.functions}
    return Emitted(max(len(places), 1), tuple(init), bodies)


def _bracketed(text: str, cast: str) -> str:
    return f"({text})" if cast and " " in text else text


def _kept(graph: Graph, function: Function) -> set[int]:
    """Parameter nodes that a function reads."""
    live = graph.live(function.all)
    read = {arg for node in live if graph.nodes[node].when == RUN for arg in graph.operands(node)}
    read |= {value.node for value in function.all}
    return {node for node in read if graph.nodes[node].when == PARAMETER}


def _body(graph: Graph, function: Function, dialect: Dialect, places: Mapping[int, int]) -> list[str]:
    """Statements of one function."""
    writer = _Writer(graph, dialect, {node: f"k[{place}]" for node, place in places.items()})
    lines = writer.statements((value.node for value in function.all), lambda node: graph.nodes[node].when == RUN)
    if any("k[" in line for line in (*lines, *writer.texts.values())) and _kept(graph, function):
        lines.insert(0, f"const {dialect.real} *const k = model->k;")
    zero = dialect.literal(0.0)
    if function.checks:
        tests = " && ".join(f"({writer.signed(check.sign, check.node)} > {zero})" for check in function.checks)
        lines.append(f"const int sound = {tests};")
    for name, values in function.outputs:
        for place, value in enumerate(values):
            text = writer.signed(value.sign, value.node)
            text = f"(sound != 0) ? ({text}) : {zero}" if function.checks else text
            lines.append(f"{name}[{place}] = {text};")
    if function.checks:
        lines.append("return (sound != 0) ? 0 : 1;")
    return lines


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
                self.texts[node] = self.dialect.literal(args[0]) if op == "number" else str(args[0])  # type: ignore[arg-type]
                continue
            if not wanted(node):
                continue
            text = self._operation(op, graph.operands(node))
            if op in ARITHMETIC and uses[node] == 1 and len(text) <= INLINE:
                self.texts[node], self.ops[node] = text, op
            else:
                lines.append(f"const {self.dialect.real} t{node} = {text};")
                self.texts[node] = f"t{node}"
        return lines

    def signed(self, sign: int, node: int) -> str:
        """A node's text, or minus it."""
        if sign > 0:
            return self.texts[node]
        return f"-({self.texts[node]})" if node in self.ops else f"-{self.texts[node]}"

    def _operation(self, op: str, args: tuple[int, ...]) -> str:
        suffix, zero = self.dialect.suffix, self.dialect.literal(0.0)
        if op in ARITHMETIC:
            return f"{self._operand(op, args[0], left=True)} {op} {self._operand(op, args[1], left=False)}"
        text = self.texts[args[0]]
        if op == "negative":
            return f"-({text})" if args[0] in self.ops else f"-{text}"
        if op == "pow":
            return f"pow{suffix}({text}, {self.texts[args[1]]})"
        if op in ("above", "below"):
            return f"{'fmax' if op == 'above' else 'fmin'}{suffix}({text}, {zero})"
        if op == "sign":
            return f"({self.dialect.real})(({text}) > {zero}) - ({self.dialect.real})(({text}) < {zero})"
        return f"{op}{suffix}({text})"

    def _operand(self, op: str, node: int, left: bool) -> str:
        """Brackets wherever C's rules would read it otherwise, and between equals on the right."""
        text, inner = self.texts[node], self.ops.get(node)
        if inner is None:
            return text
        plain = inner in "*/" if op in "+-" else False
        return text if plain or (left and inner == op) else f"({text})"
