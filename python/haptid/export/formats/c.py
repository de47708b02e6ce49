"""C99 export, `export_c(model, folder)`: the model, its self-test and examples."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Unpack

from haptid._internal.late import dataclass
from haptid.export.expressions.dialects import DOUBLE, SINGLE
from haptid.export.expressions.graph import Operations
from haptid.export.formats.c_source import Files
from haptid.export.model.functions import Code
from haptid.export.output import CCode, Export, write
from haptid.export.provenance import ExportCriterion, ExportSource, provenance
from haptid.export.selftest import selftest


@dataclass(frozen=True)
class CExport(Export):
    """Written C code.

    Attributes:
        operations: operation count of one call of each function.
        error_bounds: in single precision the largest differences of each function's outputs from double precision, by
            their names, for the ranges in the header; infinite where none is known. Empty in double precision.
    """

    operations: dict[str, Operations]
    error_bounds: Mapping[str, Mapping[str, tuple[float, ...]]]


def export_c(
    identified: ExportSource, folder: str | Path, code: CCode | None = None, **criterion: Unpack[ExportCriterion]
) -> CExport:
    """Write a model as C99 for a control loop: header, source, self-test, examples, CMakeLists.txt and README.md.

    Inverse dynamics, gravity, friction, mass matrix, forward dynamics, and with a handle its pose, Jacobian,
    mobility and force; the momentum observer and a differentiator. All but the observer and the differentiator are
    straight-line code. Positions of passive joints of loops that are not linear are found by a fixed number of
    Newton steps at each sample, and are an input of the other functions. The coordinates are those of the device's
    torque rows. Functions that are singular in every pose are left out: forward dynamics of a coordinate without
    inertia, the force at a handle that cannot move.

    Args:
        identified: an identification, a result, an estimate, or a dynamic model and its base parameters.
        folder: output folder; existing files are replaced, atomically.
        code: names, precision and smoothing of friction.
        criterion: validation, largest_error, anyway; see `ExportCriterion`.

    Raises:
        UnvalidatedModelError: the model does not meet its validation criterion.
        ExportError: a term that code cannot compute.
        ShapeError: the number of base parameters is not that of the device.
        OutputFolderError: the folder cannot be written.
    """
    single = code is not None and code.precision == "single"
    files = Files.of(provenance(identified, **criterion), code, SINGLE if single else DOUBLE)
    written = write(folder, _texts(files), files.source.verdict)
    return CExport(written.folder, written.files, written.verdict, files.code.operations, files.bounds)


def _texts(files: Files) -> dict[str, str]:
    """Name and content of every file."""
    name = files.name
    return {
        f"{name}.h": files.header(),
        f"{name}.c": files.body(),
        f"{name}_selftest.c": selftest(files),
        f"{name}_example.c": files.filled("example.c"),
        "CMakeLists.txt": files.filled("CMakeLists.txt"),
        "README.md": files.filled(
            "README.md",
            fitness="".join(f"\n\n{sentence}" for sentence in files.source.fitness),
            table="\n".join(_rows(files.code)),
        ),
    }


def _rows(code: Code) -> list[str]:
    return [
        f"| `{name}` | {found.multiplications} | {found.additions} | {found.divisions} | {found.trigonometric} | "
        f"{found.others} |"
        for name, found in code.operations.items()
    ]
