"""NumPy arrays (.npy) and archives of them (.npz): one for each channel or set of channels; pickles are refused.

An archive of MuJoCo's system identification has the names of its signals in `signal_mapping`; its channels are then
`data[shoulder_pos]`, with numbers from 1 where a signal has several.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from haptid.errors import LogFileError
from haptid.log.formats.sniff import (
    MOST_CHANNELS,
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
ARRAY = "a single NumPy array"
DATA = "data"
_MOST_MAPPING = 2**24


def names(path: Path) -> list[str]:
    """Names of the channels of all arrays of numbers.

    Raises:
        LogFileError: all arrays hold Python objects.
    """
    if require(path, _KIND, "a ZIP archive", ARRAY) == ARRAY:
        return list(_single(path))
    found: list[str] = []
    pickled: list[str] = []
    with opened_file(path, _KIND), zipfile.ZipFile(path) as archive:
        signals = _signals(path, archive)
        for name, info in _members(path, archive).items():
            with archive.open(info) as member:
                shape, dtype, _ = _header(member)
            if dtype.hasobject:
                pickled.append(name)
            elif numeric(dtype):
                found.extend(addresses(name, shape))
                found.extend(signals if name == DATA else ())
    if pickled and not found:
        raise _pickled(path, pickled[0])
    return found


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,); only their arrays are read.

    Raises:
        LogFileError: a wanted array holds Python objects, texts, booleans or records, or declares far more than is
            stored of it.
    """
    if require(path, _KIND, "a ZIP archive", ARRAY) == ARRAY:
        found = _single(path)
        return collect(wanted, ((name, found[name]) for name in wanted if name in found))
    with opened_file(path, _KIND), zipfile.ZipFile(path) as archive:
        signals = _signals(path, archive)
        plain = {name: f"{DATA}[{signals[name] + 1}]" if name in signals else name for name in wanted}
        read = collect([*dict.fromkeys(plain.values())], _columns(path, archive, [*plain.values()]))
    return {name: read[inner] for name, inner in plain.items() if inner in read}


def beside(path: Path) -> dict[str, RawChannel]:
    """Lists of texts and single numbers beside the samples, each (n,)."""
    if require(path, _KIND, "a ZIP archive", ARRAY) == ARRAY:
        return {}
    found: dict[str, RawChannel] = {}
    with opened_file(path, _KIND), zipfile.ZipFile(path) as archive:
        for name, info in _members(path, archive).items():
            with archive.open(info) as member:
                shape, dtype, _ = _header(member)
                few = int(np.prod(shape, dtype=object)) <= (MOST_CHANNELS if dtype.kind in "US" else 1)
            if few and (numeric(dtype) or dtype.kind in "US") and info.file_size <= _MOST_MAPPING:
                with archive.open(info) as member:
                    found[name] = npy.read_array(member, allow_pickle=False).ravel()
    return {name: np.char.decode(x, "utf-8", "replace") if x.dtype.kind == "S" else x for name, x in found.items()}


def _single(path: Path) -> dict[str, RawChannel]:
    """Channels of a single array: `data[1..n]`, or the fields of its records, mapped into memory."""
    with opened_file(path, _KIND):
        with path.open("rb") as file:
            _, dtype, _ = _header(file)
        if dtype.hasobject:
            raise _pickled(path, DATA)
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        found: dict[str, RawChannel] = {}
        for name in dtype.names or (DATA,):
            inner = array[name] if dtype.names else array
            if numeric(inner.dtype):
                found |= {channel: np.asarray(inner[at]) for channel, at in addresses(name, inner.shape).items()}
    return found


def _signals(path: Path, archive: zipfile.ZipFile) -> dict[str, int]:
    """Columns of `data` by the names in `signal_mapping`, from 0; none where the archive has no such mapping.

    Source: mujoco.sysid, `TimeSeries.save_to_disk`.
    """
    info = _members(path, archive).get("signal_mapping")
    if info is None or info.file_size > _MOST_MAPPING:
        return {}
    with archive.open(info) as member:
        _, dtype, _ = _header(member)
        if dtype.kind != "U":
            return {}
        mapping = json.loads(member.read().decode("utf-32-le" if dtype.byteorder != ">" else "utf-32-be").rstrip("\0"))
    found: dict[str, int] = {}
    for name, signal in mapping.items() if isinstance(mapping, dict) else ():
        indices = signal[-1] if isinstance(signal, list) and signal else None
        if not isinstance(indices, list) or not all(isinstance(column, int) for column in indices):
            raise ValueError(f"signal_mapping has no columns for {name!r}")
        for k, column in enumerate(indices, 1):
            found[f"{DATA}[{name}]" if len(indices) == 1 else f"{DATA}[{name}.{k}]"] = column
    return found


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
        advice=f"Save plain numbers: numpy.savez(path, {name}=numpy.asarray(..., dtype=float)), or of a dict of arrays "
        "numpy.savez(path, **arrays).",
    )
