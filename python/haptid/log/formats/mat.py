"""MATLAB logs: MAT 4, 5 and 7.3, distinguished by their content; struct fields are joined by points."""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
from scipy import io
from scipy.io.matlab import MatlabObject

from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.formats import hdf5, mat4
from haptid.log.formats.iddata import iddata_leaves, is_iddata
from haptid.log.formats.mat_objects import objects, unread
from haptid.log.formats.signal_titles import NAMES, SAMPLES, UNITS, VALUES, title_of
from haptid.log.formats.sniff import (
    MOST_CHANNELS,
    Budget,
    RawChannel,
    addresses,
    check_members,
    collect,
    content,
    corrupt,
    not_numeric,
    numeric,
    opened_file,
    require,
)

_KIND = "MAT"
_VERSIONS = ("MAT 4", "MAT 5", "MAT 7.3", "HDF5")
HEADER_BYTES = 128
MI_COMPRESSED = 15


def names(path: Path) -> list[str]:
    """Names of the channels of all arrays of numbers, in structs and objects too.

    Raises:
        LogFileError: it has objects, none of which is read, and no arrays.
        MissingDependencyError: it has objects and no arrays, and the package that reads them is not installed.
    """
    kind = require(path, _KIND, *_VERSIONS)
    if kind == "MAT 4":
        return mat4.names(path)
    if kind != "MAT 5":
        found = hdf5.names(path)
    else:
        leaves = (leaf for name, value in _load(path, None).items() for leaf in _leaves(name, value, titled=True))
        found = [channel for name, array in leaves if numeric(array.dtype) for channel in addresses(name, array.shape)]
    if not _has_objects(path):
        return found
    try:
        found += objects(path)
    except (LogFileError, MissingDependencyError):
        if not found:
            raise
    if not found:
        raise unread(path)
    return found


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,); only their variables are read.

    Raises:
        LogFileError: a wanted variable holds texts, cells or complex numbers, or declares far more than is stored.
        MissingDependencyError: one is not found among the arrays, and the file has objects.
    """
    kind = require(path, _KIND, *_VERSIONS)
    if kind == "MAT 4":
        return mat4.columns(path, wanted)
    plain = kind == "MAT 5"
    with_objects = _has_objects(path)
    try:
        found = collect(wanted, _columns(path, wanted)) if plain else hdf5.columns(path, wanted)
    except LogFileError:
        if not with_objects:  # the arrays of an object look like others
            raise
        found = {}
    if with_objects and not found.keys() >= set(wanted):
        try:
            found |= objects(path)
        except LogFileError:
            names(path)  # which raises it too where there is no other channel
    return {name: found[name] for name in wanted if name in found}


def beside(path: Path) -> dict[str, RawChannel]:
    """Lists of texts and single numbers beside the samples, each (n,)."""
    kind = require(path, _KIND, *_VERSIONS)
    if kind in ("MAT 7.3", "HDF5"):
        return hdf5.beside(path)
    if kind == "MAT 4":
        return mat4.beside(path)
    leaves = (leaf for name, value in _load(path, None).items() for leaf in _leaves(name, value, titled=False))
    return {
        name: array.ravel()
        for name, array in leaves
        if array.size <= MOST_CHANNELS and (array.dtype.kind == "U" or (array.size == 1 and numeric(array.dtype)))
    }


def _has_objects(path: Path) -> bool:
    """Whether the file has a subsystem, in which MATLAB stores tables and other objects."""
    if content(path) == "MAT 5":
        with path.open("rb") as file:
            return file.read(HEADER_BYTES)[116:124] not in (b"\0" * 8, b" " * 8)
    with opened_file(path, _KIND), h5py.File(path, "r", locking=False) as file:
        return "#subsystem#" in file


def _columns(path: Path, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    """One variable after the other, so that only one is in memory in addition to the collected channels."""
    for variable in dict.fromkeys(name.split(".")[0].split("[")[0] for name in wanted):
        loaded = _load(path, [variable]).items()
        leaves = (leaf for name, value in loaded for titled in (True, False) for leaf in _leaves(name, value, titled))
        for name, array in leaves:
            found = addresses(name, array.shape) if numeric(array.dtype) else {}
            if name in wanted and not numeric(array.dtype):
                raise not_numeric(path, name, f"values of type {array.dtype}")
            yield from ((channel, array[index]) for channel, index in found.items() if channel in wanted)


def _load(path: Path, variables: list[str] | None) -> dict[str, Any]:
    """The named variables, or all."""
    with opened_file(path, _KIND):
        _check_elements(path)
        _check_types(path, path.stat().st_mtime_ns)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a variable saved twice, an unknown class: not about the wanted ones
            loaded = io.loadmat(str(path), variable_names=variables, appendmat=False)
    return {name: value for name, value in loaded.items() if isinstance(name, str) and not name.startswith("__")}


def _leaves(name: str, value: object, titled: bool) -> Iterator[tuple[str, RawChannel]]:
    """Plain arrays with their full names, `out.signals[2].values` in an array of structs; objects are left out.

    Args:
        titled: whether those of structs that say a name of their array have it, `out.signals.q1 [rad]`.
    """
    if isinstance(value, MatlabObject):  # of a class of files of level 5, as those of toolboxes
        value = np.asarray(value)
        if is_iddata(value):
            yield from iddata_leaves(name, value)
            return
    if type(value) is not np.ndarray:
        return
    if value.dtype == object:
        if value.size <= _MOST_STRUCTS:  # a cell array, as of trials
            for k, cell in enumerate(value.flat, 1):
                yield from _leaves(f"{name}[{k}]", cell, titled)
        elif (rows := _stacked(value.flat)) is not None:
            yield name, rows
    elif value.dtype.names is None:
        yield name, value
    elif titled and (own := _titled(value)):
        yield from ((f"{name}.{title}", array) for title, array in own.items())
    elif value.size == 1:
        for field in value.dtype.names:
            yield from _leaves(f"{name}.{field}", value.flat[0][field], titled)
    elif value.size <= _MOST_STRUCTS:  # as the signals of a structure with time
        for k, one in enumerate(value.flat, 1):
            for field in value.dtype.names:
                yield from _leaves(f"{name}[{k}].{field}", one[field], titled)
    else:  # a struct for each sample
        for field in value.dtype.names:
            if (rows := _stacked(value[field].flat)) is not None:
                yield f"{name}.{field}", rows


def _titled(structs: np.ndarray) -> dict[str, RawChannel]:
    """The array of each struct by the name that a field says, as dSPACE and Simulink write it, with its unit.

    Empty where one has no such name of its own, or is more than one signal: it holds structs or cells, or arrays beside
    that of its values. Columns of a vector signal have no unit, which is written behind the name of one.
    """
    fields = {field.lower(): field for field in structs.dtype.names or ()}
    key = next((fields[field] for field in NAMES if field in fields), None)
    made: dict[str, RawChannel] = {}
    for one in structs.flat if key and structs.size <= _MOST_STRUCTS else ():
        arrays = {low: one[field] for low, field in fields.items() if getattr(one[field], "size", 0)}
        long = {low: array for low, array in arrays.items() if numeric(array.dtype) and array.size >= SAMPLES}
        unit = next((_text(one[fields[field]]) for field in UNITS if field in fields), "")
        nested = any(array.dtype.names is not None or array.dtype == object for array in arrays.values())
        if nested or len(long) != 1 or not long.keys() <= VALUES:
            return {}
        ((_, values),) = long.items()
        title = title_of(_text(one[key]), unit if values.size == max(values.shape) else "")
        if not title:
            return {}
        made[title] = values
    return made if len(made) == structs.size else {}


def _text(value: object) -> str:
    """A text of MATLAB; empty for anything else."""
    return str(value.flat[0]).strip() if type(value) is np.ndarray and value.dtype.kind == "U" and value.size else ""


def _stacked(cells: Iterable[object]) -> RawChannel | None:
    """The arrays of a cell or a field of each sample as rows, (samples, elements); None where they are not alike."""
    found = [cell for cell in cells if type(cell) is np.ndarray and numeric(cell.dtype)]
    sizes = {cell.size for cell in found}
    if len(sizes) != 1 or 0 in sizes or len(found) < _MOST_STRUCTS:
        return None
    return np.stack([cell.ravel() for cell in found])


# Longest array of structs or cells whose content is channels.
_MOST_STRUCTS = 200
# Types of data elements; an array; classes of arrays that hold arrays, and the last class.
_TYPES, MI_MATRIX = frozenset((*range(1, 8), 9, *range(12, 19))), 14
_NESTED, _LAST_CLASS, _OPAQUE = (1, 2, 3, 16, 17), 18, 17
# Classes of cells, structs and objects, which declare how many arrays they hold; and the least elements of a sparse
# array: flags, sizes, name, rows, columns, numbers. Others have four.
_MEMBERS, _LEAST_ELEMENTS = (1, 2, 3), {5: 6}
_DEEPEST = 32


class _Bytes:
    """Bytes of an element in sequence, inflated where it is compressed."""

    def __init__(self, file: BinaryIO, stored: int, compressed: bool, order: str) -> None:
        self.file, self.stored, self.order = file, stored, order
        self.inflate = zlib.decompressobj() if compressed else None

    def take(self, count: int) -> bytes:
        """The next bytes; fewer at the end."""
        if self.inflate is None:
            return self.file.read(count)
        made = b""
        while len(made) < count:
            waiting = self.inflate.unconsumed_tail
            if not waiting:
                waiting = self.file.read(min(self.stored, 2**16))
                self.stored -= len(waiting)
            if not waiting:
                break
            made += self.inflate.decompress(waiting, count - len(made))
        return made

    def skip(self, count: int) -> None:
        """Leave bytes out."""
        if self.inflate is None:
            self.file.seek(count, 1)
        while self.inflate is not None and count > 0 and (gone := len(self.take(min(count, 2**20)))):
            count -= gone


def _check_elements(path: Path) -> None:
    """Check the sizes of the file's elements without reading them.

    Source: MathWorks, MAT-File Format, Level 5: a header of 128 bytes, then elements of an 8-byte tag (type,
    bytes) and data; a compressed element holds one whole element, whose own tag declares its size.

    Raises:
        LogFileError: an element runs past the end of the file, or declares far more than is stored of it.
    """
    budget = Budget(path)
    for at, declared, _ in _elements(path):
        budget.take(f"the variable at byte {at}", declared)


@lru_cache(maxsize=8)
def _check_types(path: Path, _written: int) -> None:
    """Check types and classes of all elements: SciPy's compiled reader takes them as indices.

    Raises:
        LogFileError: one is of a type that does not exist, or runs past the end of the one that it is in.
    """
    for at, declared, inside in _elements(path):
        what = _wrong_array(inside, declared, inside.order, 0)
        if what:
            raise corrupt(path, _KIND, f"the variable at byte {at} has {what}")


def _elements(path: Path) -> Iterator[tuple[int, int, _Bytes]]:
    """Arrays of the file: where they are, how many bytes they have once inflated, and these."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
        if order is None:
            raise corrupt(path, _KIND, "its header is incomplete")
        at, count = HEADER_BYTES, 0
        while at < size:
            count += 1
            check_members(path, count, "variables")
            file.seek(at)
            tag = file.read(8)
            kind, stored = struct.unpack(f"{order}II", tag) if len(tag) == 8 else (0, size)
            if at + 8 + stored > size:
                raise corrupt(path, _KIND, f"the element at byte {at} runs past the end of the file")
            inside, declared = _Bytes(file, stored, kind == MI_COMPRESSED, order), stored
            if kind == MI_COMPRESSED:
                inner = inside.take(8)
                kind, declared = struct.unpack(f"{order}II", inner) if len(inner) == 8 else (0, 0)
            if kind == MI_MATRIX:
                yield at, declared, inside
            at += 8 + stored


def _wrong_array(inside: _Bytes, size: int, order: str, depth: int) -> str:
    """What is wrong with the elements of an array of so many bytes; empty where nothing is."""
    whole, allowed, position, number = size, _TYPES, 0, 0
    while size > 0:
        tag = inside.take(8)
        if len(tag) < 8:
            return "an array that is cut short"
        kind, count = struct.unpack(f"{order}II", tag)
        size -= 8
        if kind >> 16:  # up to four bytes are in the tag
            kind, count, small = kind & 0xFFFF, kind >> 16, True
        else:
            small = False
        padded = 0 if small else count + -count % 8
        if kind not in allowed or count > (4 if small else size):
            return f"an element of type {kind} and {count} bytes"
        size -= padded
        if position == 0:
            flags = inside.take(padded)
            number = struct.unpack(f"{order}I", flags[:4])[0] & 0xFF if len(flags) >= 4 else 0
            if kind != 6 or not 1 <= number <= _LAST_CLASS:
                return f"an array of class {number}"
            allowed = _TYPES if number in _NESTED else _TYPES - {MI_MATRIX}
        elif position == 1 and number != _OPAQUE:
            if kind not in (5, 6) or count < 8 or count % 4:
                return f"an array whose sizes are of type {kind} and {count} bytes"
            members = math.prod(struct.unpack(f"{order}{count // 4}i", inside.take(padded)[:count]))
            if number in _MEMBERS and not 0 <= members <= max(whole // 8, 1):  # the tag of each has 8 bytes
                return f"an array of {members} arrays in {whole} bytes"
        elif kind == MI_MATRIX:
            what = "arrays within arrays" if depth > _DEEPEST else _wrong_array(inside, count, order, depth + 1)
            if what:
                return what
        else:
            inside.skip(padded)
        position += 1
    if position and number not in _NESTED and position < _LEAST_ELEMENTS.get(number, 4):
        return f"an array of {position} elements"
    return ""
