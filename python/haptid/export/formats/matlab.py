"""`export_matlab(model, folder)`: the functions of the C code for MATLAB and Octave, one file each."""

from __future__ import annotations

import re
from pathlib import Path

from haptid.export.expressions.dialects import Matlab
from haptid.export.expressions.emit import straight
from haptid.export.formats.c_source import coordinate_lines
from haptid.export.model.functions import Code, Function, code_of
from haptid.export.output import CCode, Export, default_name, write
from haptid.export.provenance import IdentifiedModel, Provenance, about, provenance
from haptid.validation.validation import Validation


def export_matlab(
    identified: IdentifiedModel,
    folder: str | Path,
    code: CCode | None = None,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
) -> Export:
    """Write a model as functions of MATLAB, which Octave reads too: the same operations as in `export_c`.

    Vectors are columns. Each function takes the base parameters as its last argument, the identified ones where it is
    left out. The sign of a velocity is smoothed as in the C code.

    Args:
        identified, validation, largest_error, anyway: as in `export_c`.
        code: names and where the sign of a velocity is smoothed; MATLAB has double precision alone.
        folder: where NAME_parameters.m, NAME_inverse_dynamics.m and so on go.

    Raises:
        FailedValidationError, UnvalidatedError: the model may not pass.
        UnexportableTermError: a term that code cannot compute.
        VaryingLoopError: loops that are not linear.
        OutputError: the folder cannot be written.
    """
    source = provenance(identified, validation, largest_error, anyway)
    code = code or CCode()
    made, name = (
        code_of(source.model, code.reversal_speed, source.zero),
        code.name or default_name(source.model.device.name),
    )
    texts = {f"{name}_parameters.m": _parameters(source, name)}
    texts |= {f"{name}_{function.name}.m": _function(made, function, name) for function in made.functions}
    return write(folder, texts, source.verdict)


def _parameters(source: Provenance, name: str) -> str:
    """The base parameters, with what is known of the model."""
    model, base = source.model, source.model.base
    lines = [f"function beta = {name}_parameters()", *(f"% {line}".rstrip() for line in about(source)), "%"]
    lines += ["% Coordinates:", *(f"% {_one_based(line)}" for line in coordinate_lines(model)), "beta = ["]
    rows = zip(base.names, base.units, source.beta, strict=True)
    lines += [f"    {float(value)!r}  % {parameter}, {unit}" for parameter, unit, value in rows]
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
    body = straight(code, function, Matlab(len(code.model.device.drives)))
    return "\n".join([*lines, *body, "end", ""])


def _one_based(line: str) -> str:
    """A line that begins with q[0], as MATLAB counts."""
    return re.sub(r"^q\[(\d+)\]", lambda found: f"q({int(found[1]) + 1})", line)
