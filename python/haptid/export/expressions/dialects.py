"""Syntax of the target languages: C99, Rust and MATLAB."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Protocol

from haptid._internal.late import dataclass

ARITHMETIC = ("+", "-", "*", "/")
# Outputs that are matrices, row-major, and the length of a row; -1 for the number of coordinates.
ROWS = {"M": -1, "J": -1, "rotation": 3, "mobility": 3}


class Dialect(Protocol):
    """Protocol of a target language."""

    def literal(self, value: float) -> str:
        """A number with round-trip precision."""

    def named(self, text: str) -> str:
        """An entry of an input, named q[0] in the expressions."""

    def constant(self, name: str, text: str) -> str:
        """Declaration of a constant."""

    def call(self, function: str, arguments: Sequence[str]) -> str:
        """Call of a function of one number, or pow."""

    def divisor(self, text: str) -> str:
        """A named divisor of a function with a status, which fails where it is zero."""

    def sound(self, positive: Sequence[str]) -> Sequence[str]:
        """Statements that test whether values are positive."""

    def end(self, outputs: Mapping[str, Sequence[str]], otherwise: Mapping[str, str] | None) -> Sequence[str]:
        """Last statements of a function: outputs, and unless `otherwise` is None the status of the tests.

        `otherwise` has the inputs that take the place of outputs where a test fails; other outputs are zero there.
        """


class Keeping(Dialect, Protocol):
    """A language in which values that depend on parameters alone are precomputed by an initialisation."""

    def kept(self, place: int) -> str:
        """A precomputed value."""

    def keep(self, place: int, text: str) -> str:
        """Assignment of a precomputed value."""

    def begin(self) -> Sequence[str]:
        """First statements of a function that reads precomputed values."""


@dataclass(frozen=True)
class C:
    """C99.

    Attributes:
        real: the type.
        suffix: of literals and of the library's functions.
    """

    real: str
    suffix: str

    def literal(self, value: float) -> str:
        return repr(value) + self.suffix

    def named(self, text: str) -> str:
        return text

    def constant(self, name: str, text: str) -> str:
        return f"const {self.real} {name} = {text};"

    def call(self, function: str, arguments: Sequence[str]) -> str:
        zero, text = self.literal(0.0), arguments[0]
        if function in ("above", "below"):
            return f"{'fmax' if function == 'above' else 'fmin'}{self.suffix}({text}, {zero})"
        if function == "sign":
            return f"({self.real})(({text}) > {zero}) - ({self.real})(({text}) < {zero})"
        return f"{function}{self.suffix}({', '.join(arguments)})"

    def divisor(self, text: str) -> str:
        """One in place of zero, without a branch: no division by zero, which stops processors that trap it."""
        return f"({text} + ({self.real})({text} == {self.literal(0.0)}))"

    def kept(self, place: int) -> str:
        return f"k[{place}]"

    def keep(self, place: int, text: str) -> str:
        if self.real == "double":
            return f"model->k[{place}] = {text};"
        bracketed = f"({text})" if " " in text else text
        return f"model->k[{place}] = ({self.real}){bracketed};"

    def begin(self) -> Sequence[str]:
        return [f"const {self.real} *const k = model->k;"]

    def sound(self, positive: Sequence[str]) -> Sequence[str]:
        tests = " && ".join(f"({text} > {self.literal(0.0)})" for text in positive)
        return [f"const int sound = {tests};"]

    def end(self, outputs: Mapping[str, Sequence[str]], otherwise: Mapping[str, str] | None) -> Sequence[str]:
        lines = []
        for name, texts in outputs.items():
            for place, text in enumerate(texts):
                if otherwise is not None:
                    else_ = f"{otherwise[name]}[{place}]" if name in otherwise else self.literal(0.0)
                    text = f"(sound != 0) ? ({text}) : {else_}"
                lines.append(f"{name}[{place}] = {text};")
        return lines if otherwise is None else [*lines, "return (sound != 0) ? 0 : 1;"]


DOUBLE = C("double", "")
SINGLE = C("float", "f")


@dataclass(frozen=True)
class Rust:
    """Rust without the standard library; mathematical functions from the crate libm."""

    def literal(self, value: float) -> str:
        return repr(value)

    def named(self, text: str) -> str:
        return text

    def constant(self, name: str, text: str) -> str:
        return f"let {name} = {text};"

    def call(self, function: str, arguments: Sequence[str]) -> str:
        text = arguments[0]
        if function in ("above", "below"):
            return f"libm::{'fmax' if function == 'above' else 'fmin'}({text}, 0.0)"
        if function == "sign":
            return f"f64::from(i8::from({text} > 0.0) - i8::from({text} < 0.0))"
        return f"libm::{function}({', '.join(arguments)})"

    def divisor(self, text: str) -> str:
        return text

    def kept(self, place: int) -> str:
        return f"k[{place}]"

    def keep(self, place: int, text: str) -> str:
        return f"k[{place}] = {text};"

    def begin(self) -> Sequence[str]:
        return ["let k = &model.k;"]

    def sound(self, positive: Sequence[str]) -> Sequence[str]:
        tests = " && ".join(f"{text} > 0.0" for text in positive)
        return [f"let sound = {tests};"]

    def end(self, outputs: Mapping[str, Sequence[str]], otherwise: Mapping[str, str] | None) -> Sequence[str]:
        arrays = [f"[{', '.join(texts)}]" for texts in outputs.values()]
        made = arrays[0] if len(arrays) == 1 else f"({', '.join(arrays)})"
        return [made] if otherwise is None else [f"sound.then_some({made})"]


@dataclass(frozen=True)
class Matlab:
    """MATLAB and Octave: the base parameters are an input called beta.

    Attributes:
        coordinates: their number.
    """

    coordinates: int

    def literal(self, value: float) -> str:
        return repr(value)

    def named(self, text: str) -> str:
        found = re.fullmatch(r"(\w+)\[(\d+)\]", text)
        assert found is not None  # all inputs are arrays
        return f"{'beta' if found[1] == 'p' else found[1]}({int(found[2]) + 1})"

    def constant(self, name: str, text: str) -> str:
        return f"{name} = {text};"

    def call(self, function: str, arguments: Sequence[str]) -> str:
        text = arguments[0]
        if function in ("above", "below"):
            return f"{'max' if function == 'above' else 'min'}({text}, 0)"
        if function == "pow":
            return f"power({', '.join(arguments)})"
        return f"{'abs' if function == 'fabs' else function}({text})"

    def divisor(self, text: str) -> str:
        return text

    def sound(self, positive: Sequence[str]) -> Sequence[str]:
        return [f"sound = {' && '.join(f'({text} > 0)' for text in positive)};"]

    def end(self, outputs: Mapping[str, Sequence[str]], otherwise: Mapping[str, str] | None) -> Sequence[str]:
        lines = [f"{name} = [{'; '.join(self._rows(name, texts))}];" for name, texts in outputs.items()]
        if otherwise is not None:
            lines += [f"if ~sound, {name}(:) = {otherwise.get(name, '0')}; end" for name in outputs]
        return lines

    def _rows(self, name: str, texts: Sequence[str]) -> list[str]:
        """Rows of a matrix, or entries of a column vector."""
        width = ROWS.get(name, 1)
        width = self.coordinates if width < 0 else width
        return [", ".join(texts[k : k + width]) for k in range(0, len(texts), width)]
