"""Relations of passive joints as text, and their constants rounded to simple fractions."""

from __future__ import annotations

import math
from collections.abc import Sequence

from haptid._internal.arrays import Array
from haptid.device.expressions import JointPolynomial

# Constants this close to a multiple of pi / 12, and rates this close to one of 1 / 12, are rounded to it.
EXACT = 1e-9


def nearest(value: float, step: float) -> float:
    """The nearest multiple of a step if it is within 1e-9, else the value itself."""
    multiple = round(value / step) * step
    return multiple + 0.0 if abs(value - multiple) < EXACT else value


def relation_text(names: Sequence[str], joint: int, active: tuple[int, ...], row: Array, constant: float) -> str:
    """A relation as in a device file, such as `q3 = pi/2 - q2 + q7`."""
    parts = [("-" if constant < 0 else "+", _angle(abs(constant)))] if constant else []
    for k, factor in zip(active, row, strict=True):
        if factor:
            size = "" if abs(factor) == 1 else f"{abs(factor):.12g}*"
            parts.append(("-" if factor < 0 else "+", f"{size}q{names[k]}"))
    if not parts:
        return f"q{names[joint]} = 0"
    (sign, first), *rest = parts
    return f"q{names[joint]} = {'-' if sign == '-' else ''}{first}" + "".join(f" {s} {text}" for s, text in rest)


def polynomial_text(name: str, polynomial: JointPolynomial) -> str:
    """A relation as in a device file, such as `q3 = 0.1 + 0.8*q2 + 0.1*q2**2`."""
    parts = []
    for product, factor in sorted(polynomial.terms.items(), key=lambda term: (len(term[0]), term[0])):
        powers = [(symbol, product.count(symbol)) for symbol in dict.fromkeys(product)]
        symbols = [symbol if power == 1 else f"{symbol}**{power}" for symbol, power in powers]
        if factor or not product:
            parts.append("*".join([f"{factor:.12g}", *symbols]))
    return f"q{name} = {' + '.join(part for part in parts if part != '0') or '0'}".replace("+ -", "- ")


def _angle(value: float) -> str:
    twelfths = round(value / (math.pi / 12))
    if twelfths == 0 or abs(value - twelfths * math.pi / 12) > EXACT:
        return f"{value:.12g}"
    shared = math.gcd(twelfths, 12)
    above, below = twelfths // shared, 12 // shared
    return ("pi" if above == 1 else f"{above}*pi") + ("" if below == 1 else f"/{below}")
