"""Files that other programs read: a model as code for a control loop, for simulators, and for papers."""

from haptid.export.folder import Export
from haptid.export.formats import FORMATS, export
from haptid.export.graph import Operations
from haptid.export.latex import export_latex
from haptid.export.matlab import export_matlab
from haptid.export.mjcf import export_mjcf
from haptid.export.model_json import export_json
from haptid.export.rust import export_rust
from haptid.export.settings import CCode
from haptid.export.urdf import export_urdf
from haptid.export.writing import CExport, export_c

__all__ = [
    "FORMATS",
    "CCode",
    "CExport",
    "Export",
    "Operations",
    "export",
    "export_c",
    "export_json",
    "export_latex",
    "export_matlab",
    "export_mjcf",
    "export_rust",
    "export_urdf",
]
