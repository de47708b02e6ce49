"""Export of an identified model: code for control loops, robot descriptions for simulators, tables for papers.

`expressions` is symbolic algebra, `model` builds the dynamics in it, `formats` writes the files. It may import
everything up to `results`.
"""

from haptid.export.all_formats import EXPORTERS, Exporter, export_formats, export_model
from haptid.export.expressions.graph import Operations
from haptid.export.formats.c import CExport, export_c
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
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, provenance

__all__ = [
    "EXPORTERS",
    "CCode",
    "CExport",
    "Export",
    "ExportCriterion",
    "ExportSource",
    "Exporter",
    "Operations",
    "Provenance",
    "Simulator",
    "export_c",
    "export_chai3d",
    "export_dvrk",
    "export_formats",
    "export_into",
    "export_json",
    "export_latex",
    "export_matlab",
    "export_mjcf",
    "export_model",
    "export_ros2_control",
    "export_rust",
    "export_urdf",
    "provenance",
]
