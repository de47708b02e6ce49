"""Text of the C files: templates filled with generated code, parameters and documentation."""

from __future__ import annotations

import re
import string
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property
from importlib import resources

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.escaping import c_comment
from haptid._internal.late import dataclass
from haptid.device.elastic import torsion_places
from haptid.dynamics.model import DynamicModel
from haptid.export.expressions.dialects import C
from haptid.export.expressions.emit import Emitted, Function, emitted
from haptid.export.formats.single_precision import OutputBounds, single_precision_bounds, single_precision_lines
from haptid.export.formats.worst_case import worst_case_lines
from haptid.export.model.functions import Code, code_for
from haptid.export.model.passive import start_pose, start_positions
from haptid.export.output import CCode
from haptid.export.provenance import Provenance, about, coordinate_lines

# Maximum line length of a comment or a declaration, characters.
_WIDTH = 116
# Declarations and heads of definitions in C.
DECLARATION = re.compile(r"^((?:\w+ )+\w+\()([^;(){}]*)\)(?=;|\n\{)", re.MULTILINE)
# Steps from the start pose of loops to a first sample.
SEGMENTS = 256
# Settings of the examples: sampling period, s; observer gain, rad/s; differentiator cutoff, Hz; motion per tick, rad.
STEP, GAIN, CUTOFF_HZ, CREEP = 0.001, 40.0, 50.0, 1e-4


# What the examples add where there are passive joints of loops; @ is the name of the model.
_IN_EXAMPLES = {
    "loops_field": "\n    @_loops loops;",
    "loops_closed": """
    const @_real *const z = state->loops.z;
    state->wrong += @_loops_update(&state->loops, q);""",
    "loops_start": """
    {
        @_real q[N];
        read_encoders(0, q);
        state.wrong += @_loops_start(&state.loops, q);
    }""",
}


class _Template(string.Template):
    """Template with the delimiter @: $ and {} are common in the written files."""

    delimiter = "@"


@dataclass(frozen=True, eq=False)
class Files:
    """The files of one model.

    Attributes:
        source: the model.
        code: its functions.
        dialect: double or single precision.
        name: prefix of all names in C.
        settings: of the code.
    """

    source: Provenance
    code: Code
    dialect: C
    name: str
    settings: CCode = field(default_factory=CCode)

    @staticmethod
    def of(source: Provenance, settings: CCode | None, dialect: C) -> Files:
        """The files of a model, by the settings of its code."""
        code, name = code_for(source, settings)
        return Files(source, code, dialect, name, settings or CCode())

    @property
    def model(self) -> DynamicModel:
        return self.source.model

    @cached_property
    def generated(self) -> Emitted:
        return emitted(self.code.graph, self.code.functions, self.dialect)

    @cached_property
    def bounds(self) -> OutputBounds:
        """Of the error in single precision; empty in double precision."""
        if self.dialect.real == "double":
            return {}
        return single_precision_bounds(self.source, self.code, self.settings)

    @cached_property
    def common(self) -> Mapping[str, object]:
        """Values that are common to the templates."""
        numbers = {"zero": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, "tau": 2 * np.pi}
        example = {"step": STEP, "gain": GAIN, "cutoff": CUTOFF_HZ, "creep": CREEP}
        literals = {key: self.dialect.literal(float(value)) for key, value in (numbers | example).items()}
        return {
            "name": self.name,
            "NAME": self.name.upper(),
            "title": comment(self.model.device.name),
            "real": self.dialect.real,
            "f": self.dialect.suffix,
            "n": len(self.model.device.active),
            "p": max(len(self.source.beta), 1),
            "k": self.generated.constants,
            "speed": f"{self.code.speed:g}",
            "verdict": self.source.verdict,
            **literals,
            **self._passive,
        }

    @cached_property
    def _passive(self) -> Mapping[str, object]:
        """Text about passive joints of loops that are not linear; empty where there are none."""
        count, real, n = len(self.code.passive), f"{self.name}_real", len(self.model.device.active)
        if not count:
            names = ("z", "qz", "z_declared", "qz_declared", "passive_count", "start")
            return dict.fromkeys((*names, *_IN_EXAMPLES), "")
        z = f"const {real} z[{count}], "
        return {
            "m": count,
            "segments": SEGMENTS,
            "z": "z, ",
            "qz": "q, z, ",
            "z_declared": z,
            "qz_declared": f"const {real} q[{n}], {z}",
            "passive_count": f"\n#define {self.name.upper()}_PASSIVE {count}",
            "start": f"{self.name}_start_q[i] + ",
            "start_q": self._numbers(start_pose(self.model)),
            "start_z": self._numbers(start_positions(self.model)),
            **{key: text.replace("@", self.name) for key, text in _IN_EXAMPLES.items()},
        }

    def _numbers(self, values: Array) -> str:
        """Entries of an array."""
        return ",\n".join(f"    {self.dialect.literal(float(value))}" for value in values)

    def filled(self, template: str, **values: object) -> str:
        """A template with its values; declarations that exceed WIDTH are wrapped."""
        text = resources.files("haptid.export").joinpath("templates", template).read_text(encoding="utf-8")
        filled = _Template(text).substitute(self.common, **values)
        return DECLARATION.sub(lambda found: wrapped([a.strip() for a in found[2].split(",")], found[1]), filled)

    def header(self) -> str:
        """Declarations, with units, limits, the verdict and the hashes of the data."""
        handle = self.filled("handle.h") if "handle_mobility" in self.code else ""
        loops = self.filled("loops.h") if self.code.passive else ""
        prototypes = "".join(f"{_about(function)}{self.signature(function)};\n\n" for function in self.code.functions)
        return self.filled(
            "model.h",
            about=_commented(comment(line) for line in about(self.source)),
            coordinates="\n".join(f" *   {line}" for line in coordinate_lines(self.model)),
            worst_case=_commented(worst_case_lines(self.code.graph, self.code.functions)),
            precision=self._precision(),
            parameters="\n".join(f" *   {line}" for line in self._parameter_lines()),
            prototypes=prototypes,
            handle=handle,
            loops=loops,
            elastic=self._elastic("elastic.h"),
        )

    def _precision(self) -> str:
        """Error bounds of single precision; empty in double precision."""
        if not self.bounds:
            return ""
        lines = single_precision_lines(self.source, self.code, self.settings, self.bounds)
        return _commented(["", *(line for long in lines for line in _folded(long))]) + "\n"

    def body(self) -> str:
        """Definitions."""
        beta = ",\n".join(f"    {float(value)!r}" for value in self.source.beta) or "    0.0"
        inverse = self.code.operations["inverse_dynamics"]
        return self.filled(
            "model.c",
            counts=f"inverse dynamics: {inverse.multiplications} multiplications, {inverse.additions} additions, "
            f"{inverse.trigonometric} sines and cosines",
            beta=beta,
            init=_indented(["(void)p;", *self.generated.init]),
            bodies="".join(self._definition(function) for function in self.code.functions),
            handle=self.filled("handle.c") if "handle_mobility" in self.code else "",
            loops=self.filled("loops.c") if self.code.passive else "",
            elastic=self._elastic("elastic.c"),
        )

    def _elastic(self, template: str) -> str:
        """The states of springs behind motors; empty where there are none."""
        if "springs" not in self.code:
            return ""
        own = torsion_places(self.model.device)
        return self.filled(template, springs=len(own), torsions=", ".join(map(str, own)))

    def signature(self, function: Function) -> str:
        """The function's declaration without the semicolon."""
        real = f"{self.name}_real"
        arguments = [f"const {self.name}_model *model"] if function.parameters else []
        arguments += [f"const {real} {name}[{size}]" for name, size in function.inputs]
        arguments += [f"{real} {name}[{len(values)}]" for name, values in function.outputs]
        start = f"{'int' if function.checks else 'void'} {self.name}_{function.name}("
        return wrapped(arguments, start)

    def _definition(self, function: Function) -> str:
        lines = list(self.generated.bodies[function.name])
        read = "\n".join(lines)
        idle = [name for name, _ in function.inputs if f"{name}[" not in read]
        idle += ["model"] if function.parameters and "model" not in read else []
        declared = [line for line in lines if line.startswith("const ")]
        rest = [line for line in lines if not line.startswith("const ")]
        body = [*declared, *(f"(void){name};" for name in idle), *rest]
        return f"\n{self.signature(function)}\n{{\n{_indented(body)}\n}}\n"

    def _parameter_lines(self) -> list[str]:
        base, lines = self.model.base, []
        for k, (name, unit, value) in enumerate(zip(base.names, base.units, self.source.beta, strict=True)):
            known = self.source.intervals
            interval = "" if known is None else f", 95 % interval {known[k, 0]:.6g} .. {known[k, 1]:.6g}"
            text = (
                "zero: eliminated, not read by the code" if k in self.source.zero else f"{value:.6g} {unit}{interval}"
            )
            lines.append(comment(f"p[{k}] {name}: {text}"))
        return lines


def comment(text: str) -> str:
    """Text on one line that cannot end a C comment, cut to WIDTH."""
    plain = c_comment(text)
    return plain if len(plain) <= _WIDTH else plain[: _WIDTH - 3] + "..."


def wrapped(arguments: Sequence[str], start: str) -> str:
    """start, arguments and a closing bracket, wrapped to WIDTH."""
    lines = _flowed(arguments, start)
    return "\n".join(lines if max(map(len, lines)) <= _WIDTH else [start, *_flowed(arguments, "    ")])


def _flowed(arguments: Sequence[str], start: str) -> list[str]:
    """Lines that are aligned to the end of start."""
    lines, line = [], start
    for k, argument in enumerate(arguments):
        piece = argument + (")" if k == len(arguments) - 1 else ",")
        gap = "" if line.endswith(("(", " ")) else " "
        if len(line) + len(gap) + len(piece) > _WIDTH and line.strip():
            lines.append(line)
            line, gap = " " * len(start), ""
        line += gap + piece
    return [*lines, line]


def _commented(lines: Iterable[str]) -> str:
    """Lines of a C comment."""
    return "\n".join(f" * {line}".rstrip() for line in lines)


def _folded(line: str) -> list[str]:
    """Lines of at most WIDTH, indented like the first."""
    inner = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.wrap(line, _WIDTH, subsequent_indent=inner) if len(line) > _WIDTH else [line]


def _about(function: Function) -> str:
    if len(function.about) == 1:
        return f"/* {function.about[0]} */\n"
    return "/*\n" + "".join(f" * {line}\n" for line in function.about) + " */\n"


def _indented(lines: Sequence[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
