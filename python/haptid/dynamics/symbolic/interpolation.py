"""Interpolation of a coefficient from its residues at many sets of lengths.

Its dimension is known from the units of the two parameters, so only monomials of that dimension are tried: Laurent
polynomials of growing degree first, then ratios of polynomials. A form that fits at more points than it has unknowns is
correct with overwhelming probability; it is checked at another prime as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import islice, product
from math import prod
from operator import mul
from types import MappingProxyType

import numpy as np

from haptid.dynamics.symbolic.arithmetic import ONE, Coefficient, Laurent, Points, Powers, Residues, powers, rational
from haptid.dynamics.symbolic.symbols import DIMENSIONLESS, GRAVITY, Dimension, Symbol

# Ranges of exponents tried in polynomials, narrowest first.
EXPONENT_RANGES = ((0, 2), (-1, 2), (-1, 3), (-2, 3), (-3, 4))
# Degrees of denominators tried, in lengths and gravity together, and in gravity.
DENOMINATORS = (0, 1, 2, 3, 4)
# Most combinations of exponents that are listed.
MOST_COMBINATIONS = 20_000
# Largest exponent of one symbol that is tried, of either sign.
LARGEST_EXPONENT = 4
# Least number of points beyond the unknowns of a fit.
SPARE_POINTS = 3


def _monomial_residues(points: Points, found: Sequence[Powers], count: int) -> Residues:
    """Residues of monomials at the first points, (count, monomials)."""
    residues = np.ones((count, len(found)), dtype=np.int64)
    cache: dict[tuple[str, int], Residues] = {}
    for k, exponents in enumerate(found):
        for name, exponent in exponents:
            if (name, exponent) not in cache:
                cache[name, exponent] = points.field.power(points.values[name][:count], exponent)
            residues[:, k] = points.field.reduce(residues[:, k] * cache[name, exponent])
    return residues


def span_of(points: Points, y: Residues, name: str, line: Sequence[int]) -> range | None:
    """Exponents of one symbol in a coefficient, None where it is no Laurent polynomial in it.

    Args:
        points: sets of lengths.
        y: residues of the coefficient there.
        name: of the symbol.
        line: points that differ in this symbol alone.
    """
    x, wanted = points.values[name][line], y[line]
    for width, low in product(range(len(line) - SPARE_POINTS), range(-LARGEST_EXPONENT, LARGEST_EXPONENT + 1)):
        powers_of = [points.field.power(x, exponent) for exponent in range(low, low + width + 1)]
        system = np.column_stack([*powers_of, wanted])
        if points.field.echelon(system[None])[1] == list(range(width + 1)):
            return range(low, low + width + 1)
    return None


def fit_coefficient(
    points: Sequence[Points],
    y: Sequence[Residues],
    symbols: Sequence[Symbol],
    dimension: Dimension,
    spans: Mapping[str, range | None],
) -> Coefficient | None:
    """The coefficient with given residues, None where no form fits.

    Args:
        points: sets of lengths, for each prime.
        y: residues of the coefficient there, (points,) each.
        symbols: those that it depends on.
        dimension: its dimension.
        spans: exponents of symbols, as far as they are known.
    """
    most = len(y[0]) - SPARE_POINTS
    tried: set[tuple[Powers, ...]] = set()
    polynomial = all(spans.get(symbol.name) for symbol in symbols)  # a Laurent polynomial in each is one in all
    for low, high in EXPONENT_RANGES[:1] if polynomial else EXPONENT_RANGES:
        candidates = tuple(islice(monomials(symbols, dimension, low, high, spans=spans), most + 1))
        if candidates and len(candidates) <= most and candidates not in tried:
            made = _polynomial(points, y, candidates)
            if made is not None:
                return Coefficient(sines(made))
        tried.add(candidates)
    for below, above in () if polynomial else _quotients(symbols, dimension):
        if above and len(below) > 1 and len(above) + len(below) <= most:
            ratio = _ratio(points, y, above, below)
            if ratio is not None:
                return ratio
    return None


def _quotients(
    symbols: Sequence[Symbol], dimension: Dimension
) -> Iterator[tuple[tuple[Powers, ...], tuple[Powers, ...]]]:
    """Monomials of denominators and numerators, of growing degree in lengths, gravity and an angle's cosines."""
    turns = (1, 2) if any(symbol.angle for symbol in symbols) else (0,)
    heaviness = DENOMINATORS if any(symbol.dimension == GRAVITY for symbol in symbols) else (0,)
    for degree, heavy, turn in product(DENOMINATORS, heaviness, turns):
        if degree >= heavy:
            below = (degree, -2 * heavy)
            above = (dimension[0] + degree, dimension[1] - 2 * heavy)
            yield (
                tuple(monomials(symbols, below, 0, degree, turn)),
                tuple(monomials(symbols, above, 0, degree + max(dimension[0], 0), turn)),
            )


def monomials(
    symbols: Sequence[Symbol],
    dimension: Dimension,
    low: int,
    high: int,
    turn: int = 2,
    spans: Mapping[str, range | None] = MappingProxyType({}),
) -> Iterator[Powers]:
    """Monomials of a dimension, at most `turn` cosines or sines of an angle in each; exponents as far as known."""
    ranges = [spans.get(symbol.name) or _span(symbol, low, high) for symbol in symbols]
    if prod(map(len, ranges)) > MOST_COMBINATIONS:
        return
    names, (metres, seconds) = [s.name for s in symbols], zip(*(s.dimension for s in symbols), strict=True)
    angles = [[s.angle == angle for s in symbols] for angle in {s.angle for s in symbols if s.angle}]
    for exponents in product(*ranges):
        if (sum(map(mul, exponents, metres)), sum(map(mul, exponents, seconds))) == dimension and all(
            sum(map(mul, exponents, angle)) <= turn for angle in angles
        ):
            yield powers(zip(names, exponents, strict=True))


def _span(symbol: Symbol, low: int, high: int) -> range:
    """Exponents of a symbol; sin^2 is 1 - cos^2, so a sine, like a spring's rest angle, has only 0 and 1."""
    if symbol.dimension != DIMENSIONLESS:
        return range(low, high + 1)
    return range(3) if symbol.name.startswith("cos(") else range(2)


def _polynomial(points: Sequence[Points], y: Sequence[Residues], exponents: tuple[Powers, ...]) -> Laurent | None:
    """The linear combination of these monomials with the residues y, None where there is none."""
    solutions = []
    for values, residues in zip(points, y, strict=True):
        system = np.column_stack([_monomial_residues(values, exponents, len(residues)), residues])
        form, pivots = values.field.echelon(system[None])
        if pivots != list(range(len(exponents))):
            return None
        solutions.append(form[0, :, -1])
    return _joined(points, solutions, exponents)


def _ratio(
    points: Sequence[Points], y: Sequence[Residues], above: tuple[Powers, ...], below: tuple[Powers, ...]
) -> Coefficient | None:
    """The ratio of combinations of these monomials with the residues y: the null vector of [above, -y below]."""
    solutions, free = [], -1
    for values, residues in zip(points, y, strict=True):
        under = _monomial_residues(values, below, len(residues)) * residues[:, None]
        system = np.column_stack([_monomial_residues(values, above, len(residues)), values.field.reduce(-under)])
        form, pivots = values.field.echelon(system[None])
        left = sorted(set(range(system.shape[1])) - set(pivots))
        if not left or free not in (-1, left[0]):
            return None
        free = left[0]
        vector = np.zeros(system.shape[1], dtype=np.int64)
        vector[free] = 1
        vector[pivots] = values.field.reduce(-form[0, :, free])
        solutions.append(vector)
    numerator = _joined(points, [vector[: len(above)] for vector in solutions], above)
    denominator = _joined(points, [vector[len(above) :] for vector in solutions], below)
    if numerator is None or denominator is None or not denominator.terms:
        return None
    scale = 1 / denominator.terms[0][1]
    return Coefficient(numerator.times(scale), denominator.times(scale))


def _joined(points: Sequence[Points], solutions: Sequence[Residues], found: tuple[Powers, ...]) -> Laurent | None:
    """The polynomial with these residues as coefficients, None where one of them is no small rational."""
    primes = tuple(values.field.prime for values in points)
    terms: list[tuple[Powers, Fraction]] = []
    for k, exponents in enumerate(found):
        coefficient = rational(tuple(int(solution[k]) for solution in solutions), primes)
        if coefficient is None:
            return None
        terms.append((exponents, coefficient))
    return Laurent.of(terms)


def sines(polynomial: Laurent) -> Laurent:
    """The same polynomial with 1 - cos^2 replaced by sin^2 wherever a term has its counterpart."""
    if not any(name.startswith("cos(") for name in polynomial.symbols):
        return polynomial
    terms = dict(polynomial.terms)
    for exponents, coefficient in polynomial.terms:
        squares = [name for name, e in exponents if e == 2 and name.startswith("cos(")]
        for name in squares:
            rest = powers((symbol, e) for symbol, e in exponents if symbol != name)
            if terms.get(rest) == -coefficient and exponents in terms:
                del terms[exponents], terms[rest]
                terms[powers((*rest, (f"sin({name[4:-1]})", 2)))] = -coefficient
    return Laurent.of(terms.items())


def with_sines(coefficient: Coefficient) -> Coefficient:
    """The same coefficient, its numerator as by `sines`."""
    return Coefficient(sines(coefficient.numerator), coefficient.denominator)


def with_cosines(coefficient: Coefficient) -> Coefficient:
    """The same coefficient with sin^2 in its numerator replaced by 1 - cos^2, so that like terms are found."""
    if not any(name.startswith("sin(") for name in coefficient.numerator.symbols):
        return coefficient
    total: list[tuple[Powers, Fraction]] = []
    for exponents, factor in coefficient.numerator.terms:
        squared = {name for name, e in exponents if e == 2 and name.startswith("sin(")}
        term = Laurent((((*((n, e) for n, e in exponents if n not in squared),), factor),))
        for name in squared:
            term = term * (ONE - Laurent.symbol(f"cos({name[4:-1]})", 2))
        total += term.terms
    return Coefficient(Laurent.of(total), coefficient.denominator)
