"""From a file to a log: find the channels, check what they hold, put it on a uniform grid in SI."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptid._values import Array, freeze
from haptid.errors import (
    EmptyLogError,
    LogAccessError,
    LogFolderError,
    LogFormatError,
    LogNotFoundError,
    MissingChannelError,
)
from haptid.log import checks, time, units
from haptid.log.content import Column, block_of
from haptid.log.guess import guess
from haptid.log.model import Channels, Log, Signal


@dataclass(frozen=True)
class Format:
    """A kind of file: its name, its suffixes, and the module that reads it, loaded when needed."""

    name: str
    suffixes: tuple[str, ...]
    module: str

    def names(self, path: Path) -> list[str]:
        """Every channel of the file."""
        found: list[str] = import_module(f"haptid.log.{self.module}").names(path)
        return found

    def columns(self, path: Path, wanted: Sequence[str]) -> dict[str, Column]:
        """Those wanted channels that the file has, each (n,)."""
        found: dict[str, Column] = import_module(f"haptid.log.{self.module}").columns(path, wanted)
        return found


FORMATS = (
    Format("CSV", (".csv", ".tsv", ".txt"), "csv"),
    Format("Parquet", (".parquet", ".pq"), "parquet"),
    Format("MATLAB", (".mat",), "mat"),
    Format("NumPy", (".npz",), "npz"),
    Format("HDF5", (".h5", ".hdf5"), "hdf5"),
)


def read_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    stretch: tuple[float, float] | None = None,
) -> Log:
    """Read, check and bring to a uniform grid what was recorded.

    Channels of structs and groups are named with points, `rec.q`; those of a matrix with numbers from 1 along
    its shorter side, `q[1]`. What is done to the samples (repeated ones dropped, short gaps filled, irregular
    ones resampled, turns put back) is in the log's notes; what cannot be mended is an error.

    Args:
        path: CSV, Parquet, MAT, NPZ or HDF5.
        channels: which channels are what; None takes t, q1..qn in rad and tau1..taun in N m at the joints.
        stretch: the part to keep, (from, to) in s from the file's first sample; None keeps all.

    Raises:
        LogError: one class for each cause; see `haptid.errors`.
    """
    path = Path(path)
    kind, sha256 = _format(path), _sha256(path)
    notes: list[str] = []
    if channels is None:
        channels, sentence = guess(path, kind.names(path))
        notes.append(sentence)
    columns = kind.columns(path, channels.sources)
    for name in channels.sources:
        if name not in columns:
            raise MissingChannelError(path, name, kind.names(path))
    if checks.lengths(path, columns) == 0:
        raise EmptyLogError(path, "channels and no rows")
    base, rows, seconds = _time_base(path, channels, columns, stretch, notes)
    columns = {name: column[rows] for name, column in columns.items()}
    _check_raw(path, columns, seconds, base.repeated)
    del seconds
    assembly = _Assembly(path, columns, base, notes)
    position = assembly.block(channels.position, "position")
    torque = assembly.block(channels.torque, "torque")
    return Log(path, sha256, base.t, position.T, torque.T, channels, tuple(notes))


def _format(path: Path) -> Format:
    """The format of the suffix, for a file that is there and can be read."""
    try:
        if path.is_dir():
            raise LogFolderError(path)
        if not path.exists():
            raise LogNotFoundError(path)
        if not path.is_file():
            raise LogAccessError(path, "it is not a regular file")
        with path.open("rb") as file:
            first = file.read(1)
    except (OSError, ValueError) as error:
        raise LogAccessError(path, str(error)) from error
    if not first:
        raise EmptyLogError(path, "0 bytes")
    for kind in FORMATS:
        if path.suffix.lower() in kind.suffixes:
            return kind
    raise LogFormatError(path, path.suffix, [f"{kind.name} ({', '.join(kind.suffixes)})" for kind in FORMATS])


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _time_base(
    path: Path,
    channels: Channels,
    columns: dict[str, Column],
    stretch: tuple[float, float] | None,
    notes: list[str],
) -> tuple[time.TimeBase, slice, Array]:
    """The time base, the rows of the stretch and their stamps; takes time out of the columns."""
    count = checks.lengths(path, columns)
    if channels.time is None:
        rate = float(channels.rate_hz or 0.0)
        rows = time.part(path, np.arange(count) / rate, stretch)
        base = time.from_rate(path, rows, rate)
        seconds = base.stamps
    else:
        raw, scale = columns.pop(channels.time), units.scale(channels.time_unit, "time")[1]
        first, fineness = raw[0] * scale, time.resolution(raw) * scale
        seconds = time.since_first(path, channels.time, raw, scale)
        rows = time.part(path, seconds, stretch)
        seconds = seconds[rows]
        base = time.from_stamps(path, channels.time, seconds, fineness)
        if first != 0:
            notes.append(f"times count from the file's first stamp, {first:.9g} s")
    if stretch is not None:
        kept_count = rows.stop - rows.start
        notes.append(f"kept from {stretch[0]:g} to {stretch[1]:g} s: {kept_count} of {count} samples")
    notes.extend(base.notes)
    return base, rows, seconds


def _check_raw(path: Path, columns: Mapping[str, Column], seconds: Array, repeated: NDArray[np.intp]) -> None:
    """What is wrong with the samples as they are in the file."""
    for name, column in columns.items():
        checks.finite(path, name, column, seconds)
    if repeated.size:
        checks.repeats(path, columns, seconds, repeated)
    checks.identical(path, columns)


class _Assembly:
    """Raw columns on their way into a log: each is checked, put on the grid, scaled to SI, and let go.

    Attributes:
        path: the file.
        columns: those not used yet, each of the rows that are kept.
        base: where they go.
        notes: grows.
        moving: where each position differs from the sample before, as bits; complete after the positions.
    """

    def __init__(self, path: Path, columns: dict[str, Column], base: time.TimeBase, notes: list[str]) -> None:
        self.path, self.columns, self.base, self.notes = path, columns, base, notes
        self.moving: list[NDArray[np.uint8]] = []

    def block(self, signal: Signal, kind: Literal["position", "torque"]) -> Array:
        """The channels of a signal on the grid, (channels, n), SI."""
        scale = units.scale(signal.unit, kind)[1]
        block, in_place = self._room(signal)
        for name, gain, offset, out in zip(signal.channels, signal.gain, signal.offset, block, strict=True):
            column = self.columns.pop(name)
            if self.base.repeated.size:
                column = np.delete(column, self.base.repeated)
            column = column.astype(np.float64, copy=False)
            self._note(checks.constant(self.path, name, column, kind, signal.constant_ok))
            if kind == "position":
                column = self._position(name, column, signal, scale * gain)
            else:
                self._torque(name, column, signal)
            if self.base.regular:
                out[:] = column
            else:
                time.interpolate(self.base, column.copy() if in_place else column, kind, out)
            out *= scale * gain
            out += offset
        return freeze(block)

    def _room(self, signal: Signal) -> tuple[Array, bool]:
        """Where the signal goes, (channels, n), and whether its raw columns are there already."""
        n, count = self.base.t.size, len(signal.channels)
        block = block_of([self.columns[name] for name in signal.channels], 2 * count + 1)
        if block is None or block.shape[1] != n:
            return np.empty((count, n)), False
        return block, True

    def _position(self, name: str, column: Array, signal: Signal, si: float) -> Array:
        """The column with its turns put back where that is asked for, and checked for jumps."""
        self.moving.append(np.packbits(column[1:] != column[:-1]))
        if signal.unwrap:
            column, count = checks.unwrapped(column, signal)
            self._note(f"position channel {name!r} unwrapped at {count} jumps" if count else None)
        checks.jumps(self.path, name, column, self.base.stamps, signal, si)
        return column

    def _torque(self, name: str, column: Array, signal: Signal) -> None:
        """Check for saturation: as many torques as positions are pairs, otherwise any motion counts."""
        paired = len(self.moving) == len(signal.channels)
        bits = self.moving[signal.channels.index(name)] if paired else np.bitwise_or.reduce(self.moving)
        self._note(checks.saturated(self.path, name, column, bits, signal))

    def _note(self, sentence: str | None) -> None:
        if sentence:
            self.notes.append(sentence)
