"""Regroupings as formulas in plain text and LaTeX: parameters with a common coefficient are collected."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction

from haptid._internal.late import dataclass
from haptid.dynamics.symbolic.arithmetic import Coefficient, Laurent, Powers

# Parameter names split into kind and owner.
NAME = re.compile(r"(XX|XY|XZ|YY|YZ|ZZ|MX|MY|MZ|IA|FV|FC|FS|OFF|M|K|[A-Za-z]+?)(\w*)$")


@dataclass(frozen=True)
class Style:
    """How the parts of a formula are written.

    Attributes:
        parameter: of a standard parameter's name.
        power: of a symbol's name and an exponent above zero.
        fraction: of numerator and denominator, each a product or a sum.
    """

    parameter: Callable[[str], str]
    power: Callable[[str, int], str]
    fraction: Callable[[str, str], str]

    def number(self, value: Fraction) -> str:
        """A number above zero, empty for one."""
        if value == 1:
            return ""
        if value.denominator == 1:
            return str(value.numerator)
        return self.fraction(str(value.numerator), str(value.denominator))

    def monomial(self, exponents: Powers) -> str:
        """A product of powers."""
        above = " ".join(self.power(name, e) for name, e in exponents if e > 0)
        below = " ".join(self.power(name, -e) for name, e in exponents if e < 0)
        return self.fraction(above or "1", below) if below else above

    def polynomial(self, laurent: Laurent) -> str:
        """A sum of monomials, positive ones first, then by degree, highest first."""
        terms = sorted(laurent.terms, key=lambda term: (term[1] < 0, _rank(term[0])))
        return joined((c, " ".join(filter(None, (self.number(abs(c)), self.monomial(e)))) or "1") for e, c in terms)

    def parameters(self, share: Sequence[tuple[str, Fraction]]) -> str:
        """A sum of parameters."""
        return joined((c, " ".join(filter(None, (self.number(abs(c)), self.parameter(name))))) for name, c in share)


def joined(parts: Iterable[tuple[Fraction, str]]) -> str:
    """Texts as a sum, each with the sign of its number."""
    text = ""
    for signed, part in parts:
        sign = "-" if signed < 0 else "+"
        text += f" {sign} {part}" if text else ("-" if signed < 0 else "") + part
    return text


def text(row: Mapping[int, Coefficient], column: int, names: Sequence[str], links: Sequence[int]) -> str:
    """A base parameter's combination of standard parameters, in plain text."""
    return grouping_formula(row, column, names, links, TEXT)


def latex(row: Mapping[int, Coefficient], column: int, names: Sequence[str], links: Sequence[int]) -> str:
    """The same in LaTeX."""
    return grouping_formula(row, column, names, links, LATEX)


def coefficient(value: Coefficient) -> str:
    """A coefficient in plain text: `d3^2 + d4^2`, `d6/d3`, `-1`."""
    return _quotient(value, TEXT) if value.is_ratio else TEXT.polynomial(value.numerator)


def _quotient(value: Coefficient, style: Style) -> str:
    return style.fraction(*(_bracketed(style.polynomial(part)) for part in (value.numerator, value.denominator)))


def grouping_formula(
    row: Mapping[int, Coefficient], column: int, names: Sequence[str], links: Sequence[int], style: Style
) -> str:
    """A base parameter as text: the parameter kept, those with numeric factors by link, then those with lengths."""
    order = sorted(row, key=lambda k: (k != column, links[k] < 0, links[k], k))
    by_monomial: dict[Powers, list[tuple[str, Fraction]]] = {}
    for k in order:
        if not row[k].is_ratio:
            for exponents, coefficient in row[k].numerator.terms:
                by_monomial.setdefault(exponents, []).append((names[k], coefficient))
    parts = [(Fraction(1), style.parameters(by_monomial.pop((), [])))]
    for share, factor in _collected(by_monomial):
        parts.append(_product(share, factor, style))
    for k in order:
        if row[k].is_ratio:
            parts.append((Fraction(1), f"{style.parameter(names[k])} {_quotient(row[k], style)}"))
    return joined(parts)


def _collected(
    by_monomial: Mapping[Powers, Sequence[tuple[str, Fraction]]],
) -> list[tuple[tuple[tuple[str, Fraction], ...], Laurent]]:
    """Parameters in the same proportions, and their common polynomial."""
    collected: dict[tuple[tuple[str, Fraction], ...], Laurent] = {}
    for exponents in sorted(by_monomial, key=_rank):
        share = by_monomial[exponents]
        lead = share[0][1]
        key = tuple((name, coefficient / lead) for name, coefficient in share)
        collected[key] = collected.get(key, Laurent()) + Laurent.of([(exponents, lead)])
    return list(collected.items())


def _product(share: Sequence[tuple[str, Fraction]], factor: Laurent, style: Style) -> tuple[Fraction, str]:
    """A sign, and parameters times their polynomial."""
    parameters = _bracketed(style.parameters(share))
    if len(factor.terms) > 1:
        return Fraction(1), f"{parameters} {_bracketed(style.polynomial(factor))}"
    ((exponents, lead),) = factor.terms
    return lead, " ".join(filter(None, (style.number(abs(lead)), parameters, style.monomial(exponents))))


def _bracketed(sum_: str) -> str:
    """A sum in brackets, anything else unchanged."""
    return f"({sum_})" if " + " in sum_ or " - " in sum_ else sum_


def _rank(exponents: Powers) -> tuple[int, Powers]:
    """Highest degrees first, then by name."""
    return -sum(e for _, e in exponents), exponents


def subscript(name: str) -> str:
    """The LaTeX of a parameter's name: ZZ_{2R}."""
    match = NAME.match(name)
    return f"{match[1]}_{{{match[2]}}}" if match and match[2] else name


def _text_power(name: str, exponent: int) -> str:
    return name if exponent == 1 else f"{name}^{exponent}"


def _text_fraction(above: str, below: str) -> str:
    return f"{above}/{below}" if " " not in below or below.startswith("(") else f"{above}/({below})"


def _latex_power(name: str, exponent: int) -> str:
    raised = "" if exponent == 1 else f"^{{{exponent}}}"
    if name.startswith(("cos(", "sin(")):
        return rf"\{name[:3]}{raised} {_latex_symbol(name[4:-1])}"
    return _latex_symbol(name) + raised


def _latex_symbol(name: str) -> str:
    stem = name.rstrip("0123456789_")
    number = name[len(stem) :].replace("_", "'")
    stem = r"\pi" if stem == "pi" else stem if len(stem) == 1 else rf"\mathrm{{{stem}}}"
    return f"{stem}_{{{number}}}" if number else stem


TEXT = Style(parameter=lambda name: name, power=_text_power, fraction=_text_fraction)
LATEX = Style(parameter=subscript, power=_latex_power, fraction=lambda above, below: rf"\frac{{{above}}}{{{below}}}")
