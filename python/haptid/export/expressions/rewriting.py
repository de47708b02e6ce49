"""Expressions from expressions: derivatives by names, names replaced by expressions, values at some numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.export.expressions.graph import Expr, Graph

# Operations on arrays.
NUMERICALLY: Mapping[str, Callable[..., Array]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": np.divide,
    "pow": np.power,
    "negative": np.negative,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt": np.sqrt,
    "fabs": np.abs,
    "sign": np.sign,
    "above": lambda x: np.maximum(x, 0),
    "below": lambda x: np.minimum(x, 0),
}


def derivatives_along(graph: Graph, outputs: Sequence[Expr], rates: Mapping[int, Expr]) -> list[Expr]:
    """Derivatives of the outputs along a motion of some names, by forward differentiation.

    Args:
        outputs: sums, products and quotients of names, sines and cosines.
        rates: of the names, by node; all others are constant.
    """
    none, made = graph.number(0.0), dict(rates)
    for node in sorted(graph.live(outputs)):
        made.setdefault(node, _derivative(graph, node, made, none))
    return [made[out.node] if out.sign > 0 else -made[out.node] for out in outputs]


def _derivative(graph: Graph, node: int, known: Mapping[int, Expr], none: Expr) -> Expr:
    op, args = graph.nodes[node].op, [graph.at(arg) for arg in graph.operands(node)]
    rates = [known[arg.node] for arg in args]
    if all(rate.value == 0 for rate in rates):
        return none
    match op:
        case "+":
            return rates[0] + rates[1]
        case "-":
            return rates[0] - rates[1]
        case "*":
            return rates[0] * args[1] + args[0] * rates[1]
        case "/":
            return (rates[0] - graph.at(node) * rates[1]) / args[1]
        case "negative":
            return -rates[0]
        case "sin":
            return graph.apply("cos", args[0]) * rates[0]
        case "cos":
            return -graph.apply("sin", args[0]) * rates[0]
    raise TypeError(f"the derivative of {op} is not written")


def values_of(graph: Graph, outputs: Sequence[Expr], values: Mapping[str, Array]) -> list[Array]:
    """Values of the outputs from values of their names, arrays of one shape."""
    known: dict[int, Array] = {}
    for node in sorted(graph.live(outputs)):
        op, args, _ = graph.nodes[node]
        if op == "number":
            known[node] = np.asarray(args[0], dtype=float)
        elif op == "name":
            known[node] = values[str(args[0])]
        else:
            known[node] = np.asarray(NUMERICALLY[op](*(known[arg] for arg in graph.operands(node))))
    return [out.sign * known[out.node] for out in outputs]


def replaced(graph: Graph, outputs: Sequence[Expr], values: Mapping[int, Expr]) -> list[Expr]:
    """The outputs with expressions in place of some names, by node."""
    if not values:
        return list(outputs)
    made = dict(values)
    for node in sorted(graph.live(outputs)):
        if node not in made:
            made[node] = _rebuilt(graph, node, made)
    return [made[out.node] if out.sign > 0 else -made[out.node] for out in outputs]


def _rebuilt(graph: Graph, node: int, made: Mapping[int, Expr]) -> Expr:
    op, before = graph.nodes[node].op, graph.operands(node)
    args = [made[arg] for arg in before]
    if all(x.node == arg and x.sign > 0 for x, arg in zip(args, before, strict=True)):
        return graph.at(node)
    match op:
        case "+":
            return args[0] + args[1]
        case "-":
            return args[0] - args[1]
        case "*":
            return args[0] * args[1]
        case "/":
            return args[0] / args[1]
        case "pow":
            return graph.power(args[0], args[1])
        case "negative":
            return -args[0]
    return graph.apply(op, args[0])
