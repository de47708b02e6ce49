"""Files that other programs read: a model as C99 for a control loop."""

from haptid.export.graph import Operations
from haptid.export.writing import CCode, CExport, export_c

__all__ = ["CCode", "CExport", "Operations", "export_c"]
