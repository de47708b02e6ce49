"""MATLAB logs: MAT 5 and MAT 7.3, distinguished by their content; struct fields are joined by points."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import io

from haptid.log.formats import hdf5
from haptid.log.formats.sniff import (
    Budget,
    RawChannel,
    addresses,
    check_members,
    collect,
    corrupt,
    not_numeric,
    numeric,
    opened_file,
    require,
)

_KIND = "MAT"
HEADER_BYTES = 128
MI_COMPRESSED = 15


def names(path: Path) -> list[str]:
    """Names of the channels of all arrays of numbers, in structs too."""
    if require(path, _KIND, "MAT 5", "MAT 7.3", "HDF5") != "MAT 5":
        return hdf5.names(path)
    leaves = (leaf for name, value in _load(path, None).items() for leaf in _leaves(name, value))
    return [channel for name, array in leaves if numeric(array.dtype) for channel in addresses(name, array.shape)]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,); only their variables are read.

    Raises:
        LogFileError: a wanted variable holds texts, cells or complex numbers, or declares far more than is stored.
    """
    if require(path, _KIND, "MAT 5", "MAT 7.3", "HDF5") != "MAT 5":
        return hdf5.columns(path, wanted)
    return collect(wanted, _columns(path, wanted))


def _columns(path: Path, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    """One variable after the other, so that only one is in memory in addition to the collected channels."""
    for variable in dict.fromkeys(name.split(".")[0].split("[")[0] for name in wanted):
        leaves = (leaf for name, value in _load(path, [variable]).items() for leaf in _leaves(name, value))
        for name, array in leaves:
            found = addresses(name, array.shape) if numeric(array.dtype) else {}
            if name in wanted and not numeric(array.dtype):
                raise not_numeric(path, name, f"values of type {array.dtype}")
            yield from ((channel, array[index]) for channel, index in found.items() if channel in wanted)


def _load(path: Path, variables: list[str] | None) -> dict[str, Any]:
    """The named variables, or all."""
    with opened_file(path, _KIND):
        _check_elements(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a variable saved twice, an unknown class: not about the wanted ones
            loaded = io.loadmat(str(path), variable_names=variables, appendmat=False)
    return {name: value for name, value in loaded.items() if isinstance(name, str) and not name.startswith("__")}


def _leaves(name: str, value: object) -> Iterator[tuple[str, RawChannel]]:
    """Plain arrays with their full names; arrays of structs, objects and sparse matrices are left out."""
    if type(value) is not np.ndarray:
        return
    if value.dtype.names is None:
        yield name, value
    elif value.size == 1:
        for field in value.dtype.names:
            yield from _leaves(f"{name}.{field}", value.flat[0][field])


def _check_elements(path: Path) -> None:
    """Check the sizes of the file's elements without reading them.

    Source: MathWorks, MAT-File Format, Level 5: a header of 128 bytes, then elements of an 8-byte tag (type,
    bytes) and data; a compressed element holds one whole element, whose own tag declares its size.

    Raises:
        LogFileError: an element runs past the end of the file, or declares far more than is stored of it.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        if order is None:
            raise corrupt(path, _KIND, "its header is incomplete")
        at, count, budget = HEADER_BYTES, 0, Budget(path)
        while at < size:
            count += 1
            check_members(path, count, "variables")
            file.seek(at)
            tag = file.read(8)
            kind, stored = struct.unpack(f"{order}II", tag) if len(tag) == 8 else (0, size)
            if at + 8 + stored > size:
                raise corrupt(path, _KIND, f"the element at byte {at} runs past the end of the file")
            if kind == MI_COMPRESSED:
                inner = zlib.decompressobj().decompress(file.read(min(stored, 1024)), 8)
                declared = struct.unpack(f"{order}II", inner)[1]
                budget.take(f"the variable at byte {at}", declared)
            at += 8 + stored
