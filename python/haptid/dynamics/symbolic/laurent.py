"""Laurent polynomials with rational coefficients in named symbols, and their ratios: what lengths and groupings are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np

from haptid.dynamics.symbolic.residues import Field, Residues

# Symbols with their exponents, none of them zero, in the order of their names: d3^2/d4 is (("d3", 2), ("d4", -1)).
Powers = tuple[tuple[str, int], ...]


def powers(exponents: Iterable[tuple[str, int]]) -> Powers:
    """The product of symbols to their exponents, each named once or more."""
    total: dict[str, int] = {}
    for name, exponent in exponents:
        total[name] = total.get(name, 0) + exponent
    return tuple(sorted((name, exponent) for name, exponent in total.items() if exponent))


@dataclass(frozen=True)
class Laurent:
    """A sum of products of symbols, each with a rational coefficient and whole exponents of either sign.

    Attributes:
        terms: exponents and coefficient of every term, none of them zero, in one order.
    """

    terms: tuple[tuple[Powers, Fraction], ...] = ()

    @staticmethod
    def of(terms: Iterable[tuple[Powers, Fraction]]) -> Laurent:
        """From terms in any order, like ones added."""
        total: dict[Powers, Fraction] = {}
        for exponents, coefficient in terms:
            total[exponents] = total.get(exponents, Fraction(0)) + coefficient
        return Laurent(tuple(sorted((e, c) for e, c in total.items() if c)))

    @staticmethod
    def number(value: Fraction | int) -> Laurent:
        """A constant."""
        return Laurent.of([((), Fraction(value))])

    @staticmethod
    def symbol(name: str, exponent: int = 1) -> Laurent:
        """A symbol, or one over it."""
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
        """Names in it."""
        return tuple(sorted({name for exponents, _ in self.terms for name, _ in exponents}))

    @property
    def is_number(self) -> bool:
        """Whether no symbol is in it."""
        return not self.symbols

    def modulo(self, field: Field, values: Mapping[str, Residues], count: int) -> Residues:
        """Its residues, (count,), from those of its symbols, each (count,)."""
        made = np.zeros(count, dtype=np.int64)
        for exponents, coefficient in self.terms:
            term = np.full(count, field.of(coefficient))
            for name, exponent in exponents:
                term = term * field.power(values[name], exponent) % field.prime
            made = (made + term) % field.prime
        return made

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
    """How much of one parameter is in another: a Laurent polynomial, or a ratio of two polynomials."""

    numerator: Laurent
    denominator: Laurent = ONE

    @property
    def is_ratio(self) -> bool:
        """Whether the denominator is more than one."""
        return self.denominator != ONE

    @property
    def symbols(self) -> tuple[str, ...]:
        """Names in it."""
        return tuple(sorted({*self.numerator.symbols, *self.denominator.symbols}))

    def modulo(self, field: Field, values: Mapping[str, Residues], count: int) -> Residues:
        """Its residues, (count,), from those of its symbols, each (count,)."""
        above = self.numerator.modulo(field, values, count)
        if not self.is_ratio:
            return above
        return above * field.inverse(self.denominator.modulo(field, values, count)) % field.prime

    def value(self, values: Mapping[str, float]) -> float:
        """Its value from those of its symbols."""
        return self.numerator.value(values) / self.denominator.value(values)
