"""All formats by their names, and several of them at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from haptid.errors import ExportFormatError
from haptid.export.folder import Export
from haptid.export.latex import export_latex
from haptid.export.matlab import export_matlab
from haptid.export.mjcf import export_mjcf
from haptid.export.model_json import export_json
from haptid.export.provenance import Model
from haptid.export.rust import export_rust
from haptid.export.urdf import export_urdf
from haptid.export.writing import CCode, export_c
from haptid.outputs import publishing


class Exporter(Protocol):
    """Writes a model into a folder."""

    def __call__(self, model: Model, folder: Path, *, anyway: bool = False) -> Export: ...


def _c(model: Model, folder: Path, *, anyway: bool = False) -> Export:
    made = export_c(model, folder, anyway=anyway)
    return Export(made.folder, made.files, made.verdict)


def _single(model: Model, folder: Path, *, anyway: bool = False) -> Export:
    made = export_c(model, folder, CCode(precision="single"), anyway=anyway)
    return Export(made.folder, made.files, made.verdict)


FORMATS: Mapping[str, Exporter] = {
    "c": _c,
    "c-single": _single,
    "mjcf": export_mjcf,
    "urdf": export_urdf,
    "json": export_json,
    "latex": export_latex,
    "matlab": export_matlab,
    "rust": export_rust,
}


def export(model: Model, folder: str | Path, formats: Sequence[str], *, anyway: bool = False) -> dict[str, Export]:
    """Write a model in several formats, each into a folder of its name; all of them, or nothing.

    Args:
        model: as in `export_c`.
        folder: where these folders go.
        formats: some of `FORMATS`.
        anyway: write a model that fails its criterion or was not tested, and say so in the files.

    Raises:
        ExportFormatError: there is no such format.
        ExportError: the model cannot be written in one of them; see the exporters.
        OutputError: the folder cannot be written.
    """
    for name in formats:
        if name not in FORMATS:
            raise ExportFormatError(name, FORMATS)
    folder = Path(folder)
    made: dict[str, Export] = {}
    with publishing(folder) as scratch:
        for name in formats:
            written = FORMATS[name](model, scratch / name, anyway=anyway)
            made[name] = Export(folder / name, written.files, written.verdict)
    return made
