"""Straight-line code generation: single-assignment constants, no loops, no branches, no heap memory."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field

from haptid._internal.late import dataclass
from haptid.export.expressions.dialects import ARITHMETIC, DOUBLE, Dialect, Keeping
from haptid.export.expressions.graph import PARAMETER, RUN, Expr, Graph

# Expressions used once are inlined up to this length, characters.
INLINE = 44


@dataclass(frozen=True)
class Function:
    """A function of the generated code.

    Attributes:
        name: without the model's prefix.
        about: documentation with units, lines.
        inputs: names and sizes of the input arrays.
        outputs: names of the output arrays, and their expressions.
        checks: expressions that must be positive; otherwise the function returns zeros and a failure.
        parameters: whether it depends on the parameters, or on geometry alone.
        otherwise: inputs that take the place of outputs where the checks fail, by the output's name.
    """

    name: str
    about: tuple[str, ...]
    inputs: tuple[tuple[str, int], ...]
    outputs: tuple[tuple[str, tuple[Expr, ...]], ...]
    checks: tuple[Expr, ...] = ()
    parameters: bool = True
    otherwise: Mapping[str, str] = field(default_factory=dict)

    @property
    def all(self) -> list[Expr]:
        """All expressions that it computes."""
        return [*(value for _, values in self.outputs for value in values), *self.checks]


@dataclass(frozen=True, eq=False)
class Emitted:
    """Generated code of all functions.

    Attributes:
        constants: length of the array that is precomputed from the parameters, at least 1.
        init: statements that fill it.
        bodies: statements of every function, by its name.
    """

    constants: int
    init: tuple[str, ...]
    bodies: Mapping[str, tuple[str, ...]]


def emitted(graph: Graph, functions: Sequence[Function], dialect: Keeping, wide: Dialect = DOUBLE) -> Emitted:
    """Statements of all functions; operations on parameters alone are moved to the initialisation.

    Args:
        graph: the store of their expressions.
        functions: to be written.
        dialect: their language.
        wide: language of the initialisation, always in double precision.
    """
    places: dict[int, int] = {}
    for function in functions:
        for node in sorted(_kept(graph, function)):
            places.setdefault(node, len(places))
    writer = _Writer(graph, wide, {})
    init = writer.statements(places, lambda node: graph.nodes[node].when == PARAMETER)
    # Names and one-operation parameters are read from the array like all others.
    init += [dialect.keep(place, writer.texts[node]) for node, place in places.items()]
    known = {node: dialect.kept(place) for node, place in places.items()}
    bodies = {f.name: tuple(_body(graph, f, dialect, known, dialect.begin())) for f in functions}
    return Emitted(max(len(places), 1), tuple(init), bodies)


def straight(graph: Graph, function: Function, dialect: Dialect) -> list[str]:
    """Statements of one function including the operations on parameters alone."""
    return _body(graph, function, dialect, {}, ())


def _kept(graph: Graph, function: Function) -> set[int]:
    """Parameter nodes that a function reads."""
    live = graph.live(function.all)
    read = {arg for node in live if graph.nodes[node].when == RUN for arg in graph.operands(node)}
    read |= {value.node for value in function.all}
    return {node for node in read if graph.nodes[node].when == PARAMETER}


def _body(
    graph: Graph, function: Function, dialect: Dialect, known: Mapping[int, str], begin: Sequence[str]
) -> list[str]:
    """Statements of one function; `known` has the text of precomputed nodes, `begin` the statements they require."""
    writer = _Writer(graph, dialect, known, guarded=bool(function.checks))

    def wanted(node: int) -> bool:
        return not known or graph.nodes[node].when == RUN

    lines = writer.statements((value.node for value in function.all), wanted)
    if known and _kept(graph, function):
        lines = [*begin, *lines]
    if function.checks:
        lines += dialect.sound([writer.signed(check.sign, check.node) for check in function.checks])
    outputs = {name: [writer.signed(value.sign, value.node) for value in values] for name, values in function.outputs}
    return [*lines, *dialect.end(outputs, function.otherwise if function.checks else None)]


class _Writer:
    """Text of nodes in topological order.

    Args:
        known: text of nodes that are computed elsewhere.
        guarded: whether divisors must not be zero, since a check fails where they are.
    """

    def __init__(self, graph: Graph, dialect: Dialect, known: Mapping[int, str], guarded: bool = False) -> None:
        self.graph, self.dialect, self.guarded = graph, dialect, guarded
        self.texts: dict[int, str] = dict(known)
        self.ops: dict[int, str] = {}

    def statements(self, outputs: Iterable[int], wanted: Callable[[int], bool]) -> list[str]:
        """Declarations of all nodes that the outputs depend on and that are not known yet."""
        graph, outputs = self.graph, list(outputs)
        live = graph.live(graph.at(node) for node in outputs)
        uses = Counter(arg for node in live for arg in graph.operands(node))
        uses.update(outputs)
        divisors = {graph.operands(node)[1] for node in live if graph.nodes[node].op == "/"} if self.guarded else set()
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
            if op in ARITHMETIC and uses[node] == 1 and len(text) <= INLINE and node not in divisors:
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
        if op == "/" and self.guarded:
            return f"{self._operand(op, args[0], left=True)} / {self.dialect.divisor(self.texts[args[1]])}"
        if op in ARITHMETIC:
            return f"{self._operand(op, args[0], left=True)} {op} {self._operand(op, args[1], left=False)}"
        if op == "negative":
            text = self.texts[args[0]]
            return f"-({text})" if args[0] in self.ops else f"-{text}"
        return self.dialect.call(op, [self.texts[arg] for arg in args])

    def _operand(self, op: str, node: int, left: bool) -> str:
        """Brackets where C's precedence requires them, and around right operands of equal precedence."""
        text, inner = self.texts[node], self.ops.get(node)
        if inner is None:
            return text
        plain = inner in "*/" if op in "+-" else False
        return text if plain or (left and inner == op) else f"({text})"
