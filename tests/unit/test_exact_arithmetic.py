"""Residues, Laurent polynomials, and the way from the former to the latter."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptid.dynamics.symbolic.arithmetic import PRIMES, Coefficient, Laurent, PrimeField, UnluckyDrawError, rational
from haptid.dynamics.symbolic.interpolation import fit_coefficient
from haptid.dynamics.symbolic.symbols import DIMENSIONLESS, GRAVITY, LENGTH, Symbol, draw

FIELD = PrimeField(PRIMES[0])
RESIDUE = st.integers(1, PRIMES[0] - 1)
SMALL = st.fractions(-1000, 1000, max_denominator=1000)
LENGTHS = tuple(Symbol(name, 0.1, LENGTH) for name in ("a", "b", "c"))


def array(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int64)


@given(RESIDUE, RESIDUE)
def test_residues_form_a_field(x: int, y: int) -> None:
    (inverse,) = FIELD.inverse(array(x))
    assert int(inverse) * x % FIELD.prime == 1
    product = FIELD.product(array(x)[None], array(y)[:, None])
    assert int(product[0, 0] if product.ndim == 2 else product[0]) == x * y % FIELD.prime
    roots, found = FIELD.root(array(x * x % FIELD.prime))
    assert found.all()
    assert int(roots[0]) in (x, FIELD.prime - x)


@given(st.lists(RESIDUE, min_size=8, max_size=8), st.lists(RESIDUE, min_size=8, max_size=8))
def test_products_of_the_longest_rows_do_not_overflow(a: list[int], b: list[int]) -> None:
    made = FIELD.product(array(*a)[None], array(*b)[:, None])
    assert int(made[0, 0]) == sum(x * y for x, y in zip(a, b, strict=True)) % FIELD.prime


def test_longer_rows_and_unfit_primes_are_rejected() -> None:
    with pytest.raises(ValueError, match="overflow"):
        FIELD.product(np.zeros((1, 9), dtype=np.int64), np.zeros((9, 1), dtype=np.int64))
    with pytest.raises(ValueError, match="modulo 4"):
        PrimeField(2**31 - 1)
    with pytest.raises(UnluckyDrawError):
        FIELD.inverse(array(0))


@given(SMALL)
def test_a_small_rational_comes_back_from_its_residues(number: Fraction) -> None:
    residues = tuple(PrimeField(p).of(number) for p in PRIMES[:2])
    assert rational(residues, PRIMES[:2]) == number


def test_one_prime_tells_small_numbers_only() -> None:
    (prime,) = primes = PRIMES[:1]
    for number in (Fraction(0), Fraction(-3), Fraction(7, 12), Fraction(-24, 23)):
        assert rational((PrimeField(prime).of(number),), primes) == number
    for number in (Fraction(25), Fraction(1533, 2500), Fraction(1, 144)):
        assert rational((PrimeField(prime).of(number),), primes) is None


@given(st.integers(0, 2**32 - 1), st.integers(-50, 50), st.integers(-50, 50))
def test_angles_stay_on_the_circle_and_add(seed: int, k: int, m: int) -> None:
    p, angle = FIELD.prime, FIELD.circle(np.random.default_rng(seed), 3)
    c, s = FIELD.multiple_of_angle(angle, k)
    assert ((c * c + s * s) % p == 1).all()
    both = FIELD.sum_of_angles((c, s), FIELD.multiple_of_angle(angle, m))
    for got, wanted in zip(both, FIELD.multiple_of_angle(angle, k + m), strict=True):
        np.testing.assert_array_equal(got, wanted)


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 8))
def test_echelon_form_has_the_same_rows(seed: int, rank: int, columns: int) -> None:
    """Every row of a product of rank r is a combination of the form's rows, read off at its pivots."""
    rng = np.random.default_rng(seed)
    W = FIELD.product(FIELD.draw(rng, 1, 10, min(rank, columns)), FIELD.draw(rng, 1, min(rank, columns), columns))
    form, pivots = FIELD.echelon(W)
    assert len(pivots) == min(rank, columns)
    np.testing.assert_array_equal(form[0][:, pivots], np.eye(len(pivots)))
    np.testing.assert_array_equal(FIELD.product(W[:, :, pivots], form), W)


@given(st.lists(st.tuples(st.integers(-2, 3), st.integers(-2, 3), SMALL), max_size=4))
def test_laurent_polynomials_are_numbers_that_add_and_multiply(terms: list[tuple[int, int, Fraction]]) -> None:
    made = Laurent.of((tuple((n, e) for n, e in (("a", i), ("b", j)) if e), c) for i, j, c in terms)
    other = Laurent.symbol("a") - Laurent.number(Fraction(1, 3))
    values, at = draw(LENGTHS, FIELD, np.random.default_rng(1), 2), {"a": 0.7, "b": -1.3}
    assert (made * other).value(at) == pytest.approx(made.value(at) * other.value(at), abs=1e-9, rel=1e-9)
    product = made.modulo(values) * other.modulo(values) % FIELD.prime
    np.testing.assert_array_equal((made * other).modulo(values), product)
    assert (made - made) == Laurent()


def fitted(wanted: Coefficient, symbols: tuple[Symbol, ...], dimension: tuple[int, int], count: int = 48):
    points, y = [], []
    for prime in PRIMES[:2]:
        points.append(draw(symbols, PrimeField(prime), np.random.default_rng(prime), count))
        y.append(wanted.modulo(points[-1]))
    return fit_coefficient(points, y, symbols, dimension, {})


def laurent(*terms: tuple[int, str]) -> Laurent:
    """From coefficients and texts such as `a^2 b^-1`."""
    parts = ((c, [[*factor.split("^"), "1"][:2] for factor in text.split()]) for c, text in terms)
    return Laurent.of((tuple(sorted((n, int(e)) for n, e in powers)), Fraction(c)) for c, powers in parts)


@pytest.mark.parametrize(
    ("wanted", "symbols", "dimension"),
    [
        (Coefficient(laurent((1, "a^2"), (-3, "b c"))), LENGTHS, (2, 0)),
        (Coefficient(laurent((2, "a^2 b^-1"), (1, "c"))), LENGTHS, (1, 0)),
        (Coefficient(laurent((1, "a^3 b^-1 c^-1"))), LENGTHS, (1, 0)),
        (Coefficient(laurent((1, "a b"))  , laurent((1, "a"), (5, "b"))), LENGTHS[:2], (1, 0)),
        (Coefficient(laurent((1, "g"))), (Symbol("g", 9.81, GRAVITY),), GRAVITY),
    ],
)  # fmt: skip
def test_coefficients_are_found_from_their_residues(wanted, symbols, dimension) -> None:
    made = fitted(wanted, symbols, dimension)
    for prime in PRIMES[2:]:
        values = draw(symbols, PrimeField(prime), np.random.default_rng(7), 5)
        np.testing.assert_array_equal(made.modulo(values), wanted.modulo(values))
    assert made.is_ratio == wanted.is_ratio


def test_squares_of_sines_are_written_as_such() -> None:
    angle = (Symbol("cos(t)", 0.9, DIMENSIONLESS), Symbol("sin(t)", 0.4, DIMENSIONLESS))
    one = Laurent.number(1)
    made = fitted(Coefficient(one - Laurent.symbol("cos(t)", 2)), angle, DIMENSIONLESS)
    assert made == Coefficient(Laurent.symbol("sin(t)", 2))


def test_what_is_no_ratio_of_low_degree_is_not_found() -> None:
    steep = Coefficient(laurent((1, "a^9 b^-8")))
    assert fitted(steep, LENGTHS[:2], (1, 0)) is None
