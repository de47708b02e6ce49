"""Export of a model in several formats at once, by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

from haptid._internal.atomic_folder import publishing
from haptid._internal.extensions import extension, extension_names
from haptid.errors import SettingError, unknown_name
from haptid.export.formats.c import export_c
from haptid.export.formats.control_packages import export_chai3d, export_ros2_control
from haptid.export.formats.dvrk import export_dvrk
from haptid.export.formats.json import export_json
from haptid.export.formats.latex import export_latex
from haptid.export.formats.matlab import export_matlab
from haptid.export.formats.mjcf import export_mjcf
from haptid.export.formats.robot_file import export_into
from haptid.export.formats.rust import export_rust
from haptid.export.formats.urdf import export_urdf
from haptid.export.output import CCode, Export, Simulator
from haptid.export.provenance import ExportSource


class Exporter(Protocol):
    """Protocol of an exporter to a folder."""

    def __call__(self, identified: ExportSource, folder: Path, *, anyway: bool = False) -> Export: ...


class Coder(Protocol):
    """Protocol of an exporter of code to a folder."""

    def __call__(self, identified: ExportSource, folder: Path, code: CCode, *, anyway: bool = False) -> Export: ...


def _double(identified: ExportSource, folder: Path, code: CCode, *, anyway: bool = False) -> Export:
    return export_c(identified, folder, replace(code, precision="double"), anyway=anyway)


def _single(identified: ExportSource, folder: Path, code: CCode, *, anyway: bool = False) -> Export:
    return export_c(identified, folder, replace(code, precision="single"), anyway=anyway)


CODE: Mapping[str, Coder] = {
    "c": _double,
    "c-single": _single,
    "matlab": export_matlab,
    "rust": export_rust,
    "ros2-control": export_ros2_control,
    "chai3d": export_chai3d,
}
_OTHERS: Mapping[str, Exporter] = {
    "mjcf": export_mjcf,
    "urdf": export_urdf,
    "json": export_json,
    "latex": export_latex,
    "dvrk": export_dvrk,
}
EXPORTERS = (*CODE, *_OTHERS)


def export_formats() -> tuple[str, ...]:
    """Names of all formats: `EXPORTERS`, and those of installed extensions (`haptid.exports`)."""
    return (*EXPORTERS, *extension_names("haptid.exports"))


def export_model(
    identified: ExportSource,
    folder: str | Path,
    formats: Sequence[str],
    code: CCode | None = None,
    simulator: Simulator | None = None,
    *,
    into: str | Path | None = None,
    anyway: bool = False,
) -> dict[str, Export]:
    """Write a model in several formats, each in a subfolder of its name; all of them or none.

    Args:
        identified: as in `export_c`.
        folder: parent of these folders.
        formats: some of `export_formats()`.
        code: names and smoothing of code formats; the precision is that of the format.
        simulator: time step and contacts of an MJCF.
        into: a URDF or MJCF of the user, of which a copy gets the identified parameters, in place of a new one.
        anyway: export a model that fails its criterion or was not validated, with a note in the files.

    Raises:
        UnknownNameError: an unknown format.
        ExportError: the model cannot be written in one of the formats; see the exporters.
        OutputFolderError: the folder cannot be written.
    """
    others: dict[str, Exporter] = {**_OTHERS, "mjcf": partial(export_mjcf, simulator=simulator)}
    for name in formats:
        if name not in EXPORTERS:
            others[name] = _of_extension(name)
    if into is not None and not set(formats) <= {"urdf", "mjcf"}:
        raise SettingError(
            f"a robot description to write into goes with the formats urdf and mjcf, not with {', '.join(formats)}.",
            where="into",
            found=list(formats),
            limit=["urdf", "mjcf"],
            advice="Export the other formats in a call of their own.",
        )
    folder, code = Path(folder), code or CCode()
    made: dict[str, Export] = {}
    with publishing(folder) as scratch:
        for name in formats:
            if name in CODE:
                written = CODE[name](identified, scratch / name, code, anyway=anyway)
            elif into is not None:
                written = export_into(identified, scratch / name, into, name, anyway=anyway)
            else:
                written = others[name](identified, scratch / name, anyway=anyway)
            made[name] = Export(folder / name, written.files, written.verdict)
    return made


def _of_extension(name: str) -> Exporter:
    """The exporter that an installed package declares under a name.

    Raises:
        UnknownNameError: there is none.
        MissingDependencyError: it cannot be imported.
    """
    found: Exporter | None = extension("haptid.exports", name)
    if found is None:
        known = export_formats()
        raise unknown_name(f"there is no export format {name!r}.", name, known)
    return found
