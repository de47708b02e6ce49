"""Three-vectors of expressions, and constant vectors and matrices that act on them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.export.expressions.graph import Expr, Graph

Vector = tuple[Expr, Expr, Expr]
# Sine and cosine of an angle.
Turn = tuple[Expr, Expr]
# Tolerance for rounding geometry to multiples of one half: cosines of right angles and of 60 degrees.
NEAR = 1e-12


def snapped(array: Array) -> Array:
    """Numbers rounded to multiples of one half within NEAR: removes the rounding errors of sines and cosines."""
    near = np.round(2 * array) / 2
    return np.asarray(np.where(np.abs(array - near) < NEAR, near, array))


def zero(graph: Graph) -> Vector:
    """The zero vector."""
    none = graph.number(0.0)
    return (none, none, none)


def constant_vector(graph: Graph, values: Iterable[float]) -> Vector:
    """A vector of numbers."""
    x, y, z = (graph.number(value) for value in values)
    return (x, y, z)


def vector(values: Sequence[Expr]) -> Vector:
    """A vector of three expressions."""
    x, y, z = values
    return (x, y, z)


def plus(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Sequence[Expr], b: Sequence[Expr]) -> Expr:
    """a . b."""
    made = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        made = made + x * y
    return made


def rotated(matrix: Array, v: Vector) -> Vector:
    """A constant matrix times a vector."""
    x, y, z = (combined(row, v) for row in matrix)
    return (x, y, z)


def combined(weights: Iterable[float], values: Sequence[Expr]) -> Expr:
    """Linear combination with constant weights."""
    made = values[0].graph.number(0.0)
    for weight, value in zip(weights, values, strict=True):
        made = made + float(weight) * value
    return made


def forth(turn: Turn, v: Vector) -> Vector:
    """Rz v: from a frame rotated about z to the fixed one."""
    s, c = turn
    return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def back(turn: Turn, v: Vector) -> Vector:
    """Rz' v: from the fixed frame to one rotated about z."""
    s, c = turn
    return (c * v[0] + s * v[1], c * v[1] - s * v[0], v[2])
