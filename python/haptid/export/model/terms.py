"""Torque of friction, springs and the other terms of a device as expressions."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from haptid.device.expressions import CustomColumn
from haptid.device.terms.friction import DRY, LoadDependentFriction
from haptid.device.terms.presliding import Presliding
from haptid.device.terms.spring import Counterbalance
from haptid.device.terms.term import TermColumn
from haptid.device.terms.warming import Warming
from haptid.dynamics.model import DynamicModel
from haptid.errors import ExportError
from haptid.export.expressions.graph import Expr, Graph
from haptid.export.expressions.vectors import combined
from haptid.export.model.tree import Tree


def term_torque(
    model: DynamicModel,
    tree: Tree,
    parameters: Sequence[Expr],
    q: list[Expr],
    qd: list[Expr],
    speed: float,
    wanted: Callable[[TermColumn], bool],
) -> list[Expr]:
    """Torque of the terms on the tree's coordinates, without rotors.

    Args:
        parameters: the device's base parameters.
        q, qd: the coordinates and their rates.
        speed: below it the sign of a velocity is smoothed, rad/s or m/s.
        wanted: whether a term counts.
    """
    S = model.device.parameters.S[10 * len(model.device.joints) :, list(model.base.independent_columns)]
    graph = q[0].graph
    tau = [graph.number(0.0)] * len(q)
    for term, row in zip(model.terms, S, strict=True):
        if term.kind == "rotor" or not wanted(term) or not row.any():
            continue
        parameter = combined(row, parameters)
        weights = tree.of_term(term)
        torque = parameter * _column(model, tree, term, q, qd, speed)
        tau = [t + float(w) * torque for t, w in zip(tau, weights, strict=True)]
    return tau


def _column(model: DynamicModel, tree: Tree, term: TermColumn, q: list[Expr], qd: list[Expr], speed: float) -> Expr:
    """Regressor column of a term, with the sign of a velocity smoothed."""
    graph, weights = q[0].graph, tree.of_term(term)
    x, v = combined(weights, q) + term.offset, combined(weights, qd)
    if term.kind == "viscous":
        return v
    if term.kind == "offset":
        return graph.number(1.0)
    if term.kind == "spring":
        return x - term.settings[0]
    if term.kind in DRY:
        return _dry(term, graph, v, speed)
    if isinstance(term.shape, Warming):
        return graph.number(0.0)  # the code is for a warm device
    if isinstance(term.shape, Presliding):
        return _sliding(term.shape, graph, v, speed)
    joints = [combined(link.rate, q) + link.joint_offset for link in tree.links]
    if isinstance(term.shape, Counterbalance):
        return _strut(term.shape, graph, joints[term.shape.joint])
    if isinstance(term.shape, LoadDependentFriction):
        raise _unexportable_term(term.name, "load-dependent friction depends on accelerations")
    assert isinstance(term.shape, CustomColumn)  # the last kind
    rates = [combined(link.rate, qd) for link in tree.links]
    return _written(model, term, term.shape, joints, rates)


def _dry(term: TermColumn, graph: Graph, v: Expr, speed: float) -> Expr:
    """Dry friction tanh(v / width), of one sign of the velocity or of both, times the Stribeck factor if it has one."""
    width = max(term.constant("width"), speed)
    side = {"coulomb+": "above", "coulomb-": "below"}.get(term.kind)
    moving = graph.apply(side, v) if side else v
    sign = graph.apply("tanh", moving * (1.0 / width))
    if term.kind != "stribeck":
        return sign
    velocity, exponent, _ = term.settings
    slow = graph.power(graph.apply("fabs", v) * (1.0 / velocity), graph.number(exponent))
    return sign * graph.apply("exp", -slow)


def _sliding(shape: Presliding, graph: Graph, v: Expr, speed: float) -> Expr:
    """Friction with presliding as it is in steady sliding: code without states has no history."""
    sign = graph.apply("tanh", v * (1.0 / max(shape.width, speed)))
    if shape.law != "lugre":
        return sign
    slow = v * (1.0 / shape.velocity)
    return sign * (1.0 + (shape.breakaway - 1.0) * graph.apply("exp", -(slow * slow)))


def _strut(strut: Counterbalance, graph: Graph, q: Expr) -> Expr:
    """Torque of a counterbalance per unit of its parameter."""
    delta = q + strut.angle
    product = strut.base * strut.crank
    squared = strut.base**2 + strut.crank**2 - 2 * product * graph.apply("cos", delta)
    length = graph.apply("sqrt", squared)
    longer = length - abs(strut.base - strut.crank)
    lever = (strut.sign * product) * graph.apply("sin", delta) / length
    if strut.force == "linear":
        return lever * longer
    return lever / (1.0 - longer * (1.0 / strut.stroke)) if strut.force == "gas" else lever


def _written(
    model: DynamicModel, term: TermColumn, column: CustomColumn, joints: list[Expr], rates: list[Expr]
) -> Expr:
    """A custom column of the device file."""
    if column.reads({f"a_{name}" for name in model.device.joint_names}):
        raise _unexportable_term(term.name, f"its expression {column.text} depends on accelerations")
    graph = joints[0].graph
    values: dict[str, Expr] = {name: graph.number(value) for name, value in column.constants.items()}
    values["pi"] = graph.number(np.pi)
    for name, position, rate in zip(model.device.joint_names, joints, rates, strict=True):
        values[f"q_{name}"], values[f"v_{name}"] = position, rate
    return _expression(graph, column.tree, values)


def _expression(graph: Graph, node: ast.expr, values: Mapping[str, Expr]) -> Expr:
    """A checked Python expression as a graph expression, node by node."""
    match node:
        case ast.Constant(value=value):
            return graph.number(float(value))  # type: ignore[arg-type]
        case ast.Name(id=name):
            return values[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_expression(graph, operand, values)
        case ast.UnaryOp(operand=operand):
            return _expression(graph, operand, values)
        case ast.Call(func=ast.Name(id=name), args=[argument]):
            return graph.apply("fabs" if name == "abs" else name, _expression(graph, argument, values))
        case ast.BinOp(left=left, op=op, right=right):
            a, b = _expression(graph, left, values), _expression(graph, right, values)
            match op:
                case ast.Add():
                    return a + b
                case ast.Sub():
                    return a - b
                case ast.Mult():
                    return a * b
                case ast.Div():
                    return a / b
            return graph.power(a, b)
    raise TypeError(f"{ast.dump(node)} was not checked")


def _unexportable_term(name: str, why: str) -> ExportError:
    return ExportError(
        f"term {name} cannot be written as code: {why}.",
        where=name,
        advice=(
            "Write it with positions and velocities only, or leave it out of the device file and add its torque in "
            "the control loop."
        ),
    )
