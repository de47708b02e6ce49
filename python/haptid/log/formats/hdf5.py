"""HDF5 logs, and MAT 7.3, which is HDF5: names of groups and structs are joined by points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from haptid.errors import LogFileError
from haptid.log.formats.sniff import (
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
# Classes of MATLAB that are stored as integers and are not numbers.
MATLAB_OTHER = frozenset({b"char", b"cell", b"logical", b"function_handle", b"struct"})


def names(path: Path) -> list[str]:
    """Names of the channels of all datasets of numbers."""
    require(path, _KIND, "HDF5", "MAT 7.3")
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        return [name for dataset in _datasets(file) for name in _channels(dataset)]


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
        places = {name: (dataset, at) for dataset in _datasets(file) for name, at in _channels(dataset).items()}
        return [np.asarray(dataset[_only(at, start, stop)]) for dataset, at in (places[name] for name in wanted)]


def _only(at: Address, start: int, stop: int) -> Address:
    """Index of rows start..stop of a channel."""
    return tuple(slice(start, stop) if isinstance(part, slice) else part for part in at)


def _columns(path: Path, file: h5py.File, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    budget = Budget(path)
    for dataset in _datasets(file):
        name, found = _flat(dataset), _channels(dataset)
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


def _datasets(file: h5py.File) -> list[Any]:
    """Every dataset of the file itself; links to other files are not followed."""
    found: list[Any] = []
    visited = 0

    def visit(name: str | bytes, item: object) -> None:
        nonlocal visited
        name = name if isinstance(name, str) else name.decode(errors="replace")  # bytes where it is no UTF-8
        visited += 1
        check_members(Path(file.filename), visited, "groups and datasets")
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            found.append(item)

    file.visititems(visit)
    return found


def _flat(dataset: Any) -> str:
    return str(dataset.name).strip("/").replace("/", ".")


def _numbers(dataset: Any) -> bool:
    matlab = dataset.attrs.get("MATLAB_class")  # bytes where MATLAB wrote it
    matlab = matlab.encode() if isinstance(matlab, str) else matlab
    if "MATLAB_object_decode" in dataset.attrs:
        return False  # a reference to an object, see `haptid.log.formats.mat`
    return numeric(dataset.dtype) and not (isinstance(matlab, bytes) and matlab in MATLAB_OTHER)


def _channels(dataset: Any) -> dict[str, Address]:
    if not _numbers(dataset) or dataset.shape is None or "MATLAB_empty" in dataset.attrs:
        return {}
    return addresses(_flat(dataset), dataset.shape)
