"""Cells and arrays of structs in MAT 7.3 files, which are HDF5: datasets of references to each element's content."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from haptid.log.formats.signal_titles import NAMES, SAMPLES, UNITS, VALUES, title_of

# Longest cell or array of structs whose content is looked at, and longest text of a name or a unit.
_MOST_CELLS, _LONGEST = 200, 500
# The group in which MATLAB keeps what cells and arrays of structs refer to.
_CONTENT = "#refs#"


def matlab_class(item: Any) -> bytes:
    """Class that MATLAB wrote beside a dataset or a group; empty in other files."""
    found = item.attrs.get("MATLAB_class", b"")
    found = found.encode() if isinstance(found, str) else found
    return bytes(found) if isinstance(found, bytes) else b""


def referenced(dataset: Any) -> list[Any]:
    """What the references of a dataset lead to, in the order of MATLAB's elements row by row; none where it has none.

    Raises:
        ValueError: a reference leads nowhere.
    """
    if dataset.shape is None or not 0 < dataset.size <= _MOST_CELLS:
        return []
    if h5py.check_ref_dtype(dataset.dtype) is not h5py.Reference or "MATLAB_object_decode" in dataset.attrs:
        return []
    if _CONTENT not in dataset.file:  # of another program: to what has a name of its own
        return []
    return [dataset.file[reference] for reference in np.asarray(dataset).T.flat if reference]


def members(group: Any) -> dict[str, Any]:
    """What a group holds itself, by name; soft links, which may lead nowhere, and links to other files are left out."""
    own = [field for field in group if isinstance(group.get(field, getlink=True), h5py.HardLink)]
    return {str(field): group[field] for field in own}


def element_name(name: str, k: int, cells: list[Any], dataset: Any) -> str:
    """Name of element k, from 1: of a cell `runs[2]`, of a field of an array of structs `out.signals[2].values`."""
    struct, _, field = name.rpartition(".")
    if matlab_class(dataset) == b"cell":
        return f"{name}[{k}]"
    head = struct if len(cells) == 1 else f"{struct}[{k}]"
    return f"{head}.{field}" if struct else f"{field}[{k}]"


def titled_values(group: Any) -> dict[str, Any]:
    """The array of each struct by the name that a field says, as dSPACE and Simulink write it, with its unit.

    Empty where one has no such name of its own, or is more than one signal.
    """
    if not any(str(field).lower() in NAMES for field in group):
        return {}
    fields = {field.lower(): item for field, item in members(group).items()}
    elements = {low: cells for low, field in fields.items() if (cells := _elements(field))}
    made: dict[str, Any] = {}
    count = max(map(len, elements.values()), default=0)
    for k in range(count):
        own = {low: cells[k] for low, cells in elements.items() if k < len(cells)}
        arrays = {low: x for low, x in own.items() if isinstance(x, h5py.Dataset) and matlab_class(x) != b"char"}
        long = {low for low, x in arrays.items() if x.size is not None and x.size >= SAMPLES}
        nested = any(isinstance(x, h5py.Group) or matlab_class(x) == b"cell" for x in own.values())
        name = next((text_of(own[field]) for field in NAMES if field in own), "")
        unit = next((text_of(own[field]) for field in UNITS if field in own), "")
        if nested or len(long) != 1 or not long <= VALUES:
            return {}
        values = own[long.pop()]
        title = title_of(name, unit if values.size == max(values.shape) else "")
        if not title:
            return {}
        made[title] = values
    return made if len(made) == count else {}


def _elements(field: Any) -> list[Any]:
    """The field of each struct of an array; itself where there is one struct."""
    return (referenced(field) if isinstance(field, h5py.Dataset) else []) or [field]


def text_of(item: Any) -> str:
    """A text of MATLAB; empty for anything else."""
    if not isinstance(item, h5py.Dataset) or matlab_class(item) != b"char" or "MATLAB_empty" in item.attrs:
        return ""
    if not item.size or item.size > _LONGEST:
        return ""
    return np.asarray(item).astype("<u2").ravel().tobytes().decode("utf-16-le", errors="replace").strip()
