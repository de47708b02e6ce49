"""`export_c(model, folder)`: a folder with the model in C99, its test and examples."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from haptid.export.expressions.dialects import DOUBLE, SINGLE
from haptid.export.expressions.graph import Operations
from haptid.export.formats.c_source import Files
from haptid.export.model.functions import Code, code_of
from haptid.export.output import CCode, default_name, write
from haptid.export.provenance import IdentifiedModel, provenance
from haptid.export.selftest import selftest
from haptid.validation.validation import Validation


@dataclass(frozen=True, eq=False)
class CExport:
    """What was written.

    Attributes:
        folder: where.
        files: names of the files in it.
        operations: what a call of each function costs.
        verdict: on unseen motion, as in the header.
    """

    folder: Path
    files: tuple[str, ...]
    operations: dict[str, Operations]
    verdict: str


def export_c(
    identified: IdentifiedModel,
    folder: str | Path,
    code: CCode | None = None,
    *,
    validation: Validation | None = None,
    largest_error: float | None = None,
    anyway: bool = False,
) -> CExport:
    """Write a model as C99 for a control loop: header, source, self-test, examples, CMakeLists.txt and README.md.

    Inverse dynamics, gravity, friction, mass matrix, forward dynamics, and with a handle its pose, Jacobian, mobility
    and force; the momentum observer and a differentiator. All but the observer and the differentiator are
    straight-line code. The coordinates are those of the device's torque rows. Functions that could never succeed are
    left out: forward dynamics of a coordinate without inertia, the force at a handle that does not move.

    Args:
        identified: an identification, an estimate, or a device and its base parameters.
        folder: where; files that are there already are replaced, and only if all goes well.
        code: names and precision.
        validation: of an estimate, on unseen motion; an identification has its own.
        largest_error: criterion, per cent; an identification has that of its study.
        anyway: write a model that fails its criterion or was not tested, and say so in the header.

    Raises:
        FailedValidationError, UnvalidatedError: the model may not pass.
        UnexportableTermError: a term that code cannot compute.
        VaryingLoopError: loops that are not linear.
        ShapeError: the base parameters are not as many as the device has.
        OutputError: the folder cannot be written.
    """
    code, folder = code or CCode(), Path(folder)
    source = provenance(identified, validation, largest_error, anyway)
    made = code_of(source.model, code.reversal_speed, source.zero)
    name = code.name or default_name(source.model.device.name)
    files = Files(source, made, SINGLE if code.precision == "single" else DOUBLE, name)
    written = write(folder, _texts(files), source.verdict)
    return CExport(folder, written.files, made.operations, source.verdict)


def _texts(files: Files) -> dict[str, str]:
    """Every file's name and content."""
    name = files.name
    return {
        f"{name}.h": files.header(),
        f"{name}.c": files.body(),
        f"{name}_selftest.c": selftest(files),
        f"{name}_example.c": files.filled("example.c"),
        f"{name}_ros2_control.cpp": files.filled("ros2_control.cpp"),
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
