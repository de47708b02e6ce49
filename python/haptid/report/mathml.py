"""Regroupings of base parameters as MathML: symbolic where the lengths are symbols, else numeric."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from xml.etree import ElementTree

import numpy as np
from markupsafe import Markup

from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.symbolic import Regroupings
from haptid.dynamics.symbolic.formulas import NAME, Style, grouping_formula

# Elements and attributes of formulas.
_ELEMENTS = frozenset({"math", "mrow", "mi", "mn", "mo", "msub", "msup", "msubsup", "mfrac"})
_ATTRIBUTES = frozenset({"form", "stretchy"})
# An element is represented in a text by its number between these two, so that texts can be concatenated.
OPEN, _CLOSE = "\ue000", "\ue001"
TOKEN = re.compile(rf"{OPEN}(\d+){_CLOSE}|(\d+(?:\.\d+)?(?:e[-+]?\d+)?)|([-+()])")


def groupings(base: BaseParameters, exact: Regroupings | None) -> tuple[str, ...]:
    """MathML of the regrouping of every base parameter, one element for each term, so that lines can break.

    Args:
        base: the parameters.
        exact: the same with lengths as symbols; None where there are none.
    """
    if exact is None:
        rows = zip(base.regrouping, base.independent_columns, strict=True)
        return tuple(_numeric(row, base.standard, column) for row, column in rows)
    return tuple(_exact(exact, k) for k in range(len(exact)))


# Names of parameters of joints, whose own names may have underscores.
_OF_A_JOINT = re.compile("(XX|XY|XZ|YY|YZ|ZZ|MX|MY|MZ|IA|FV|FC|FS|OFF)(?!_)")


def parameter(text: str) -> str:
    """A parameter's name as a MathML element: ZZ1R is ZZ with the subscript 1R."""
    return f"<math>{_name(text)}</math>"


def formula_markup(text: str) -> Markup:
    """Markup that consists of the elements of this module alone, as a page may have it; a result folder may hold any.

    Raises:
        ValueError: it has another element or attribute.
    """
    try:
        markup = ElementTree.fromstring(f"<mrow>{text}</mrow>")
    except ElementTree.ParseError as error:
        raise ValueError(f"a formula is not MathML: {error}") from None
    for element in markup.iter():
        if element.tag not in _ELEMENTS or not set(element.attrib) <= _ATTRIBUTES:
            raise ValueError(f"a formula has the element {element.tag!r} with {sorted(element.attrib)}")
    return Markup(text)


def _exact(regroupings: Regroupings, k: int) -> str:
    page = _Typesetter()
    return page.terms(
        grouping_formula(
            regroupings.coefficients[k],
            regroupings.independent_columns[k],
            regroupings.standard,
            regroupings.links,
            page.style,
        )
    )


def _numeric(coefficients: np.ndarray, names: Sequence[str], first: int) -> str:
    """Numbers times parameters, the named one first."""
    others = [int(k) for k in np.flatnonzero(coefficients) if k != first]
    parts: list[str] = []
    for k in (first, *others):
        value = float(coefficients[k])
        sign = _between("-" if value < 0 else "+") if parts else "<mo>&#x2212;</mo>" if value < 0 else ""
        size = "" if np.isclose(abs(value), 1.0, rtol=1e-9) else f"<mn>{abs(value):.4g}</mn>"
        parts.append(f"{sign}{size}{_name(names[k])}")
    return " ".join(f"<math>{part}</math>" for part in parts)


class _Typesetter:
    """Elements made so far, by the numbers in the placeholders."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.style = Style(
            parameter=lambda text: self.kept(_name(text)),
            power=lambda text, exponent: self.kept(_power(text, exponent)),
            fraction=lambda above, below: self.kept(f"<mfrac>{self.row(above)}{self.row(below)}</mfrac>"),
        )

    def kept(self, element: str) -> str:
        """A placeholder for an element."""
        self.made.append(element)
        return f"{OPEN}{len(self.made) - 1}{_CLOSE}"

    def row(self, text: str) -> str:
        """A text as one element."""
        return f"<mrow>{''.join(self.element(*token) for token in TOKEN.findall(text))}</mrow>"

    def terms(self, text: str) -> str:
        """A text as one element for each term, bracketed ones too."""
        parts = [""]
        for token in TOKEN.findall(text):
            if token[2] in ("+", "-") and parts[-1]:
                parts.append(_between(token[2]))
            else:
                parts[-1] += self.element(*token)
        return " ".join(f"<math>{part}</math>" for part in parts)

    def element(self, number: str, digits: str, sign: str) -> str:
        """One token as an element."""
        if number:
            return self.made[int(number)]
        if digits:
            return f"<mn>{digits}</mn>"
        return {"-": "<mo>&#x2212;</mo>", "+": "<mo>+</mo>"}.get(sign, f'<mo stretchy="false">{sign}</mo>')


def _between(sign: str) -> str:
    """A sign at the start of an element, spaced as between two terms."""
    return f'<mo form="infix">{"&#x2212;" if sign == "-" else "+"}</mo>'


def _name(text: str) -> str:
    if "_" in text and not _OF_A_JOINT.match(text):  # of a user's own: pi_1
        stem, index = text.split("_", 1)
        shown = "&#x3c0;" if stem == "pi" else escape(stem)
        return f"<msub><mi>{shown}</mi><mi>{escape(index)}</mi></msub>"
    match = NAME.match(text)
    if not match or not match[2]:
        return f"<mi>{escape(text)}</mi>"
    return f"<msub><mi>{escape(match[1])}</mi><mi>{escape(match[2])}</mi></msub>"


def _symbol(text: str, exponent: int = 1) -> str:
    """d3 is d with the subscript 3, and an exponent above it where it has one."""
    stem = text.rstrip("0123456789_")
    number = text[len(stem) :].replace("_", "\u2032")
    shown = f"<mi>{'&#x3c0;' if stem == 'pi' else escape(stem)}</mi>"
    subscript, above = f"<mn>{number}</mn>", f"<mn>{exponent}</mn>"
    if exponent == 1:
        return f"<msub>{shown}{subscript}</msub>" if number else shown
    return f"<msubsup>{shown}{subscript}{above}</msubsup>" if number else f"<msup>{shown}{above}</msup>"


def _power(text: str, exponent: int) -> str:
    if not text.startswith(("cos(", "sin(")):
        return _symbol(text, exponent)
    name = f"<mi>{text[:3]}</mi>"
    raised = name if exponent == 1 else f"<msup>{name}<mn>{exponent}</mn></msup>"
    return f"<mrow>{raised}<mo>&#x2061;</mo>{_symbol(text[4:-1])}</mrow>"
