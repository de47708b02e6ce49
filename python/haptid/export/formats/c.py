"""C99 export, `export_c(model, folder)`: the model, its self-test and examples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from haptid.export.expressions.dialects import DOUBLE, SINGLE
from haptid.export.expressions.graph import Operations
from haptid.export.formats.c_source import Files
from haptid.export.model.functions import Code, code_of
from haptid.export.output import CCode, Export, default_name, write
from haptid.export.provenance import ExportSource, provenance
from haptid.export.selftest import selftest
from haptid.validation.validation import Validation


@dataclass(frozen=True)
class CExport(Export):
    """Written C code.

    Attributes:
        operations: operation count of one call of each function.
    """

    operations: dict[str, Operations]


def export_c(
    identified: ExportSource,
    folder: str | Path,
    code: CCode | None = None,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
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
        validation: of an estimate, on unseen motion; an identification has its own.
        largest_error: criterion, per cent; an identification has that of its study.
        anyway: export a model that fails its criterion or was not validated, with a note in the header.

    Raises:
        UnvalidatedModelError: the model does not meet its validation criterion.
        ExportError: a term that code cannot compute.
        ShapeError: the number of base parameters is not that of the device.
        OutputFolderError: the folder cannot be written.
    """
    code = code or CCode()
    source = provenance(identified, validation, largest_error, anyway)
    made = code_of(source.model, code.reversal_speed, source.zero)
    name = code.name or default_name(source.model.device.name)
    files = Files(source, made, SINGLE if code.precision == "single" else DOUBLE, name)
    written = write(folder, _texts(files), source.verdict)
    return CExport(written.folder, written.files, written.verdict, made.operations)


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
            fitness="".join(f"\n\n{said}" for said in files.source.fitness),
            table="\n".join(_rows(files.code)),
        ),
    }


def _rows(code: Code) -> list[str]:
    return [
        f"| `{name}` | {found.multiplications} | {found.additions} | {found.divisions} | {found.trigonometric} | "
        f"{found.others} |"
        for name, found in code.operations.items()
    ]
