"""Symbols of a mechanism: lengths, angles and gravity as unknowns, each with its value and its dimension."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import lru_cache
from itertools import combinations, product

import numpy as np

from haptid._internal.late import dataclass
from haptid.device.expressions import number
from haptid.device.loops.relations import nearest
from haptid.device.toml.errors_at import Place
from haptid.dynamics.symbolic.arithmetic import Laurent, Points, PrimeField, Residues

# Exponents of metre and second. Angles are dimensionless: a sliding joint coupled to a turning one relates them to
# lengths.
Dimension = tuple[int, int]
LENGTH: Dimension = (1, 0)
GRAVITY: Dimension = (1, -2)
DIMENSIONLESS: Dimension = (0, 0)
# Dimension of a parameter divided by that of a mass, by its unit.
DIMENSIONS: Mapping[str, Dimension] = {
    "kg m^2": (2, 0),
    "kg m": (1, 0),
    "kg": (0, 0),
    "N m": (2, -2),
    "N": (1, -2),
    "N m s/rad": (2, -1),
    "N s/m": (0, -1),
    "N m/rad": (2, -2),
    "N/m": (0, -2),
}
# The file has been checked: reading its numbers again raises nothing.
CHECKED = Place("")
# Numbers of a file that differ by less, relatively, are the same symbol.
_SAME = 1e-9
# Largest denominator of a number that is read as a ratio of integers, if it is exact to SAME.
LARGEST_DENOMINATOR = 10_000


def dimension_ratio(base: Dimension | None, other: Dimension | None) -> Dimension | None:
    """Dimension of a coefficient, None where a user-defined unit leaves it unknown."""
    if base == other:
        return DIMENSIONLESS
    return (base[0] - other[0], base[1] - other[1]) if base and other else None


@dataclass(frozen=True)
class Symbol:
    """A geometric quantity that is kept as an unknown.

    Attributes:
        name: as in formulas: d3, g, or cos(a2) and sin(a2) of an angle that is no multiple of a quarter turn.
        value: in this device, SI.
        dimension: exponents of metre and second.
        written: how the file has it, or its angle, as arithmetic over named lengths; None for a number.
    """

    name: str
    value: float
    dimension: Dimension
    written: str | None = None

    @property
    def angle(self) -> str | None:
        """Name of the angle whose cosine or sine it is, None for other symbols."""
        return self.name[4:-1] if self.name[:4] in ("cos(", "sin(") else None

    def at(self, lengths: Mapping[str, float], own: Mapping[str, float]) -> float:
        """Its value at other named lengths than the device's own."""
        if self.written is None or not any(name in self.written for name in lengths):
            return self.value
        if self.angle is None and self.written in lengths:
            return lengths[self.written]
        there, here = (number(self.written, names, CHECKED) for names in (lengths, own))
        if self.angle is None:
            return there if here * self.value >= 0 else -there
        quarters = round(here / (math.pi / 2)) * math.pi / 2
        rest = math.copysign(1.0, here - quarters) * (there - quarters)
        return math.cos(rest) if self.name.startswith("cos(") else math.sin(rest)


class Symbols:
    """Registry of the symbols of one mechanism while its file is read: equal numbers share one symbol.

    Opposite bars of a parallelogram must be one symbol, otherwise the loop would not close for all values of it.
    """

    def __init__(self) -> None:
        self._known: dict[str, Symbol] = {}

    @property
    def all(self) -> tuple[Symbol, ...]:
        """In the order of registration."""
        return tuple(self._known.values())

    def named(self, name: str, value: float, dimension: Dimension, written: float | str = 0.0) -> Laurent:
        """A new symbol; a number that is zero stays zero."""
        if value == 0:
            return Laurent()
        while name in self._known or f"cos({name})" in self._known:
            name += "_"
        self._known[name] = Symbol(name, value, dimension, written if isinstance(written, str) else None)
        return Laurent.symbol(name)

    def quantity(self, value: float, name: str, dimension: Dimension = LENGTH, written: float | str = 0.0) -> Laurent:
        """The registered symbol of this size, or a new one."""
        for symbol in self.all:
            if symbol.dimension == dimension and symbol.angle is None and _same(abs(symbol.value), abs(value)):
                sign = Fraction(1 if symbol.value * value > 0 else -1)
                return Laurent.symbol(symbol.name).times(sign)
        made = self.named(name, abs(value), dimension, written)
        return made if value > 0 else -made

    def combination(self, value: float, name: str) -> Laurent:
        """A length as a sum or difference of two registered ones, or as a symbol of its own."""
        lengths = [symbol for symbol in self.all if symbol.dimension == LENGTH]
        if not any(_same(abs(symbol.value), abs(value)) for symbol in lengths):
            for (a, b), s, t in product(combinations(lengths, 2), (1, -1), (1, -1)):
                if _same(s * a.value + t * b.value, value):
                    return Laurent.symbol(a.name).times(Fraction(s)) + Laurent.symbol(b.name).times(Fraction(t))
        return self.quantity(value, name)

    def position(self, value: float, slides: bool, name: str) -> Laurent:
        """A joint's position: a length, a multiple of pi / 12, or a symbol of its own."""
        if value == 0:
            return Laurent()
        if slides:
            return self.combination(value, name)
        twelfths = nearest(value, math.pi / 12) / (math.pi / 12)
        if twelfths == round(twelfths):
            return self.quantity(math.pi, "pi", DIMENSIONLESS).times(Fraction(round(twelfths), 12))
        return self.quantity(value, name, DIMENSIONLESS)

    def turn(self, angle: float, name: str, written: float | str = 0.0) -> tuple[Laurent, Laurent]:
        """Cosine and sine of an angle: numbers at quarter turns, otherwise symbols of the rest within an eighth of one.

        Angles that differ by quarter turns or in sign share their symbols.
        """
        quarters = round(angle / (math.pi / 2))
        rest = angle - quarters * math.pi / 2
        if abs(rest) < _SAME:
            c, s = Laurent.number(1), Laurent()
        else:
            c, s = self._small_turn(abs(rest), name, written)
            s = s if rest > 0 else -s
        for _ in range(quarters % 4):
            c, s = -s, c
        return c, s

    def _small_turn(self, angle: float, name: str, written: float | str) -> tuple[Laurent, Laurent]:
        for symbol in self.all:
            if symbol.name.startswith("sin(") and _same(symbol.value, math.sin(angle)):
                return Laurent.symbol(f"cos({symbol.angle})"), Laurent.symbol(symbol.name)
        while name in self._known or f"cos({name})" in self._known:
            name += "_"
        cosine, sine = f"cos({name})", f"sin({name})"
        values = ((cosine, math.cos(angle)), (sine, math.sin(angle)))
        cos, sin = (self.named(part, value, DIMENSIONLESS, written) for part, value in values)
        return cos, sin


def _same(a: float, b: float) -> bool:
    return abs(a - b) <= _SAME * max(abs(a), abs(b))


@lru_cache(maxsize=1024)
def ratio(value: float) -> Fraction:
    """A number of a file as an exact fraction: a ratio of small integers, or the decimals as written."""
    simple = Fraction(value).limit_denominator(LARGEST_DENOMINATOR)
    return simple if _same(float(simple), value) else Fraction(repr(value))


def draw(symbols: Iterable[Symbol], field: PrimeField, rng: np.random.Generator, count: int) -> Points:
    """Random residues of all symbols, (count,) each; cosine and sine of an angle lie on the circle."""
    drawn: dict[str, Residues] = {}
    for symbol in symbols:
        if symbol.angle is None:
            drawn[symbol.name] = field.draw(rng, count)
        elif symbol.name not in drawn:
            drawn[f"cos({symbol.angle})"], drawn[f"sin({symbol.angle})"] = field.circle(rng, count)
    return Points(field, drawn, count)
