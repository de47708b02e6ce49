"""HDF5 logs, and MAT 7.3, which is HDF5: names of groups and structs are joined by points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from haptid.errors import LogFileError
from haptid.log.formats.matlab_references import (
    element_name,
    matlab_class,
    members,
    referenced,
    text_of,
    titled_values,
)
from haptid.log.formats.sniff import (
    MOST_CHANNELS,
    Address,
    Budget,
    RawChannel,
    addresses,
    check_members,
    collect,
    not_numeric,
    numeric,
    opened_file,
    require,
)

_KIND = "HDF5"
_DEEPEST = 12
# Classes of MATLAB that are stored as integers and are not numbers.
MATLAB_OTHER = frozenset({b"char", b"cell", b"logical", b"function_handle", b"struct"})


def names(path: Path) -> list[str]:
    """Names of the channels of all datasets of numbers."""
    require(path, _KIND, "HDF5", "MAT 7.3")
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        return [own for name, dataset in _datasets(file).items() for own in _channels(name, dataset)]


def units(path: Path) -> dict[str, str]:
    """Units that attributes of datasets state."""
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        every = _datasets(file).items()
        return {own: unit for name, data in every if (unit := _unit(data)) for own in _channels(name, data)}


def _unit(dataset: Any) -> str:
    """The text of an attribute that is called a unit; empty where there is none."""
    for name in ("unit", "units", "Unit", "Units", "UNIT"):
        stated = dataset.attrs.get(name) if name in dataset.attrs else None
        if isinstance(stated, np.ndarray) and stated.size == 1:
            stated = stated.item()
        if isinstance(stated, bytes):
            stated = stated.decode(errors="replace")
        if isinstance(stated, str):
            return stated.strip()
    return ""


def beside(path: Path) -> dict[str, RawChannel]:
    """Lists of texts and single numbers beside the samples, in datasets or in attributes, each (n,)."""
    found: dict[str, RawChannel] = {}
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        owners: dict[str, Any] = {"": file}
        file.visititems(lambda name, item: owners.update({str(name).strip("/").replace("/", "."): item}))
        for name, dataset in _datasets(file, numbered=True).items():
            if text := text_of(dataset):
                found[name] = np.array([text])
            elif isinstance(dataset, h5py.Dataset) and _is_beside(dataset):
                with suppress(OSError):  # behind a filter that is not here, or damaged: no sample is
                    found[name] = _listed(dataset[()])
        for name, owner in owners.items():
            for key in owner.attrs:
                # Attributes of types that HDF5 has and NumPy has not cannot be read, and are none of these.
                with suppress(OSError, TypeError, ValueError, KeyError, RuntimeError):
                    if not key.startswith("MATLAB"):
                        found.setdefault(f"{name}.{key}" if name else key, _listed(owner.attrs[key]))
    return {name: values for name, values in found.items() if values.size and not name.startswith("#")}


def _is_beside(dataset: Any) -> bool:
    """Whether a dataset is a list of texts or one number, and in the file itself."""
    if dataset.shape is None or dataset.external or dataset.is_virtual or dataset.size > MOST_CHANNELS:
        return False
    return h5py.check_string_dtype(dataset.dtype) is not None or (numeric(dataset.dtype) and dataset.size == 1)


def _listed(value: Any) -> RawChannel:
    """A few texts, or one number, as an array (n,); empty for anything else."""
    values = np.atleast_1d(np.asarray(value)).ravel()
    if values.dtype.kind in "OS" and values.size <= MOST_CHANNELS:
        texts = [x.decode(errors="replace") if isinstance(x, bytes) else x for x in values]
        return np.array(texts) if all(isinstance(x, str) for x in texts) else np.empty(0)
    return values if values.dtype.kind == "U" or (numeric(values.dtype) and values.size == 1) else np.empty(0)


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,), read one after the other.

    MATLAB writes its arrays transposed; since channels run along the shorter side of an array, their names
    are the same as in a MAT 5 file.

    Raises:
        LogFileError: a wanted dataset holds texts, objects or records, is a view of another file, or declares far more
            than is stored of it.
    """
    require(path, _KIND, "HDF5", "MAT 7.3")
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        return collect(wanted, _columns(path, file, wanted))


def rows(path: Path, wanted: Sequence[str], start: int, stop: int) -> list[RawChannel]:
    """Rows start..stop of channels, each (stop - start,)."""
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        every = _datasets(file, numbered=True)
        places = {own: (dataset, at) for name, dataset in every.items() for own, at in _channels(name, dataset).items()}
        return [np.asarray(dataset[_only(at, start, stop)]) for dataset, at in (places[name] for name in wanted)]


def _only(at: Address, start: int, stop: int) -> Address:
    """Index of rows start..stop of a channel."""
    return tuple(slice(start, stop) if isinstance(part, slice) else part for part in at)


def _columns(path: Path, file: h5py.File, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    budget = Budget(path)
    for name, dataset in _datasets(file, numbered=True).items():
        found = _channels(name, dataset)
        requested = [w for w in wanted if w in found or w == name]
        if not requested:
            continue
        if not _numbers(dataset):
            raise not_numeric(path, name, f"values of type {dataset.dtype}")
        if dataset.external or dataset.is_virtual:
            raise LogFileError(
                f"{path}: the samples of {name} are in another file, which the SHA-256 of this one does not cover.",
                where=name,
                advice="Store the samples in the file itself.",
            )
        budget.take(f"dataset {name!r}", dataset.size * dataset.dtype.itemsize)
        yield from ((w, np.asarray(dataset[found[w]])) for w in requested if w in found)


def _datasets(file: h5py.File, numbered: bool = False) -> dict[str, Any]:
    """Every dataset of the file itself by its full name; links to other files are not followed.

    Cells and arrays of structs of MATLAB are references to their content, `out.signals[2].values` as in a MAT 5 file;
    those of structs that say a name of their array have it, `out.signals.q1 [rad]`.

    Args:
        numbered: whether the latter are also there by their number.
    """
    found: dict[str, Any] = {}
    visited, groups = 0, list[str]()

    def count() -> None:
        nonlocal visited
        visited += 1
        check_members(Path(file.filename), visited, "groups and datasets")

    def visit(name: str | bytes, item: object) -> None:
        name = name if isinstance(name, str) else name.decode(errors="replace")  # bytes where it is no UTF-8
        count()
        name = name.strip("/").replace("/", ".")
        if not name.startswith(("#", *(f"{group}." for group in groups))):
            add(name, item, 0)

    def add(name: str, item: object, depth: int) -> None:
        if isinstance(item, h5py.Group) and (titles := titled_values(item)):
            groups.extend([] if numbered else [name])
            found.update({f"{name}.{title}": values for title, values in titles.items()})
        elif isinstance(item, h5py.Dataset):
            cells = referenced(item) if depth < _DEEPEST else []
            if not cells:
                found.update({own: found.get(own, part) for own, part in _fields(name, item).items()})
            for k, cell in enumerate(cells, 1):
                count()
                own = element_name(name, k, cells, item)
                add(own, cell, depth + 1)
                for field, inner in members(cell).items() if isinstance(cell, h5py.Group) else ():
                    add(f"{own}.{field}", inner, depth + 1)

    file.visititems(visit)
    return found


class _Field:
    """A field of a dataset of records, as a dataset of its own; attributes, which are of all fields, are left out.

    Attributes:
        shape: of the records, then of the field.
    """

    def __init__(self, records: Any, name: str) -> None:
        inner = records.dtype[name]
        self.records, self.name = records, name
        self.dtype, self.shape = inner.base, (*records.shape, *inner.shape)
        self.size = int(np.prod(self.shape))
        self.attrs: dict[str, Any] = {}
        self.external, self.is_virtual = records.external, records.is_virtual

    def __getitem__(self, at: Address) -> Any:
        depth = len(self.records.shape)
        found, inner = self.records.fields(self.name)[at[:depth]], at[depth:]
        return found[(..., *inner)] if inner else found


def _fields(name: str, dataset: Any) -> dict[str, Any]:
    """A dataset, or the fields of one of records by their full names; complex numbers of MATLAB are no records."""
    fields = dataset.dtype.names
    if not fields or dataset.shape is None or set(fields) <= {"real", "imag"} or matlab_class(dataset):
        return {name: dataset}
    return {f"{name}.{field}": _Field(dataset, field) for field in fields}


def _numbers(dataset: Any) -> bool:
    matlab = matlab_class(dataset)
    if "MATLAB_object_decode" in dataset.attrs:
        return False  # a reference to an object, see `haptid.log.formats.mat`
    return numeric(dataset.dtype) and matlab not in MATLAB_OTHER


def _channels(name: str, dataset: Any) -> dict[str, Address]:
    if not _numbers(dataset) or dataset.shape is None or "MATLAB_empty" in dataset.attrs:
        return {}
    return addresses(name, dataset.shape)
