"""Read or open a log file: find its channels, check them, and bring them to a uniform grid in SI."""

from __future__ import annotations

import difflib
import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, freeze
from haptid.errors import LogChannelError, LogFileError
from haptid.log import checks, resampling, units
from haptid.log.formats.sniff import RawChannel, block_of, channel_list, empty, guess
from haptid.log.lazy import LazySource, MotionProfile, SignalOnDisk, as_array
from haptid.log.log import Channels, Log, Signal

ChannelKind = Literal["position", "torque"]
# A file of more bytes is opened rather than read.
_LARGE = 2**26
# `checks.find_wraps` of a channel that is not unwrapped.
NO_WRAPS = (np.empty(0, np.intp), np.empty(0))


@dataclass(frozen=True)
class Format:
    """A file format: its name, its suffixes, and the module that reads it, imported when needed.

    Attributes:
        by_rows: whether some rows can be read without the others.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    by_rows: bool = False

    @property
    def _reader(self) -> Any:
        return import_module(f"haptid.log.formats.{self.module}")

    def names(self, path: Path) -> list[str]:
        """Every channel of the file."""
        found: list[str] = self._reader.names(path)
        return found

    def columns(self, path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
        """Those wanted channels that the file has, each (n,)."""
        found: dict[str, RawChannel] = self._reader.columns(path, wanted)
        return found

    def rows(self, path: Path, wanted: Sequence[str], start: int, stop: int) -> list[RawChannel]:
        """Rows start..stop of channels that the file has, each (stop - start,); where `by_rows`."""
        found: list[RawChannel] = self._reader.rows(path, wanted, start, stop)
        return found


FORMATS = (
    Format("CSV", (".csv", ".tsv", ".txt"), "csv"),
    Format("Parquet", (".parquet", ".pq"), "parquet", by_rows=True),
    Format("MATLAB", (".mat",), "mat"),
    Format("NumPy", (".npz",), "npz"),
    Format("HDF5", (".h5", ".hdf5"), "hdf5", by_rows=True),
)


def read_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    time_range: tuple[float, float] | None = None,
) -> Log:
    """Read a log file, check it, and bring it to a uniform grid in SI.

    Channels of structs and groups are named with points, `rec.q`; those of a matrix with numbers from 1 along
    its shorter side, `q[1]`. Repairs (repeated samples dropped, short gaps filled, irregular samples resampled,
    positions unwrapped) are in the log's notes; defects that cannot be repaired are errors.

    Args:
        path: CSV, Parquet, MAT, NPZ or HDF5.
        channels: which channels are what; None takes t, q1..qn in rad and tau1..taun in N m at the joints.
        time_range: the part to keep, (from, to) in s from the file's first sample; None keeps all.

    Raises:
        LogError: LogFileError, LogChannelError, LogDataError or LogTimeError; see `haptid.errors`.
    """
    path = Path(path)
    kind, sha256 = format_of(path), sha256_of(path)
    notes: list[str] = []
    if channels is None:
        channels, sentence = guess(path, kind.names(path))
        notes.append(sentence)
    columns = kind.columns(path, channels.sources)
    for name in channels.sources:
        if name not in columns:
            raise _missing(path, name, kind.names(path))
    count = checks.lengths(path, columns)
    if count == 0:
        raise empty(path, "channels and no rows")
    stamps = None if channels.time is None else columns.pop(channels.time)
    base, rows, seconds = time_base(path, channels, stamps, count, time_range, notes)
    del stamps
    columns = {name: column[rows] for name, column in columns.items()}
    _check_raw(path, columns, seconds, base.repeated)
    del seconds
    inspection = Inspection(path, base, notes)
    position = _block(inspection, columns, channels.position, "position")
    torque = _block(inspection, columns, channels.torque, "torque")
    return Log(path, sha256, base.t, position.T, torque.T, channels, tuple(notes))


def format_of(path: Path) -> Format:
    """The format by the suffix, of a file that exists and can be read."""
    try:
        if path.is_dir():
            raise LogFileError(f"{path} is a folder, not a log file.", where=path, advice="Name one file in it.")
        if not path.exists():
            raise LogFileError(
                f"{path}: no such file.",
                where=path,
                advice="Check the path; a study takes it from the folder of --data, or from its own.",
            )
        if not path.is_file():
            raise _inaccessible(path, "it is not a regular file")
        with path.open("rb") as file:
            first = file.read(1)
    except (OSError, ValueError) as error:
        raise _inaccessible(path, str(error)) from error
    if not first:
        raise empty(path, "0 bytes")
    for kind in FORMATS:
        if path.suffix.lower() in kind.suffixes:
            return kind
    known = [f"{kind.name} ({', '.join(kind.suffixes)})" for kind in FORMATS]
    raise LogFileError(
        f"{path}: its suffix {path.suffix!r} is not that of a log." if path.suffix else f"{path}: it has no suffix.",
        where=path,
        found=path.suffix,
        limit=tuple(known),
        advice=f"Formats: {'; '.join(known)}. Convert the log, or rename it.",
    )


def _inaccessible(path: Path, why: str) -> LogFileError:
    """Error of a file that cannot be opened."""
    return LogFileError(f"{path} cannot be read: {why}.", where=path, advice="Check its permissions, or copy the file.")


def _missing(path: Path, name: str, names: Sequence[str]) -> LogChannelError:
    """Error of a channel that a file does not have."""
    parts = [n for n in names if name in (n.rpartition("[")[0], n.split("[")[0].rpartition(".")[2])]
    close = channel_list(parts, 3) if parts else ", ".join(difflib.get_close_matches(name, names, n=3, cutoff=0.6))
    return LogChannelError(
        f"{path} has no channel {name!r}.",
        where=name,
        limit=tuple(names),
        advice=(f"Closest: {close}. " if close else "") + f"Channels of this file: {channel_list(names)}.",
    )


def sha256_of(path: Path) -> str:
    """SHA-256 of the file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def time_base(
    path: Path,
    channels: Channels,
    raw: RawChannel | None,
    count: int,
    time_range: tuple[float, float] | None,
    notes: list[str],
) -> tuple[resampling.TimeBase, slice, Array]:
    """Time base, rows of the part to keep, and their stamps.

    Args:
        path: the file.
        channels: which of them is time.
        raw: that channel, (count,); overwritten. None where there is none.
        count: rows of the file.
        time_range: the part to keep, s.
        notes: appended to.
    """
    if channels.time is None or raw is None:
        rate = float(channels.rate_hz or 0.0)
        rows = resampling.part(path, np.arange(count) / rate, time_range)
        base = resampling.from_rate(path, rows, rate)
        seconds = base.stamps
    else:
        scale = units.scale(channels.time_unit, "time")[1]
        first, fineness = raw[0] * scale, resampling.resolution(raw) * scale
        seconds = resampling.since_first(path, channels.time, raw, scale)
        rows = resampling.part(path, seconds, time_range)
        seconds = seconds[rows]
        base = resampling.from_stamps(path, channels.time, seconds, fineness)
        if first != 0:
            notes.append(f"times count from the file's first stamp, {first:.9g} s")
    if time_range is not None:
        kept_count = rows.stop - rows.start
        notes.append(f"kept from {time_range[0]:g} to {time_range[1]:g} s: {kept_count} of {count} samples")
    notes.extend(base.notes)
    return base, rows, seconds


def _check_raw(path: Path, columns: Mapping[str, RawChannel], seconds: Array, repeated: NDArray[np.intp]) -> None:
    """Refuse defects of the samples as they are in the file."""
    for name, column in columns.items():
        checks.refuse_nonfinite(path, name, column, seconds)
    if repeated.size:
        checks.repeats(path, columns, seconds, repeated)
    checks.identical(path, columns)


class Inspection:
    """Checks and unwraps raw columns, one after the other.

    Attributes:
        path: the file.
        base: time base of the samples.
        notes: appended to.
        moving: where each position differs from the sample before, as bits; complete after the positions.
    """

    def __init__(self, path: Path, base: resampling.TimeBase, notes: list[str]) -> None:
        self.path, self.base, self.notes = path, base, notes
        self.moving: list[NDArray[np.uint8]] = []

    def column(self, name: str, raw: RawChannel, signal: Signal, kind: ChannelKind, si: float) -> Array:
        """A channel of a signal at the stamps, (m,), in the file's unit; positions before torques.

        Args:
            name, raw: of the channel; raw as it is in the file, with repeated samples.
            signal, kind: that it belongs to.
            si: factor from its unit to SI.
        """
        if self.base.repeated.size:
            raw = np.delete(raw, self.base.repeated)
        column = raw.astype(np.float64, copy=False)
        self._note(checks.refuse_constant(self.path, name, column, kind, signal.constant_ok))
        if kind == "position":
            return self._position(name, column, signal, si)
        self._torque(name, column, signal)
        return column

    def _position(self, name: str, column: Array, signal: Signal, si: float) -> Array:
        """The column, unwrapped if its signal says so, and checked for jumps."""
        self.moving.append(np.packbits(column[1:] != column[:-1]))
        if signal.unwrap:
            column, count = checks.unwrapped(column, signal)
            self._note(f"position channel {name!r} unwrapped at {count} jumps" if count else None)
        checks.jumps(self.path, name, column, self.base.stamps, signal, si)
        return column

    def _torque(self, name: str, column: Array, signal: Signal) -> None:
        """Check for saturation during motion of the paired position, or of any where they are not in pairs."""
        paired = len(self.moving) == len(signal.channels)
        bits = self.moving[signal.channels.index(name)] if paired else np.bitwise_or.reduce(self.moving)
        self._note(checks.saturated(self.path, name, column, bits, signal))

    def _note(self, sentence: str | None) -> None:
        if sentence:
            self.notes.append(sentence)


def _block(inspection: Inspection, columns: dict[str, RawChannel], signal: Signal, kind: ChannelKind) -> Array:
    """The channels of a signal on the grid, (channels, n), SI; each raw column is released once copied."""
    base, scale = inspection.base, units.scale(signal.unit, kind)[1]
    block, in_place = _room(base, columns, signal)
    for name, gain, offset, out in zip(signal.channels, signal.gain, signal.offset, block, strict=True):
        column = inspection.column(name, columns.pop(name), signal, kind, scale * gain)
        if not base.regular:
            resampling.interpolate(base, column.copy() if in_place else column, kind, out)
        elif not np.may_share_memory(out, column):
            out[:] = column
        if (scale * gain, offset) != (1.0, 0.0):
            out *= scale * gain
            out += offset
    return freeze(block)


def _room(base: resampling.TimeBase, columns: Mapping[str, RawChannel], signal: Signal) -> tuple[Array, bool]:
    """Memory for the signal, (channels, n), and whether its raw columns are in it already."""
    n, count = base.t.size, len(signal.channels)
    block = block_of([columns[name] for name in signal.channels], 2 * count + 1)
    if block is None or block.shape[1] != n:
        return np.empty((count, n)), False
    return block, True


def is_long(path: Path) -> bool:
    """Whether a file is to be opened rather than read: it is large, and its format can be read by rows."""
    return (
        path.is_file()
        and path.stat().st_size > _LARGE
        and any(kind.by_rows and path.suffix.lower() in kind.suffixes for kind in FORMATS)
    )


def open_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    time_range: tuple[float, float] | None = None,
) -> Log:
    """Open a log file: the log of `read_log` with its samples left on disk.

    The file is checked once, one channel in memory at a time. `position` and `torque` are read when they are sliced
    along the samples, the only operation on them; a NumPy array made of one of them holds all of it.

    Args:
        path: Parquet or HDF5.
        channels, time_range: as for `read_log`.

    Raises:
        LogFileError: the format can only be read as a whole.
        LogError: as `read_log` does.
    """
    path = Path(path)
    kind, sha256 = format_of(path), sha256_of(path)
    if not kind.by_rows:
        formats = [other.name for other in FORMATS if other.by_rows]
        raise LogFileError(
            f"{path} is {kind.name}, which can only be read as a whole.",
            where=path,
            found=kind.name,
            limit=tuple(formats),
            advice=f"Read it with read_log, or convert it to {' or '.join(formats)}.",
        )
    notes: list[str] = []
    if channels is None:
        channels, sentence = guess(path, kind.names(path))
        notes.append(sentence)
    reader = _FileReader(path, kind, channels, time_range, notes)
    position, torque = reader.position(channels.position), reader.torque(channels.torque)
    return Log(path, sha256, reader.base.t, as_array(position), as_array(torque), channels, tuple(notes))


class _FileReader:
    """Time base and signals of a file, read and checked one channel at a time."""

    def __init__(
        self, path: Path, kind: Format, channels: Channels, time_range: tuple[float, float] | None, notes: list[str]
    ) -> None:
        self.path, self.kind = path, kind
        self.first = channels.sources[0]
        column = self._read(self.first)
        self.count = column.size
        if self.count == 0:
            raise empty(path, "channels and no rows")
        raw = None if channels.time is None else column
        self.base, self.rows, self.stamps = time_base(path, channels, raw, self.count, time_range, notes)
        self.inspection = Inspection(path, self.base, notes)
        self.seen: dict[bytes, str] = {}

    def position(self, signal: Signal) -> SignalOnDisk:
        """The checked positions."""
        scale, wraps = units.scale(signal.unit, "position")[1], []

        def channels() -> Iterator[Array]:
            for name, gain, offset in zip(signal.channels, signal.gain, signal.offset, strict=True):
                raw = self._channel(name)
                kept = np.delete(raw, self.base.repeated).astype(np.float64, copy=False)
                at, shift = checks.find_wraps(kept, signal) if signal.unwrap else NO_WRAPS
                wraps.append((at, freeze(shift)))
                column = self.inspection.column(name, raw, signal, "position", scale * gain)
                yield self._on_grid(column) * (scale * gain) + offset

        profile = MotionProfile.of(channels())
        return SignalOnDisk(self._source(), signal, "position", tuple(wraps), profile)

    def torque(self, signal: Signal) -> SignalOnDisk:
        """The checked torques; after the positions."""
        scale = units.scale(signal.unit, "torque")[1]
        for name, gain in zip(signal.channels, signal.gain, strict=True):
            self.inspection.column(name, self._channel(name), signal, "torque", scale * gain)
        return SignalOnDisk(self._source(), signal, "torque", (NO_WRAPS,) * len(signal.channels))

    def _on_grid(self, column: Array) -> Array:
        """A position at the stamps as one on the grid, (n,)."""
        if self.base.regular:
            return column
        out = np.empty(self.base.t.size)
        resampling.interpolate(self.base, column, "position", out)
        return out

    def _source(self) -> LazySource:
        return LazySource(self.path, self.path.stat().st_size, self.kind, self.rows.start, self.base)

    def _channel(self, name: str) -> RawChannel:
        """The kept rows of one channel, (rows,), as they are in the file, checked."""
        raw = self._read(name)
        if raw.size != self.count:
            raise checks.unequal_lengths(self.path, self.first, self.count, name, raw.size)
        raw = raw[self.rows]
        checks.refuse_nonfinite(self.path, name, raw, self.stamps)
        if self.base.repeated.size:
            checks.repeats(self.path, {name: raw}, self.stamps, self.base.repeated)
        if raw.min() != raw.max():
            digest = hashlib.sha256(np.ascontiguousarray(raw, dtype=np.float64).data).digest()
            if digest in self.seen:
                raise checks.identical_channels(self.path, self.seen[digest], name)
            self.seen[digest] = name
        return raw

    def _read(self, name: str) -> RawChannel:
        found = self.kind.columns(self.path, (name,))
        if name not in found:
            raise _missing(self.path, name, self.kind.names(self.path))
        return found[name]
