"""Intervals of numbers, and functions of the C library on them with how they carry errors on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

# Errors of functions of the C library in single precision, units in the last place.
ULPS_OF_WAVES, ULPS = 1, 4


# Largest x tanh'(x), and -x exp(x) of x below zero.
_OF_TANH, _OF_EXP = 0.45, 0.37


class Interval(NamedTuple):
    """All numbers from low to high."""

    low: float
    high: float

    @property
    def size(self) -> float:
        """The largest magnitude in it."""
        return max(abs(self.low), abs(self.high))

    @property
    def least(self) -> float:
        """The smallest magnitude in it."""
        return 0.0 if self.low <= 0.0 <= self.high else min(abs(self.low), abs(self.high))

    def __neg__(self) -> Interval:
        return Interval(-self.high, -self.low)

    def __add__(self, other: Interval) -> Interval:  # type: ignore[override]
        return Interval(self.low + other.low, self.high + other.high)

    def __mul__(self, other: Interval) -> Interval:  # type: ignore[override]
        products = [a * b for a in self for b in other]
        return Interval(min(products), max(products))

    def square(self) -> Interval:
        """Of each number in it."""
        return Interval(self.least**2, self.size**2)


# Range, error without rounding, and rounding error in units in the last place.
Carried = tuple[Interval, float, int]
_NONE: Carried = (Interval(-math.inf, math.inf), math.inf, 0)


def through(op: str, ranges: Sequence[Interval], errors: Sequence[float], relative: float = math.inf) -> Carried:
    """A function, a quotient or a change of sign of operands with errors; an infinite error where none is known.

    Args:
        relative: error of the first operand over its value: saturated functions are not sensitive to large ones.
    """
    x, e = ranges[0], errors[0]
    low, high = x
    match op:
        case "negative":
            return -x, e, 0
        case "fabs":
            return Interval(x.least, x.size), e, 0
        case "above":
            return Interval(max(low, 0.0), max(high, 0.0)), e, 0
        case "below":
            return Interval(min(low, 0.0), min(high, 0.0)), e, 0
        case "sign" if x.least > e:
            return Interval(math.copysign(1.0, low), math.copysign(1.0, low)), 0.0, 0
        case "sin":
            return _sine(x), e, ULPS_OF_WAVES
        case "cos":
            return _sine(Interval(low + math.pi / 2, high + math.pi / 2)), e, ULPS_OF_WAVES
        case "tanh":
            return Interval(math.tanh(low), math.tanh(high)), min(e, _OF_TANH * relative), ULPS
        case "exp" if high + e < 80.0:
            most = math.exp(high + e) * e
            return Interval(math.exp(low), math.exp(high)), min(most, _OF_EXP * relative) if high <= 0 else most, ULPS
        case "sqrt" if low > e:
            return Interval(math.sqrt(low), math.sqrt(high)), e / (2.0 * math.sqrt(low - e)), ULPS
        case "tan" if x.size + e < math.pi / 2:
            made = Interval(math.tan(low), math.tan(high))
            return made, (1.0 + math.tan(x.size + e) ** 2) * e, ULPS
        case "pow":
            return _power(x, e, ranges[1], errors[1])
        case "/":
            return _quotient(ranges, errors)
    return _NONE


def _sine(x: Interval) -> Interval:
    """Range of the sine; it reaches 1 at pi/2 and -1 at -pi/2, in every turn."""
    ends = (math.sin(x.low), math.sin(x.high))
    high, low = (
        math.ceil((x.low - top) / (2 * math.pi)) * 2 * math.pi + top <= x.high for top in (math.pi / 2, -math.pi / 2)
    )
    return Interval(-1.0 if low else min(ends), 1.0 if high else max(ends))


def _power(x: Interval, e: float, n: Interval, of_n: float) -> Carried:
    """Of a number that is not negative, with a fixed exponent of one or more."""
    if x.low < 0.0 or n.low != n.high or n.low < 1.0 or x.high + e > 1e6:
        return _NONE
    p = n.low
    # Over 0 to x the derivative by the exponent, x^p ln x, is largest at its end or at exp(-1 / p).
    by_exponent = max((x.high + e) ** p * abs(math.log(max(x.high + e, 1e-300))), 1.0 / (math.e * p))
    made = Interval(x.low**p, x.high**p)
    return made, p * (x.high + e) ** (p - 1.0) * e + 1.001 * by_exponent * of_n, ULPS


def _quotient(ranges: Sequence[Interval], errors: Sequence[float]) -> Carried:
    (a, b), (of_a, of_b) = ranges, errors
    if b.least <= of_b:
        return _NONE
    made = a * Interval(1.0 / b.high, 1.0 / b.low)
    return made, (of_a + made.size * of_b) / (b.least - of_b), 1
