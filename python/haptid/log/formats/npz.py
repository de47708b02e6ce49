"""NumPy archives: an array of numbers for each channel or set of channels; pickles are refused."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from haptid.errors import LogFileError
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
    repeated_name,
    require,
)

_KIND = "NPZ"


def names(path: Path) -> list[str]:
    """Names of the channels of all arrays of numbers.

    Raises:
        LogFileError: all arrays hold Python objects.
    """
    require(path, _KIND, "a ZIP archive")
    found: list[str] = []
    pickled: list[str] = []
    with opened_file(path, _KIND), zipfile.ZipFile(path) as archive:
        for name, info in _members(path, archive).items():
            with archive.open(info) as member:
                shape, dtype, _ = _header(member)
            if dtype.hasobject:
                pickled.append(name)
            elif numeric(dtype):
                found.extend(addresses(name, shape))
    if pickled and not found:
        raise _pickled(path, pickled[0])
    return found


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,); only their arrays are read.

    Raises:
        LogFileError: a wanted array holds Python objects, texts, booleans or records, or declares far more than is
            stored of it.
    """
    require(path, _KIND, "a ZIP archive")
    with opened_file(path, _KIND), zipfile.ZipFile(path) as archive:
        return collect(wanted, _columns(path, archive, wanted))


def _columns(path: Path, archive: zipfile.ZipFile, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    budget = Budget(path)
    for name, info in _members(path, archive).items():
        requested = [w for w in wanted if w == name or w.startswith(f"{name}[")]
        if requested:
            budget.take(f"array {name!r}", info.file_size)
            array = _array(path, archive, name, info)
            found = addresses(name, array.shape)
            yield from ((w, array[found[w]]) for w in requested if w in found)


def _members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    check_members(path, len(archive.infolist()), "arrays")
    for info in archive.infolist():
        if info.filename.endswith(".npy"):
            name = info.filename.removesuffix(".npy").replace("/", ".")
            if name in members:
                raise repeated_name(path, name)
            members[name] = info
    return members


def _header(member: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Shape, type and size in bytes of the header."""
    version = npy.read_magic(member)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(member)
    return shape, dtype, member.tell()


def _array(path: Path, archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> RawChannel:
    with archive.open(info) as member:
        shape, dtype, offset = _header(member)
    if dtype.hasobject:
        raise _pickled(path, name)
    if not numeric(dtype):
        raise not_numeric(path, name, f"values of type {dtype}")
    declared = dtype.itemsize * int(np.prod(shape, dtype=object)) if shape else dtype.itemsize
    if declared != info.file_size - offset:
        raise corrupt(path, _KIND, f"{name} should have {declared} bytes and has {info.file_size - offset}")
    with archive.open(info) as member:
        array = npy.read_array(member, allow_pickle=False)
        member.read()  # to the end, where the archive verifies its checksum
    return np.asarray(array)


def _pickled(path: Path, name: str) -> LogFileError:
    """Error of an array of Python objects."""
    return LogFileError(
        f"{path}: {name} is an array of Python objects, and reading it would execute code from the file.",
        where=name,
        advice=f"Save plain numbers: numpy.savez(path, {name}=numpy.asarray(..., dtype=float)).",
    )
