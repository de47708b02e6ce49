"""TDMS of LabVIEW: `group.channel`; channels with a waveform have times, `group.channel@time`."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from haptid.errors import MissingDependencyError
from haptid.log.formats.sniff import RawChannel, corrupt, not_numeric, numeric, opened_file, require
from haptid.log.request import Request

_KIND = "TDMS"
TIME = "@time"


def names(path: Path) -> list[str]:
    """Names of the channels of numbers, and of their times."""
    with opened_file(path, _KIND), _open(path) as file:
        return list(_channels(file))


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels that the file has, each (n,), read one after the other.

    Stamps of LabVIEW are whole nanoseconds since 1970, as those of a waveform are.

    Raises:
        LogFileError: a wanted channel holds texts, or the file is shorter than it says before its first sample.
    """
    with opened_file(path, _KIND), _open(path) as file:
        found = _channels(file)
        out: dict[str, RawChannel] = {}
        for name in dict.fromkeys(wanted):
            if name not in found:
                if any(
                    f"{group.name}.{channel.name}" == name for group in file.groups() for channel in group.channels()
                ):
                    raise not_numeric(path, name, "texts")
                continue
            channel = found[name]
            if len(channel) * max(channel.dtype.itemsize, 1) > path.stat().st_size + channel.dtype.itemsize:
                raise corrupt(path, _KIND, f"{name} declares {len(channel)} values, more than its bytes hold")
            out[name] = _times(channel) if name.endswith(TIME) else _values(channel)
        status = file.file_status
        if status.incomplete_final_segment:
            request.notes.append(f"{path.name} was not closed: the values before its end are used")
    sizes = {values.size for values in out.values()}
    if len(sizes) > 1 and max(sizes) - min(sizes) <= max(sizes) // 100 + 1 and status.incomplete_final_segment:
        out = {name: values[: min(sizes)] for name, values in out.items()}
    return out


@contextmanager
def _open(path: Path) -> Iterator[Any]:
    """The file without its index file, closed at the end."""
    require(path, _KIND, "TDMS")
    try:
        import nptdms
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: TDMS files need a package that is not installed.",
            where="nptdms",
            advice='Install it with `pip install "haptid[lab]"`.',
        ) from error
    nptdms.log.log_manager.set_level(logging.CRITICAL)  # what it warns of is in the notes
    with path.open("rb") as raw, nptdms.TdmsFile.open(raw) as file:
        yield file


def units(path: Path) -> dict[str, str]:
    """Units that the channels state."""
    with opened_file(path, _KIND), _open(path) as file:
        stated = {name: channel.properties.get("unit_string") for name, channel in _channels(file).items()}
    return {name: str(unit) for name, unit in stated.items() if unit and not name.endswith(TIME)}


def _channels(file: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for group in file.groups():
        for channel in group.channels():
            if channel.dtype is None or not (numeric(channel.dtype) or channel.dtype.kind == "M"):
                continue
            found[f"{group.name}.{channel.name}"] = channel
            if "wf_increment" in channel.properties:
                found[f"{group.name}.{channel.name}{TIME}"] = channel
    return found


def _values(channel: Any) -> RawChannel:
    values = np.asarray(channel[:])
    return np.asarray(values.astype("M8[ns]").astype(np.int64) if values.dtype.kind == "M" else values)


def _times(channel: Any) -> RawChannel:
    """Times of a waveform, ns since 1970, or from its first sample where it has no start."""
    step = 1e9 * float(channel.properties["wf_increment"])
    offset = 1e9 * float(channel.properties.get("wf_start_offset", 0.0))
    start = channel.properties.get("wf_start_time")
    first = 0 if start is None else int(np.datetime64(start, "ns").astype(np.int64))
    return np.asarray(first + np.rint(offset + step * np.arange(len(channel))).astype(np.int64))
