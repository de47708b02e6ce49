"""Exact arithmetic: residues modulo a prime on whole arrays, and Laurent polynomials with rational coefficients.

Residues are int64 from 0 to p - 1. Primes are below 2^30, so a product is below 2^60 and eight of them add up below
2^63; a matrix product with a longer inner dimension is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid import _core
from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

Residues = NDArray[np.int64]

# All are 3 modulo 4, so that a square root is one power. Two find the coefficients, the third checks them.
PRIMES = (1073741783, 1073741723, 1073741719)
# Largest numerator and denominator that are told from their residue modulo one prime.
_SMALL = 24
# Longest inner dimension of a matrix product of residues that cannot overflow.
LONGEST_SUM = 8
# Above this size, thirty squarings of a whole array are faster than inverting its residues one by one.
MANY = 64


class UnluckyDrawError(Exception):
    """A random draw hit a zero of what must not vanish: draw again. Never leaves this package."""


@dataclass(frozen=True)
class PrimeField:
    """The integers modulo a prime (a finite field)."""

    prime: int

    dtype = np.int64

    def __post_init__(self) -> None:
        if not (2 < self.prime < 2**30 and self.prime % 4 == 3):
            raise ValueError(f"prime {self.prime} is not below 2^30 and 3 modulo 4")

    def draw(self, rng: np.random.Generator, *shape: int) -> Residues:
        """Random residues, zero and one left out."""
        return rng.integers(2, self.prime, shape, dtype=np.int64)

    def reduce(self, x: Residues) -> Residues:
        """The residues of any int64 array."""
        return np.asarray(x % self.prime)

    def of(self, number: Fraction | int) -> int:
        """The residue of a rational number."""
        if number.denominator == 1:
            return number.numerator % self.prime
        return number.numerator * pow(number.denominator, -1, self.prime) % self.prime

    def product(self, a: Residues, b: Residues) -> Residues:
        """Matrix products, (..., i, j) and (..., j, k)."""
        if a.shape[-1] > LONGEST_SUM:
            raise ValueError(f"a sum of {a.shape[-1]} products could overflow, limit {LONGEST_SUM}")
        return self.reduce(np.matmul(a, b))

    def power(self, x: Residues, exponent: int) -> Residues:
        """Every residue to one power, by repeated squaring; a negative power requires nonzero residues."""
        if exponent < 0:
            return self.inverse(self.power(x, -exponent))
        if exponent == 1:
            return x
        result = np.ones_like(x)
        while exponent:
            if exponent & 1:
                result = result * x % self.prime
            x = x * x % self.prime
            exponent >>= 1
        return result

    def inverse(self, x: Residues) -> Residues:
        """Inverses of every residue.

        Raises:
            UnluckyDrawError: one of them is zero.
        """
        if not x.all():
            raise UnluckyDrawError
        if x.size > MANY:
            return self.power(x, self.prime - 2)  # Fermat's little theorem
        inverses = [pow(residue, -1, self.prime) for residue in x.ravel().tolist()]
        return np.array(inverses, dtype=np.int64).reshape(x.shape)

    def root(self, x: Residues) -> tuple[Residues, np.ndarray]:
        """Square roots, and whether each is one: half of all residues have none."""
        roots = self.power(x, (self.prime + 1) // 4)
        return roots, roots * roots % self.prime == x

    def circle(self, rng: np.random.Generator, *shape: int) -> tuple[Residues, Residues]:
        """Cosines and sines of random angles: (1 - t^2) / (1 + t^2) and 2 t / (1 + t^2)."""
        t = self.draw(rng, *shape)
        square = t * t % self.prime
        scale = self.inverse((1 + square) % self.prime)  # never zero: -1 has no root where p = 3 modulo 4
        return (1 - square) % self.prime * scale % self.prime, 2 * t % self.prime * scale % self.prime

    def sum_of_angles(self, a: tuple[Residues, Residues], b: tuple[Residues, Residues]) -> tuple[Residues, Residues]:
        """Cosine and sine of a sum, from both of each."""
        (c, s), (d, t) = a, b
        return self.reduce(c * d - s * t), self.reduce(s * d + c * t)

    def multiple_of_angle(self, angle: tuple[Residues, Residues], times: int) -> tuple[Residues, Residues]:
        """Cosine and sine of an integer multiple of an angle, by repeated doubling."""
        c, s = angle if times >= 0 else (angle[0], self.reduce(-angle[1]))
        total = (c, s) if times % 2 else (np.ones_like(c), np.zeros_like(c))
        times = abs(times) >> 1
        while times:
            c, s = self.sum_of_angles((c, s), (c, s))
            if times & 1:
                total = self.sum_of_angles(total, (c, s))
            times >>= 1
        return total

    def echelon(self, matrices: Residues, candidates: int | None = None) -> tuple[Residues, list[int]]:
        """Reduced row echelon forms of matrices with the same pivots, (n, rows, columns).

        Args:
            matrices: (n, rows, columns).
            candidates: only this many first columns may be pivots; all of them by default.

        Returns:
            the forms without their empty rows, (n, pivots, columns), and the pivots' columns.

        Raises:
            UnluckyDrawError: a column is a pivot of some of the matrices only.
        """
        columns = matrices.shape[2] if candidates is None else candidates
        echelon = _core.echelon(matrices, columns, self.prime)
        if echelon is None:
            raise UnluckyDrawError
        forms, pivots = echelon
        return forms[:, : len(pivots)], pivots


class Reals:
    """Floats in the place of a finite field: the same mechanism at lengths that are numbers.

    Checkers of types are told that it is a field of residues: what evaluates a mechanism uses these members only.
    """

    dtype = np.float64

    def reduce(self, x: Array) -> Array:
        """Themselves."""
        return x

    def of(self, number: Fraction | int) -> float:
        """The nearest float."""
        return float(number)

    def power(self, x: Array, exponent: int) -> Array:
        """Every number to one power."""
        return np.asarray(x**exponent)

    def draw(self, rng: np.random.Generator, *shape: int) -> Array:
        """Random numbers of either sign."""
        return rng.uniform(-1.0, 1.0, shape)


def rational(residues: tuple[int, ...], primes: tuple[int, ...]) -> Fraction | None:
    """Rational reconstruction: the rational number of small height with these residues, None where there is none.

    The residues are joined into one modulo the product of the primes (Chinese remainder theorem), then split by the
    Euclidean algorithm. Source: Wang (1981), ACM SYMSAC, p. 212.
    """
    modulus = prod(primes)
    x = sum(r * (modulus // p) * pow(modulus // p, -1, p) for r, p in zip(residues, primes, strict=True)) % modulus
    # Below the root of half the modulus the number is unique. With a tenth of that, an arbitrary residue is accepted in
    # one of two hundred cases, and the check at another prime rejects it. One prime is for small numbers: with this
    # bound it accepts one of a million.
    bound = int((modulus / 2) ** 0.5 / 10) if len(primes) > 1 else _SMALL
    a, b, u, v = modulus, x, 0, 1
    while b > bound:
        quotient = a // b
        a, b, u, v = b, a - quotient * b, v, u - quotient * v
    return None if abs(v) > bound else Fraction(b, v)


@dataclass(frozen=True, eq=False)
class Points:
    """Residues of all symbols at some sets of lengths, modulo one prime.

    Attributes:
        field: the prime field, or floats.
        values: by symbol, (count,) each.
        count: number of sets.
    """

    field: PrimeField
    values: Mapping[str, Residues]
    count: int

    def repeated(self, times: int) -> Points:
        """Every set several times."""
        values = {name: np.repeat(residues, times) for name, residues in self.values.items()}
        return Points(self.field, values, self.count * times)

    def at(self, chosen: np.ndarray) -> Points:
        """Some of the sets, by index."""
        return Points(self.field, {name: x[chosen] for name, x in self.values.items()}, len(chosen))


# Symbols with nonzero exponents, sorted by name: d3^2/d4 is (("d3", 2), ("d4", -1)).
Powers = tuple[tuple[str, int], ...]


def powers(exponents: Iterable[tuple[str, int]]) -> Powers:
    """The product of powers of symbols; a name may occur several times."""
    total: dict[str, int] = {}
    for name, exponent in exponents:
        total[name] = total.get(name, 0) + exponent
    return tuple(sorted((name, exponent) for name, exponent in total.items() if exponent))


@dataclass(frozen=True)
class Laurent:
    """A Laurent polynomial: a sum of monomials with rational coefficients and integer exponents of either sign.

    Attributes:
        terms: exponents and nonzero coefficient of every term, sorted.
    """

    terms: tuple[tuple[Powers, Fraction], ...] = ()

    @staticmethod
    def of(terms: Iterable[tuple[Powers, Fraction]]) -> Laurent:
        """From terms in any order; like terms are added."""
        total: dict[Powers, Fraction] = {}
        for exponents, coefficient in terms:
            total[exponents] = total[exponents] + coefficient if exponents in total else coefficient
        return Laurent(tuple(sorted((e, c) for e, c in total.items() if c)))

    @staticmethod
    def number(value: Fraction | int) -> Laurent:
        """A constant."""
        return Laurent((((), Fraction(value)),)) if value else Laurent()

    @staticmethod
    def symbol(name: str, exponent: int = 1) -> Laurent:
        """A symbol to an integer power."""
        return Laurent(((((name, exponent),), Fraction(1)),))

    def __add__(self, other: Laurent) -> Laurent:
        return Laurent.of((*self.terms, *other.terms))

    def __neg__(self) -> Laurent:
        return self.times(Fraction(-1))

    def __sub__(self, other: Laurent) -> Laurent:
        return self + -other

    def __mul__(self, other: Laurent) -> Laurent:
        return Laurent.of((powers((*e, *f)), c * d) for e, c in self.terms for f, d in other.terms)

    def times(self, number: Fraction) -> Laurent:
        """Every coefficient times a number."""
        return Laurent.of((exponents, coefficient * number) for exponents, coefficient in self.terms)

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """Names of its symbols."""
        return tuple(sorted({name for exponents, _ in self.terms for name, _ in exponents}))

    def modulo(self, points: Points) -> Residues:
        """Its residues, (count,)."""
        if len(self.terms) == 1 and len(self.terms[0][0]) == 1 and self.terms[0][0][0][1] == self.terms[0][1] == 1:
            return points.values[self.terms[0][0][0][0]]  # a symbol
        field = points.field
        total: Residues = np.zeros(points.count, dtype=field.dtype)
        for exponents, coefficient in self.terms:
            term: Any = field.of(coefficient)
            for name, exponent in exponents:
                term = field.reduce(term * field.power(points.values[name], exponent))
            total = total + term
        return field.reduce(total)

    def value(self, values: Mapping[str, float]) -> float:
        """Its value from those of its symbols."""
        total = 0.0
        for exponents, coefficient in self.terms:
            term = float(coefficient)
            for name, exponent in exponents:
                term *= values[name] ** exponent
            total += term
        return total


ZERO, ONE = Laurent(), Laurent.number(1)


@dataclass(frozen=True)
class Coefficient:
    """A regrouping coefficient: a Laurent polynomial, or a ratio of two polynomials."""

    numerator: Laurent
    denominator: Laurent = ONE

    @property
    def is_ratio(self) -> bool:
        """Whether the denominator differs from one."""
        return self.denominator != ONE

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names of its symbols."""
        return tuple(sorted({*self.numerator.symbols, *self.denominator.symbols}))

    def __add__(self, other: Coefficient) -> Coefficient:
        if self.denominator == other.denominator:
            return Coefficient(self.numerator + other.numerator, self.denominator)
        numerator = self.numerator * other.denominator + other.numerator * self.denominator
        return Coefficient(numerator, self.denominator * other.denominator)

    def __mul__(self, other: Coefficient) -> Coefficient:
        numerator = self.numerator * other.numerator
        if not (self.is_ratio or other.is_ratio):
            return Coefficient(numerator)
        return Coefficient(numerator, self.denominator * other.denominator)

    def modulo(self, points: Points) -> Residues:
        """Its residues, (count,)."""
        numerator = self.numerator.modulo(points)
        if not self.is_ratio:
            return numerator
        return numerator * points.field.inverse(self.denominator.modulo(points)) % points.field.prime

    def value(self, values: Mapping[str, float]) -> float:
        """Its value from those of its symbols."""
        return self.numerator.value(values) / self.denominator.value(values)
