"""The files as text: templates filled with what the model says."""

from __future__ import annotations

import re
import string
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import numpy as np

from haptid.device import Motor
from haptid.dynamics.model import DynamicModel
from haptid.export.dialects import C
from haptid.export.emit import Emitted, emitted
from haptid.export.functions import Code, Function
from haptid.export.provenance import Provenance, about

# Widest line of a comment or a declaration, characters.
WIDTH = 116
# Declarations and heads of definitions in C.
DECLARATION = re.compile(r"^((?:\w+ )+\w+\()([^;(){}]*)\)(?=;|\n\{)", re.MULTILINE)
# What examples use, s, rad/s and Hz.
STEP, GAIN, CUTOFF_HZ, CREEP = 0.001, 40.0, 50.0, 1e-4


class _Template(string.Template):
    """@{name} stands for a value: $ and {} are common in what is written."""

    delimiter = "@"


@dataclass(frozen=True, eq=False)
class Files:
    """What all files of one model have in common.

    Attributes:
        source: the model.
        code: its functions.
        dialect: double or single precision.
        name: how all names in C begin.
    """

    source: Provenance
    code: Code
    dialect: C
    name: str

    @property
    def model(self) -> DynamicModel:
        return self.source.model

    @cached_property
    def generated(self) -> Emitted:
        return emitted(self.code, self.dialect)

    @cached_property
    def common(self) -> Mapping[str, object]:
        """Values that most templates use."""
        numbers = {"zero": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, "tau": 2 * np.pi}
        example = {"step": STEP, "gain": GAIN, "cutoff": CUTOFF_HZ, "creep": CREEP}
        literals = {key: self.dialect.literal(float(value)) for key, value in (numbers | example).items()}
        return {
            "name": self.name,
            "NAME": self.name.upper(),
            "title": comment(self.model.device.name),
            "real": self.dialect.real,
            "f": self.dialect.suffix,
            "n": len(self.model.device.drives),
            "p": max(len(self.source.beta), 1),
            "k": self.generated.constants,
            "speed": f"{self.code.speed:g}",
            "verdict": self.source.verdict,
            **literals,
        }

    def filled(self, template: str, **values: object) -> str:
        """A template of this package with its values; declarations on as many lines as the names ask for."""
        text = resources.files("haptid.export").joinpath("templates", template).read_text(encoding="utf-8")
        return narrowed(_Template(text).substitute(self.common, **values))

    def header(self) -> str:
        """Declarations, with units, limits, the verdict and the data's hashes."""
        handle = self.filled("handle.h") if "handle_mobility" in self.code else ""
        prototypes = "".join(f"{_about(function)}{self.signature(function)};\n\n" for function in self.code.functions)
        return self.filled(
            "model.h",
            about=self._about(),
            coordinates="\n".join(f" *   {line}" for line in coordinate_lines(self.model)),
            parameters="\n".join(f" *   {line}" for line in self._parameter_lines()),
            prototypes=prototypes,
            handle=handle,
        )

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
        )

    def signature(self, function: Function) -> str:
        """The function's declaration, without what ends it."""
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

    def _about(self) -> str:
        """First lines of the header."""
        return "\n".join(f" * {comment(line)}".rstrip() for line in about(self.source))

    def _parameter_lines(self) -> list[str]:
        base, lines = self.model.base, []
        for k, (name, unit, value) in enumerate(zip(base.names, base.units, self.source.beta, strict=True)):
            known = self.source.intervals
            within = "" if known is None else f", 95 % within {known[k, 0]:.6g} and {known[k, 1]:.6g}"
            said = (
                "zero: left out, and not read by the code" if k in self.source.zero else f"{value:.6g} {unit}{within}"
            )
            lines.append(comment(f"p[{k}] {name}: {said}"))
        return lines


def coordinate_lines(model: DynamicModel) -> list[str]:
    """What each coordinate is: its label, units, limits, and the command of its motor."""
    lines = []
    for k, (row, label) in enumerate(zip(model.device.row_map, model.device.row_labels, strict=True)):
        unit, torque = model.device.coordinate_units[k], model.device.torque_units[k]
        parts = [f"{label}, {unit}, {torque}"]
        moved = [(float(w), model.device.joints[j]) for w, j in zip(row, model.device.active, strict=True) if w]
        if len(moved) == 1 and moved[0][0] == 1.0:
            joint = moved[0][1]
            if joint.position_limits:
                parts.append(f"from {joint.position_limits[0]:.6g} to {joint.position_limits[1]:.6g} {unit}")
            if joint.velocity_limit:
                parts.append(f"at most {joint.velocity_limit:.6g} {unit}/s")
            if joint.torque_limit:
                parts.append(f"at most {joint.torque_limit:.6g} {torque}")
        else:
            parts.append(" ".join(f"{weight:+.6g} joint {joint.name}" for weight, joint in moved))
        drive = model.device.drives[k]
        if model.device.torque_rows == "motor" and drive.motorised:
            parts.append(_command(drive, torque))
        if not model.device.measured[k]:
            parts.append("no motor: known as far as other rows tell")
        lines += textwrap.wrap(_plain(f"q[{k}] {'; '.join(parts)}"), WIDTH - 4, subsequent_indent="     ")
    return lines


def _command(drive: Motor, torque: str) -> str:
    """How a torque becomes the motor's command."""
    factor = drive.gear * drive.gain
    if factor == 1.0 and drive.unit == torque:
        return "command = torque"
    return f"command in {drive.unit} = torque / ({factor:.9g} {torque} per {drive.unit})"


def _plain(text: str) -> str:
    """Text that cannot end a comment, on one line."""
    return " ".join(text.split()).replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def comment(text: str) -> str:
    """Text that cannot end a comment, on one line, no wider than a line."""
    plain = _plain(text)
    return plain if len(plain) <= WIDTH else plain[: WIDTH - 3] + "..."


def narrowed(text: str) -> str:
    """The same C with no declaration wider than a line."""
    return DECLARATION.sub(lambda found: wrapped([a.strip() for a in found[2].split(",")], found[1]), text)


def wrapped(arguments: Sequence[str], start: str) -> str:
    """start, arguments and a closing bracket, on as many lines as they need."""
    lines = _flowed(arguments, start)
    return "\n".join(lines if max(map(len, lines)) <= WIDTH else [start, *_flowed(arguments, "    ")])


def _flowed(arguments: Sequence[str], start: str) -> list[str]:
    """Lines under each other: as far to the right as start ends."""
    lines, line = [], start
    for k, argument in enumerate(arguments):
        piece = argument + (")" if k == len(arguments) - 1 else ",")
        gap = "" if line.endswith(("(", " ")) else " "
        if len(line) + len(gap) + len(piece) > WIDTH and line.strip():
            lines.append(line)
            line, gap = " " * len(start), ""
        line += gap + piece
    return [*lines, line]


def _about(function: Function) -> str:
    if len(function.about) == 1:
        return f"/* {function.about[0]} */\n"
    return "/*\n" + "".join(f" * {line}\n" for line in function.about) + " */\n"


def _indented(lines: Sequence[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
