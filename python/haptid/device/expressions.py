"""Expressions in device files: parsed, checked node by node, and evaluated without `eval`."""

from __future__ import annotations

import ast
import math
import operator
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.toml.errors_at import Place
from haptid.errors import DeviceFileError

# Longest expression, characters: enough for any column, and too short to exhaust the stack.
_LONGEST = 400
# Largest number in an expression, SI: beyond any device, far from overflow.
_LARGEST = 1e12
# Highest degree of a polynomial, and most terms of one.
_HIGHEST, _MOST_TERMS = 12, 500

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
_RELATION = 'Write a sum such as "q3 = pi/2 - q2 + q7", or a polynomial such as "q3 = 0.8*q2 + 0.1*q2**2".'
TARGET = 'Write a sum such as "L1*MX2 + g*(M2 + M3)", each parameter with a constant factor.'


@dataclass(frozen=True)
class Linear:
    """A linear expression: constant + sum of factor * symbol."""

    constant: float
    factors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class JointPolynomial:
    """A polynomial in symbols: factor by the symbols of each product, sorted; `("q1", "q1")` is q1 squared."""

    terms: Mapping[tuple[str, ...], float]

    def plus(self, other: JointPolynomial, sign: float = 1.0) -> JointPolynomial:
        """The sum, or with sign -1 the difference."""
        made = dict(self.terms)
        for product, factor in other.terms.items():
            made[product] = made.get(product, 0.0) + sign * factor
        return JointPolynomial({product: factor for product, factor in made.items() if factor or not product})

    def times(self, other: JointPolynomial) -> JointPolynomial:
        """The product.

        Raises:
            OverflowError: its degree or its number of terms is beyond the limits.
        """
        made: defaultdict[tuple[str, ...], float] = defaultdict(float)
        for one, factor in self.terms.items():
            for two, more in other.terms.items():
                made[tuple(sorted(one + two))] += factor * more
        if max(map(len, made), default=0) > _HIGHEST or len(made) > _MOST_TERMS:
            raise OverflowError(f"its degree is above {_HIGHEST}, or it has more than {_MOST_TERMS} terms")
        return JointPolynomial(dict(made))

    def replaced(self, by: Mapping[str, JointPolynomial]) -> JointPolynomial:
        """With other polynomials in place of symbols."""
        made = JointPolynomial({})
        for product, factor in self.terms.items():
            term = JointPolynomial({(): factor})
            for symbol in product:
                term = term.times(by.get(symbol, JointPolynomial({(symbol,): 1.0})))
            made = made.plus(term)
        return made

    def slope(self, symbol: str) -> JointPolynomial:
        """The derivative by a symbol."""
        made: defaultdict[tuple[str, ...], float] = defaultdict(float)
        for product, factor in self.terms.items():
            if symbol in product:
                k = product.index(symbol)
                made[product[:k] + product[k + 1 :]] += factor * product.count(symbol)
        return JointPolynomial(dict(made))

    def value(self, at: Mapping[str, Any]) -> Any:
        """Its value at numbers, arrays or expressions for the symbols; a float if it is constant."""
        made: Any = 0.0
        for product, factor in self.terms.items():
            term: Any = factor
            for symbol in product:
                term = at[symbol] * term
            made = term + made
        return made

    @property
    def symbols(self) -> frozenset[str]:
        return frozenset(symbol for product in self.terms for symbol in product)

    @property
    def linear(self) -> Linear | None:
        """The same as a linear expression; None if it is of higher degree."""
        if any(len(product) > 1 for product in self.terms):
            return None
        return Linear(self.terms.get((), 0.0), {product[0]: x for product, x in self.terms.items() if product})


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

    def at(self, state: Mapping[str, float]) -> float:
        """The column at one instant, from q_<joint>, v_<joint> and a_<joint>."""
        return float(_evaluate(self.tree, {**self.constants, "pi": math.pi, **state}))

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


def relation(text: str, symbols: list[str], lengths: Mapping[str, float], place: Place) -> tuple[str, JointPolynomial]:
    """The joint symbol on the left of a relation, and what it equals.

    Raises:
        DeviceFileError: it is not one symbol, an equals sign and a polynomial in joints' symbols and lengths.
    """
    left, equals, right = text.partition("=")
    if not equals or "=" in right or not left.strip().isidentifier():
        raise place.error(f'"{text}" is not one joint symbol, an equals sign and a sum', _RELATION)
    if left.strip() not in symbols:
        raise place.unknown("joint symbol", left.strip(), symbols)
    tree = _parse(right.strip(), place, _RELATION)
    known = {**lengths, "pi": math.pi}
    _Rules(text, frozenset({*known, *symbols}), place, _RELATION, powers=True).check(tree)
    try:
        made = _polynomial(tree, known)
    except (ZeroDivisionError, OverflowError, _NoPolynomialError) as error:
        raise place.error(f'"{text}" is no polynomial: {error}', _RELATION) from None
    if not all(math.isfinite(x) for x in made.terms.values()):
        raise place.error(f'"{text}" has a factor that is not finite', _RELATION)
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
    except (ZeroDivisionError, OverflowError, _NoPolynomialError) as error:
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
    except (ZeroDivisionError, OverflowError, _NoPolynomialError):
        return None
    return made if set(made.factors) <= set(names) else None


class _NoPolynomialError(ValueError):
    """A division by a symbol, a power that is no small integer, or a product of symbols where none may be."""


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
    powers: bool = False

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
        return type(op) in OPERATORS and (bool(self.functions) or self.powers or not isinstance(op, ast.Pow))


# Functions of checked expressions, for as long as a device has these.
_FUNCTIONS: WeakKeyDictionary[ast.expr, Callable[[Mapping[str, Any]], Any]] = WeakKeyDictionary()


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    """The value of a checked expression in NumPy's arithmetic, where 1/0 is infinite."""
    function = _FUNCTIONS.get(node)
    if function is None:  # the bench evaluates one in every step
        function = _FUNCTIONS[node] = _function(node)
    return function(values)


def _function(node: ast.expr) -> Callable[[Mapping[str, Any]], Any]:
    """A checked expression as a function of its names."""
    match node:
        case ast.Constant(value=value):
            constant = np.float64(value)  # type: ignore[arg-type]
            return lambda _: constant
        case ast.Name(id=name):
            return lambda values: _numpys(values[name])
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


def _numpys(value: Any) -> Any:
    """An array as it is, a number as NumPy's."""
    return value if isinstance(value, np.ndarray) else np.float64(value)


def _linear(node: ast.expr, constants: Mapping[str, float]) -> Linear:
    try:
        made = _polynomial(node, constants).linear
    except (_NoPolynomialError, OverflowError):
        made = None
    if made is None:
        raise _NoPolynomialError("it multiplies two unknowns, or divides by one")
    return made


def _polynomial(node: ast.expr, constants: Mapping[str, float]) -> JointPolynomial:
    match node:
        case ast.Constant(value=value):
            return JointPolynomial({(): float(value)})  # type: ignore[arg-type]
        case ast.Name(id=name):
            return JointPolynomial({(): constants[name]} if name in constants else {(name,): 1.0})
        case ast.UnaryOp(op=op, operand=operand):
            sign = JointPolynomial({(): -1.0 if isinstance(op, ast.USub) else 1.0})
            return _polynomial(operand, constants).times(sign)
        case ast.BinOp(left=left, op=op, right=right):
            return _combined(_polynomial(left, constants), op, _polynomial(right, constants))
        case ast.Call():
            raise _NoPolynomialError("it has a function")
    raise TypeError(f"{ast.dump(node)} was not checked")


def _combined(left: JointPolynomial, op: ast.operator, right: JointPolynomial) -> JointPolynomial:
    number = None if right.symbols else right.terms.get((), 0.0)
    match op:
        case ast.Add():
            return left.plus(right)
        case ast.Sub():
            return left.plus(right, -1.0)
        case ast.Mult():
            return left.times(right)
        case ast.Div() if number is not None:
            return left.times(JointPolynomial({(): 1.0 / number}))
        case ast.Pow() if number is not None and number in range(_HIGHEST + 1):
            made = JointPolynomial({(): 1.0})
            for _ in range(int(number)):
                made = made.times(left)
            return made
    raise _NoPolynomialError(f"it divides by an unknown, or has a power other than 0, 1, 2 up to {_HIGHEST}")
