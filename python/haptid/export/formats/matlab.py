"""MATLAB export, `export_matlab(model, folder)`: the functions of the C code for MATLAB and Octave, one file each."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Unpack

from haptid._internal.escaping import one_line
from haptid.export.expressions.dialects import Matlab
from haptid.export.expressions.emit import Function, straight
from haptid.export.model.functions import Code, code_for
from haptid.export.model.passive import start_pose, start_positions
from haptid.export.output import CCode, Export, write
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, about, coordinate_lines, provenance


def export_matlab(
    identified: ExportSource, folder: str | Path, code: CCode | None = None, **criterion: Unpack[ExportCriterion]
) -> Export:
    """Write a model as MATLAB functions, which Octave reads too: the same operations as in `export_c`.

    Vectors are columns. The last argument of each function is the vector of base parameters, by default the identified
    ones. The sign of a velocity is smoothed as in the C code.

    Args:
        identified, criterion: as in `export_c`.
        code: names and smoothing of friction; MATLAB code is in double precision.
        folder: output folder of NAME_parameters.m, NAME_inverse_dynamics.m and so on.

    Raises:
        UnvalidatedModelError, ExportError, OutputFolderError: as in `export_c`.
    """
    source = provenance(identified, **criterion)
    made, name = code_for(source, code)
    texts = {f"{name}_parameters.m": _parameters(source, name)}
    texts |= {f"{name}_{function.name}.m": _function(made, function, name) for function in made.functions}
    if made.passive:
        texts[f"{name}_start.m"] = _start(source, name)
    return write(folder, texts, source.verdict)


def _start(source: Provenance, name: str) -> str:
    """The function of the pose from which loops are followed."""
    values = {"q": start_pose(source.model), "z": start_positions(source.model)}
    lines = [
        f"function [q, z] = {name}_start()",
        "% Pose from which loops are followed: coordinates, and positions of passive joints for the first close.",
        *(f"{x} = [{'; '.join(repr(float(value)) for value in each)}];" for x, each in values.items()),
    ]
    return "\n".join([*lines, "end", ""])


def _parameters(source: Provenance, name: str) -> str:
    """The function of the base parameters, with the heading."""
    model, base = source.model, source.model.base
    lines = [f"function beta = {name}_parameters()", *(f"% {line}".rstrip() for line in about(source)), "%"]
    lines += ["% Coordinates:", *(f"% {_one_based(line)}" for line in coordinate_lines(model)), "beta = ["]
    rows = zip(base.names, base.units, source.beta, strict=True)
    lines += [f"    {float(value)!r}  % {parameter}, {one_line(unit)}" for parameter, unit, value in rows]
    return "\n".join([*lines, "];", "end", ""])


def _function(code: Code, function: Function, name: str) -> str:
    inputs = [text for text, _ in function.inputs]
    outputs = [text for text, _ in function.outputs]
    made = outputs[0] if len(outputs) == 1 else f"[{', '.join(outputs)}]"
    arguments = [*inputs, "beta"] if function.parameters else inputs
    lines = [f"function {made} = {name}_{function.name}({', '.join(arguments)})"]
    lines += [f"% {line}" for line in function.about]
    if function.parameters:
        lines.append(f"if nargin < {len(arguments)}, beta = {name}_parameters(); end")
    body = straight(code.graph, function, Matlab(len(code.model.device.active)))
    return "\n".join([*lines, *body, "end", ""])


def _one_based(line: str) -> str:
    """A line that begins with q[0] with MATLAB's one-based index."""
    return re.sub(r"^q\[(\d+)\]", lambda found: f"q({int(found[1]) + 1})", line)
