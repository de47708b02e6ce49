"""Expressions in device files: parsed, checked node by node, and evaluated without `eval`."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceFileError

# Longest expression, characters: enough for any column, and too short to exhaust the stack.
_LONGEST = 400
# Largest number in an expression, SI: beyond any device, far from overflow.
_LARGEST = 1e12

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "sign": np.sign,
}
# In numbers of the geometry; those with two arguments apart.
GEOMETRY: Mapping[str, Callable[..., Any]] = {
    **{name: FUNCTIONS[name] for name in ("sin", "cos", "tan", "sqrt", "abs")},
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "hypot": np.hypot,
}
_OF_TWO = ("atan2", "hypot")
RESERVED = ("pi", *dict.fromkeys((*FUNCTIONS, *GEOMETRY)))
OPERATORS: Mapping[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_ARITHMETIC = (
    'Use numbers, pi, named lengths, + - * / ** and brackets, as in "-pi/2" or "d3 + 0.1", and '
    + ", ".join(GEOMETRY)
    + "."
)
COLUMN = "Use q_, v_, a_ followed by a joint's name, pi, named lengths, + - * / ** and " + ", ".join(FUNCTIONS) + "."
_LINEAR = 'Write a sum such as "q3 = pi/2 - q2 + q7", each q with a constant factor.'
TARGET = 'Write a sum such as "L1*MX2 + g*(M2 + M3)", each parameter with a constant factor.'


@dataclass(frozen=True)
class Linear:
    """A linear expression: constant + sum of factor * symbol."""

    constant: float
    factors: Mapping[str, float] = field(default_factory=dict)

    def plus(self, other: Linear, sign: float = 1.0) -> Linear:
        """The sum, or with sign -1 the difference."""
        factors = dict(self.factors)
        for name, factor in other.factors.items():
            factors[name] = factors.get(name, 0.0) + sign * factor
        return Linear(self.constant + sign * other.constant, factors)

    def times(self, number: float) -> Linear:
        """Every factor and the constant times a number."""
        return Linear(self.constant * number, {name: factor * number for name, factor in self.factors.items()})


@dataclass(frozen=True)
class CustomColumn:
    """An expression for a regressor column, over the joints' motion.

    Attributes:
        text: as written.
        tree: as parsed; it holds only names, numbers, arithmetic and FUNCTIONS.
        constants: values of named lengths and constants, SI.
        nature: the kind of term that it is part of, such as "viscous"; empty for a custom term.
        side: 1 or -1 if it acts at positive, or negative, velocities only; else 0.
    """

    text: str
    tree: ast.expr = field(repr=False, compare=False)
    constants: Mapping[str, float] = field(repr=False, default_factory=dict)
    nature: str = ""
    side: int = 0

    def values(self, motion: Mapping[str, Array], samples: int) -> Array:
        """The column, (samples,), from q_<joint>, v_<joint> and a_<joint>, each (samples,)."""
        with np.errstate(all="ignore"):
            made = _evaluate(self.tree, {**self.constants, "pi": math.pi, **motion})
        return np.broadcast_to(np.asarray(made, dtype=float), (samples,))

    def reads(self, names: set[str]) -> bool:
        """Whether it uses one of these names."""
        return any(isinstance(node, ast.Name) and node.id in names for node in ast.walk(self.tree))


def number(value: float | str, lengths: Mapping[str, float], place: Place) -> float:
    """The value of a number of the file, or of arithmetic and functions over pi and named lengths.

    Raises:
        DeviceFileError: the text is not such arithmetic, uses another name, or its value is beyond LARGEST.
    """
    if isinstance(value, str):
        tree = _parse(value, place, _ARITHMETIC)
        known = {**lengths, "pi": math.pi}
        _Rules(value, frozenset(known), place, _ARITHMETIC, GEOMETRY).check(tree)
        with np.errstate(all="ignore"):
            made = float(_evaluate(tree, known))
    else:
        made = float(value)
    if not abs(made) <= _LARGEST:  # nan is not
        found = f"its value is {made:g}, limit {_LARGEST:.0e}"
        raise _unreadable(place, str(value), found, "Write a finite number, in SI units.")
    return made


def column(text: str, joints: list[str], lengths: Mapping[str, float], place: Place) -> CustomColumn:
    """A column expression, checked to use only known names.

    Raises:
        DeviceFileError: the text is not such arithmetic, or uses a name that is neither a joint's motion nor a length.
    """
    tree = _parse(text, place, COLUMN)
    motion = {f"{letter}_{joint}" for joint in joints for letter in "qva"}
    _Rules(text, frozenset({*lengths, *motion, "pi"}), place, COLUMN, FUNCTIONS).check(tree)
    return CustomColumn(text, tree, dict(lengths))


def relation(text: str, symbols: list[str], lengths: Mapping[str, float], place: Place) -> tuple[str, Linear]:
    """The joint symbol on the left of a linear relation, and what it equals.

    Raises:
        DeviceFileError: it is not one symbol, an equals sign and a linear sum of joints' symbols and lengths.
    """
    left, equals, right = text.partition("=")
    if not equals or "=" in right or not left.strip().isidentifier():
        raise place.error(f'"{text}" is not one joint symbol, an equals sign and a sum', _LINEAR)
    if left.strip() not in symbols:
        raise place.unknown("joint symbol", left.strip(), symbols)
    tree = _parse(right.strip(), place, _LINEAR)
    known = {**lengths, "pi": math.pi}
    _Rules(text, frozenset({*known, *symbols}), place, _LINEAR).check(tree)
    try:
        made = _linear(tree, known)
    except (ZeroDivisionError, OverflowError, _NotLinearError) as error:
        raise place.error(f'"{text}" is not linear: {error}', _LINEAR) from None
    if not all(math.isfinite(x) for x in (made.constant, *made.factors.values())):
        raise place.error(f'"{text}" has a factor that is not finite', _LINEAR)
    return left.strip(), made


def combination(text: str, symbols: Collection[str], constants: Mapping[str, float], place: Place) -> dict[str, float]:
    """Factors of the parameters in a linear combination of them, without zeros.

    Raises:
        DeviceFileError: the text is not arithmetic, uses a name that is neither a parameter nor a constant, multiplies
            parameters, divides by one, or has a part without one.
    """
    tree = _parse(text, place, TARGET)
    known = {**constants, "pi": math.pi}
    _Rules(text, frozenset({*known, *symbols}), place, TARGET).check(tree)
    try:
        made = _linear(tree, known)
    except (ZeroDivisionError, OverflowError, _NotLinearError) as error:
        raise _not_a_combination(place, text, str(error)) from None
    if not all(abs(x) <= _LARGEST for x in (made.constant, *made.factors.values())):
        raise _not_a_combination(place, text, f"it has a factor beyond {_LARGEST:.0e}")
    if made.constant:
        raise _not_a_combination(place, text, f"its part {made.constant:g} has no parameter in it")
    return {name: factor for name, factor in made.factors.items() if factor}


def sum_of_names(text: str, names: Collection[str]) -> Linear | None:
    """A checked number of the file as a linear expression of these names, None if it is not linear in them."""
    try:
        made = _linear(ast.parse(text.strip(), mode="eval").body, {"pi": math.pi})
    except (ZeroDivisionError, OverflowError, _NotLinearError):
        return None
    return made if set(made.factors) <= set(names) else None


class _NotLinearError(ValueError):
    """A product of symbols, or a division by one."""


def _parse(text: str, place: Place, instead: str) -> ast.expr:
    if len(text) > _LONGEST:
        raise _unreadable(place, text[:40] + "...", f"it has {len(text)} characters, limit {_LONGEST}", instead)
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _unreadable(place, text, "it is not arithmetic", instead) from None


def _unreadable(place: Place, text: str, found: str, advice: str) -> DeviceFileError:
    return place.error(f'cannot read "{text}": {found}', advice)


def _not_a_combination(place: Place, text: str, found: str) -> DeviceFileError:
    return place.error(f'"{text}" is not a linear combination of parameters: {found}', TARGET)


@dataclass(frozen=True)
class _Rules:
    """What one kind of expression may contain, and the advice of its errors."""

    text: str
    known: frozenset[str]
    place: Place
    instead: str
    functions: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    def refuse(self, node: ast.expr, why: str) -> DeviceFileError:
        """The error about one part of the expression."""
        return _unreadable(self.place, self.text, f"`{ast.unparse(node)}` {why}", self.instead)

    def check(self, node: ast.expr) -> None:
        """Raise DeviceFileError unless `_evaluate` handles every node and every name is known."""
        match node:
            case ast.Constant(value=value) if type(value) in (int, float):
                if abs(value) > _LARGEST:  # type: ignore[arg-type]
                    raise self.refuse(node, f"is beyond {_LARGEST:.0e}")
            case ast.Name(id=name):
                if name in self.functions:
                    raise self.refuse(node, f"is a function, without an argument: write {name}(...)")
                if name not in self.known:
                    raise self.place.unknown("number", name, sorted({*self.known, *self.functions}))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
                self.check(operand)
            case ast.BinOp(left=left, op=op, right=right) if self.allows(op):
                self.check(left)
                self.check(right)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if self.functions:
                if name not in self.functions:
                    raise self.place.unknown("function", name, self.functions)
                if len(arguments) != (wanted := 1 + (name in _OF_TWO)):
                    raise self.refuse(node, f"has {len(arguments)} arguments, {wanted} required")
                for argument in arguments:
                    self.check(argument)
            case _:
                raise self.refuse(node, "is not allowed here")

    def allows(self, op: ast.operator) -> bool:
        """Whether this kind of expression may contain an operator."""
        return type(op) in OPERATORS and (bool(self.functions) or not isinstance(op, ast.Pow))


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    """The value of a checked expression in NumPy's arithmetic, where 1/0 is infinite."""
    return _function(node)(values)


@lru_cache(maxsize=4096)
def _function(node: ast.expr) -> Callable[[Mapping[str, Any]], Any]:
    """A checked expression as a function of its names: the bench evaluates one in every step."""
    match node:
        case ast.Constant(value=value):
            constant = np.float64(value)  # type: ignore[arg-type]
            return lambda _: constant
        case ast.Name(id=name):
            return lambda values: np.asarray(values[name], dtype=float)[()]
        case ast.UnaryOp(op=op, operand=operand):
            of = _function(operand)
            return (lambda values: -of(values)) if isinstance(op, ast.USub) else of
        case ast.BinOp(left=left, op=op, right=right):
            first, second, both = _function(left), _function(right), OPERATORS[type(op)]
            return lambda values: both(first(values), second(values))
        case ast.Call(func=ast.Name(id=name), args=arguments):
            call, inner = {**FUNCTIONS, **GEOMETRY}[name], [_function(argument) for argument in arguments]
            return lambda values: call(*(one(values) for one in inner))
    raise TypeError(f"{ast.dump(node)} was not checked")


def _linear(node: ast.expr, constants: Mapping[str, float]) -> Linear:
    match node:
        case ast.Constant(value=value):
            return Linear(float(value))  # type: ignore[arg-type]
        case ast.Name(id=name):
            return Linear(constants[name]) if name in constants else Linear(0.0, {name: 1.0})
        case ast.UnaryOp(op=op, operand=operand):
            return _linear(operand, constants).times(-1.0 if isinstance(op, ast.USub) else 1.0)
        case ast.BinOp(left=left, op=op, right=right):
            return _combined(_linear(left, constants), op, _linear(right, constants))
        case ast.Call():
            raise _NotLinearError("it has a function")
    raise TypeError(f"{ast.dump(node)} was not checked")


def _combined(left: Linear, op: ast.operator, right: Linear) -> Linear:
    match op:
        case ast.Add():
            return left.plus(right)
        case ast.Sub():
            return left.plus(right, -1.0)
        case ast.Mult() if not right.factors:
            return left.times(right.constant)
        case ast.Mult() if not left.factors:
            return right.times(left.constant)
        case ast.Div() if not right.factors:
            return left.times(1.0 / right.constant)
    raise _NotLinearError("it multiplies two unknowns, or divides by one")
