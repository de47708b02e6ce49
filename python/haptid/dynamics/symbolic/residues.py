"""Arithmetic modulo a prime on whole arrays: no rounding, and no number ever grows.

Residues are int64 from 0 to p - 1. Primes are below 2^30, so that a product is below 2^60 and eight of them add up
below 2^63; a product of matrices with a longer inner side is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import prod

import numpy as np
from numpy.typing import NDArray

Residues = NDArray[np.int64]

# All are 3 modulo 4, so that a square root is one power. Two find the coefficients, the third checks them.
PRIMES = (1073741783, 1073741723, 1073741719)
# Longest inner side of a product of matrices of residues that cannot overflow.
LONGEST_SUM = 8
# From here on, thirty squarings of a whole array are faster than inverting its residues one by one.
MANY = 200


class UnluckyDrawError(Exception):
    """Numbers drawn at random that hit a zero of what must not vanish: draw others. Never leaves this package."""


@dataclass(frozen=True)
class Field:
    """The integers modulo a prime."""

    prime: int

    def __post_init__(self) -> None:
        if not (2 < self.prime < 2**30 and self.prime % 4 == 3):
            raise ValueError(f"prime {self.prime} is not below 2^30 and 3 modulo 4")

    def draw(self, rng: np.random.Generator, *shape: int) -> Residues:
        """Residues drawn at random, zero and one left out."""
        return rng.integers(2, self.prime, shape, dtype=np.int64)

    def reduce(self, x: Residues) -> Residues:
        """The residues of any int64."""
        return np.asarray(x % self.prime)

    def _remainder(self, x: Residues) -> Residues:
        """The residues of int64 that are not negative: unsigned quotients are twice as fast as signed remainders."""
        whole, p = x.view(np.uint64), np.uint64(self.prime)
        return (whole - whole // p * p).view(np.int64)

    def of(self, number: Fraction | int) -> int:
        """The residue of a rational number."""
        exact = Fraction(number)
        return exact.numerator * pow(exact.denominator, -1, self.prime) % self.prime

    def product(self, a: Residues, b: Residues) -> Residues:
        """Products of matrices, (..., i, j) and (..., j, k)."""
        if a.shape[-1] > LONGEST_SUM:
            raise ValueError(f"a sum of {a.shape[-1]} products could overflow, limit {LONGEST_SUM}")
        return self.reduce(np.matmul(a, b))

    def power(self, x: Residues, exponent: int) -> Residues:
        """Every residue to one power, by repeated squaring; a negative power needs residues other than zero."""
        if exponent < 0:
            return self.inverse(self.power(x, -exponent))
        made = np.ones_like(x)
        while exponent:
            if exponent & 1:
                made = made * x % self.prime
            x = x * x % self.prime
            exponent >>= 1
        return made

    def inverse(self, x: Residues) -> Residues:
        """One over every residue.

        Raises:
            UnluckyDrawError: one of them is zero.
        """
        if not x.all():
            raise UnluckyDrawError
        if x.size > MANY:
            return self.power(x, self.prime - 2)  # Fermat's little theorem
        each = [pow(residue, -1, self.prime) for residue in x.ravel().tolist()]
        return np.array(each, dtype=np.int64).reshape(x.shape)

    def root(self, x: Residues) -> tuple[Residues, np.ndarray]:
        """Square roots, and which of them are: half of all residues have none."""
        made = self.power(x, (self.prime + 1) // 4)
        return made, made * made % self.prime == x

    def circle(self, rng: np.random.Generator, *shape: int) -> tuple[Residues, Residues]:
        """Cosines and sines of angles drawn at random: (1 - t^2) / (1 + t^2) and 2 t / (1 + t^2)."""
        t = self.draw(rng, *shape)
        square = t * t % self.prime
        below = self.inverse((1 + square) % self.prime)  # never zero: -1 has no root where p = 3 modulo 4
        return (1 - square) % self.prime * below % self.prime, 2 * t % self.prime * below % self.prime

    def sum_of_angles(self, a: tuple[Residues, Residues], b: tuple[Residues, Residues]) -> tuple[Residues, Residues]:
        """Cosine and sine of a sum, from both of each."""
        (c, s), (d, t) = a, b
        return self.reduce(c * d - s * t), self.reduce(s * d + c * t)

    def multiple_of_angle(self, angle: tuple[Residues, Residues], times: int) -> tuple[Residues, Residues]:
        """Cosine and sine of an angle times a whole number, by repeated doubling."""
        c, s = angle if times >= 0 else (angle[0], self.reduce(-angle[1]))
        made = (np.ones_like(c), np.zeros_like(c))
        left = abs(times)
        while left:
            if left & 1:
                made = self.sum_of_angles(made, (c, s))
            c, s = self.sum_of_angles((c, s), (c, s))
            left >>= 1
        return made

    def echelon(self, matrices: Residues, candidates: int | None = None) -> tuple[Residues, list[int]]:
        """Reduced row echelon forms of matrices that share their pivots, (n, rows, columns).

        Args:
            matrices: (n, rows, columns).
            candidates: only the first so many columns may be pivots; all of them by default.

        Returns:
            the forms without their empty rows, (n, pivots, columns), and the pivots' columns.

        Raises:
            UnluckyDrawError: a column is a pivot of some of the matrices only.
        """
        W = self.reduce(matrices)
        each = np.arange(len(W))
        pivots: list[int] = []
        for j in range(W.shape[2] if candidates is None else candidates):
            top = len(pivots)
            if top == W.shape[1]:
                break
            filled = W[:, top:, j] != 0
            if not filled.any():
                continue
            if not filled.any(axis=1).all():
                raise UnluckyDrawError
            first = filled.argmax(axis=1) + top
            row = W[each, first]
            W[each, first] = W[:, top]
            row = row * self.inverse(row[:, j])[:, None] % self.prime
            factors = W[:, :, j].copy()
            factors[:, top] = 0
            W[:, top] = row
            W[:, :, j:] = self._remainder(W[:, :, j:] + (self.prime - factors)[:, :, None] * row[:, None, j:])
            pivots.append(j)
        return W[:, : len(pivots)], pivots


def rational(residues: tuple[int, ...], primes: tuple[int, ...]) -> Fraction | None:
    """The rational number of small height with these residues, None where there is none.

    The residues are first joined into one modulo the product of the primes (Chinese remainders), then taken apart by
    the Euclidean algorithm. Source: Wang (1981), ACM SYMSAC, p. 212.
    """
    whole = prod(primes)
    x = sum(r * (whole // p) * pow(whole // p, -1, p) for r, p in zip(residues, primes, strict=True)) % whole
    # Below the root of half the modulus the number is unique. A tenth of that: a residue of something else then passes
    # for one in a case of two hundred, and the check at another prime refuses it.
    bound = int((whole / 2) ** 0.5 / 10)
    a, b, u, v = whole, x, 0, 1
    while b > bound:
        quotient = a // b
        a, b, u, v = b, a - quotient * b, v, u - quotient * v
    return None if abs(v) > bound else Fraction(b, v)
