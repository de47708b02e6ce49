"""Rust export, `export_rust(model, folder)`: the functions of the C code as a `no_std` crate."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Unpack

from haptid.export.expressions.dialects import Rust
from haptid.export.expressions.emit import Emitted, Function, emitted
from haptid.export.model.functions import Code, code_for
from haptid.export.model.passive import start_pose, start_positions
from haptid.export.output import CCode, Export, write
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, about, coordinate_lines, provenance

CARGO = """[package]
name = "{name}"
version = "0.1.0"
edition = "2021"

[dependencies]
libm = "0.2"
"""
MODEL = """
/// Number of coordinates.
pub const COORDINATES: usize = {n};
/// Number of base parameters.
pub const PARAMETERS: usize = {p};

/// The base parameters as identified.
pub const BETA: [f64; PARAMETERS] = [
{beta}
];

/// Values precomputed from the base parameters.
#[derive(Clone, Copy, Debug)]
pub struct Model {{
    k: [f64; {k}],
}}

impl Model {{
    /// A model with base parameters `BETA`, or others.
    #[must_use]
    pub fn new(p: &[f64; PARAMETERS]) -> Self {{
        let mut k = [0.0; {k}];
{init}
        let _ = p;
        Self {{ k }}
    }}
}}
"""


def export_rust(
    identified: ExportSource, folder: str | Path, code: CCode | None = None, **criterion: Unpack[ExportCriterion]
) -> Export:
    """Write a model as a Rust crate for `no_std`: the same operations as in `export_c`; its only dependency is libm.

    Functions that solve linear systems return `None` where the matrix is singular or nearly so. The observer and the
    differentiator exist in C only.

    Args:
        identified, criterion: as in `export_c`.
        code: names and smoothing of friction; the crate is in double precision.
        folder: output folder of Cargo.toml and src/lib.rs.

    Raises:
        UnvalidatedModelError, ExportError, OutputFolderError: as in `export_c`.
    """
    source = provenance(identified, **criterion)
    made, name = code_for(source, code)
    texts = {
        "Cargo.toml": CARGO.format(name=name),
        "src/lib.rs": _library(source, made, emitted(made.graph, made.functions, Rust(), Rust())),
    }
    return write(folder, texts, source.verdict)


def _library(source: Provenance, code: Code, generated: Emitted) -> str:
    heading = [
        *about(source),
        "",
        "All values are SI. Matrices are row-major. Coordinates:",
        "",
        *coordinate_lines(source.model),
    ]
    documentation = "\n".join(f"//! {line}".rstrip() for line in heading)
    written = MODEL.format(
        n=len(source.model.device.active),
        p=len(source.beta),
        beta="\n".join(f"    {float(value)!r}," for value in source.beta),
        k=generated.constants,
        init=textwrap.indent("\n".join(generated.init), " " * 8),
    )
    written += _start(source) if code.passive else ""
    functions = "".join(_function(function, generated.bodies[function.name]) for function in code.functions)
    return f"{documentation}\n#![no_std]\n#![allow(clippy::all)]\n{written}{functions}"


def _start(source: Provenance) -> str:
    """Constants of the pose from which loops are followed."""
    q = start_pose(source.model)
    lines = []
    for name, about_it, values in (
        ("START_Q", "Coordinates of the pose from which loops are followed.", q),
        ("START_Z", "Positions of its passive joints: `before` of the first `close`.", start_positions(source.model)),
    ):
        entries = ", ".join(repr(float(value)) for value in values)
        lines.append(f"\n/// {about_it}\npub const {name}: [f64; {len(values)}] = [{entries}];\n")
    return "".join(lines)


def _function(function: Function, lines: tuple[str, ...]) -> str:
    arguments = ["model: &Model"] if function.parameters else []
    arguments += [f"{name}: &[f64; {size}]" for name, size in function.inputs]
    arrays = [f"[f64; {len(values)}]" for _, values in function.outputs]
    made = arrays[0] if len(arrays) == 1 else f"({', '.join(arrays)})"
    result = f"Option<{made}>" if function.checks else made
    text = "\n".join(lines)
    idle = [name for name, _ in function.inputs if f"{name}[" not in text]
    idle += ["model"] if function.parameters and "model" not in text else []
    body = textwrap.indent("\n".join([*(f"let _ = {name};" for name in idle), text]), " " * 4)
    comments = "\n".join(f"/// {line}" for line in function.about)
    named = f"/// Returns {', '.join(f'`{name}`' for name, _ in function.outputs)}."
    head = f"pub fn {function.name}({', '.join(arguments)}) -> {result} {{"
    return f"\n{comments}\n{named}\n#[must_use]\n{head}\n{body}\n}}\n"
