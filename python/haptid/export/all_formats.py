"""All formats by their names, and several of them at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from haptid._internal.atomic_folder import publishing
from haptid.errors import ExportFormatError
from haptid.export.formats.c import export_c
from haptid.export.formats.json import export_json
from haptid.export.formats.latex import export_latex
from haptid.export.formats.matlab import export_matlab
from haptid.export.formats.mjcf import export_mjcf
from haptid.export.formats.rust import export_rust
from haptid.export.formats.urdf import export_urdf
from haptid.export.output import CCode, Export
from haptid.export.provenance import IdentifiedModel


class Exporter(Protocol):
    """Writes a model into a folder."""

    def __call__(self, identified: IdentifiedModel, folder: Path, *, anyway: bool = False) -> Export: ...


class Coder(Protocol):
    """Writes a model as code into a folder."""

    def __call__(self, identified: IdentifiedModel, folder: Path, code: CCode, *, anyway: bool = False) -> Export: ...


def _double(identified: IdentifiedModel, folder: Path, code: CCode, *, anyway: bool = False) -> Export:
    made = export_c(identified, folder, replace(code, precision="double"), anyway=anyway)
    return Export(made.folder, made.files, made.verdict)


def _single(identified: IdentifiedModel, folder: Path, code: CCode, *, anyway: bool = False) -> Export:
    made = export_c(identified, folder, replace(code, precision="single"), anyway=anyway)
    return Export(made.folder, made.files, made.verdict)


CODE: Mapping[str, Coder] = {"c": _double, "c-single": _single, "matlab": export_matlab, "rust": export_rust}
OTHERS: Mapping[str, Exporter] = {
    "mjcf": export_mjcf,
    "urdf": export_urdf,
    "json": export_json,
    "latex": export_latex,
}
FORMATS = (*CODE, *OTHERS)


def export(
    identified: IdentifiedModel,
    folder: str | Path,
    formats: Sequence[str],
    code: CCode | None = None,
    *,
    anyway: bool = False,
) -> dict[str, Export]:
    """Write a model in several formats, each into a folder of its name; all of them, or nothing.

    Args:
        identified: as in `export_c`.
        folder: where these folders go.
        formats: some of `FORMATS`.
        code: names and smoothing of the formats that are code; their precision is the format's.
        anyway: write a model that fails its criterion or was not tested, and say so in the files.

    Raises:
        ExportFormatError: there is no such format.
        ExportError: the model cannot be written in one of them; see the exporters.
        OutputError: the folder cannot be written.
    """
    for name in formats:
        if name not in FORMATS:
            raise ExportFormatError(name, FORMATS)
    folder, code = Path(folder), code or CCode()
    made: dict[str, Export] = {}
    with publishing(folder) as scratch:
        for name in formats:
            if name in CODE:
                written = CODE[name](identified, scratch / name, code, anyway=anyway)
            else:
                written = OTHERS[name](identified, scratch / name, anyway=anyway)
            made[name] = Export(folder / name, written.files, written.verdict)
    return made
