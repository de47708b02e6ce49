"""JSON export, `export_json(model, folder)`: the model for programs, with all information on its parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Unpack

import numpy as np

from haptid._core import __version__
from haptid._internal.arrays import Array
from haptid._internal.escaping import json_text
from haptid.dynamics.model import DynamicModel
from haptid.estimation.feasibility.feasible import feasible_parameters
from haptid.export.output import Export, default_name, write
from haptid.export.provenance import ExportCriterion, ExportSource, Provenance, provenance
from haptid.results.tables import device_file, finite

# Version of the format.
_SCHEMA = 1
NOTE = (
    "Of all bodies with these base parameters, those nearest to the prior; null if they are not physically consistent."
)


def export_json(identified: ExportSource, folder: str | Path, **criterion: Unpack[ExportCriterion]) -> Export:
    """Write a model as JSON: device file, coordinates, base parameters, regroupings, covariance.

    Args:
        identified, criterion: as in `export_c`.
        folder: output folder of NAME.json.

    Raises:
        UnvalidatedModelError, OutputFolderError: as in `export_c`.
    """
    source = provenance(identified, **criterion)
    text = json_text(finite(_model_values(source)))
    return write(folder, {f"{default_name(source.model.device.name)}.json": text}, source.verdict)


def _model_values(source: Provenance) -> dict[str, Any]:
    """The model as plain values, SI."""
    model, found = source.model, feasible_parameters(source.model, source.beta)
    standard = dict(zip(model.device.parameters.names, found.chi.tolist(), strict=True)) if found.ok else None
    return {
        "schema": _SCHEMA,
        "haptid": __version__,
        "device": model.device.name,
        "verdict": source.verdict,
        "uses": [use.model_dump() for use in source.uses],
        "data_sha256": list(source.hashes),
        "gravity": model.device.gravity.tolist(),
        "coordinates": _coordinates(model),
        "joints": _joints(model),
        "parameters": _parameters(source),
        "covariance": None if source.covariance is None else source.covariance.tolist(),
        "no_effect": list(model.base.no_effect),
        "standard": standard,
        "standard_note": NOTE,
        "device_file": device_file(model),
    }


def _parameters(source: Provenance) -> list[dict[str, Any]]:
    base = source.model.base
    return [
        {
            "name": name,
            "value": float(source.beta[k]),
            "unit": unit,
            "conf_int": None if source.intervals is None else source.intervals[k].tolist(),
            "grouping": base.groupings[k],
            "regroups": _nonzero(base.regrouping[k], base.standard),
        }
        for k, (name, unit) in enumerate(zip(base.names, base.units, strict=True))
    ]


def _nonzero(row: Array, names: tuple[str, ...]) -> dict[str, float]:
    return {names[k]: float(row[k]) for k in np.flatnonzero(row)}


def _coordinates(model: DynamicModel) -> list[dict[str, Any]]:
    """Coordinates of the torque rows, as combinations of the active joints' positions."""
    active = tuple(model.device.joints[j].name for j in model.device.active)
    return [
        {"label": label, "unit": unit, "torque_unit": torque, "joints": _nonzero(row, active)}
        for label, unit, torque, row in zip(
            model.device.row_labels,
            model.device.coordinate_units,
            model.device.torque_units,
            model.device.row_map,
            strict=True,
        )
    ]


def _joints(model: DynamicModel) -> list[dict[str, Any]]:
    """The tree: pose of a link = pose of its parent * (rotation, translation) * Rz(q) or Tz(q)."""
    return [
        {
            "name": joint.name,
            "alias": joint.alias or joint.name,
            "parent": "base" if joint.parent < 0 else model.device.joints[joint.parent].name,
            "prismatic": joint.prismatic,
            "active": j in model.device.active,
            "rotation": joint.rotation.tolist(),
            "translation": joint.translation.tolist(),
        }
        for j, joint in enumerate(model.device.joints)
    ]
