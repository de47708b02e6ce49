"""Read or open a log file: find its channels, check them, and bring them to a uniform grid in SI."""

from __future__ import annotations

import difflib
import hashlib
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, freeze
from haptid.errors import LogChannelError, LogFileError
from haptid.log import checks, units
from haptid.log.channel_clocks import clock_drift
from haptid.log.file_format import FORMATS, LEROBOT, MESSAGES, Format, format_of, sha256_of
from haptid.log.formats.folders import log_size
from haptid.log.formats.sniff import RawChannel, block_of, channel_list, empty, guess
from haptid.log.group_times import on_rows_of_positions, refuse_other_times
from haptid.log.inspection import ChannelKind, Inspection, Times
from haptid.log.lazy import LazySource, MotionProfile, SignalOnDisk, as_array
from haptid.log.log import Channels, Log, Signal
from haptid.log.merging import common_rows
from haptid.log.request import Request
from haptid.log.resampling import SAMPLES_RESAMPLED, Resampling
from haptid.log.spectrum import quantum
from haptid.log.time_base import TimeBaseReport
from haptid.log.velocities import with_velocities

# Rows from which the resolution of a position is found, at most.
_ENOUGH = 2**18
# A file of more bytes is opened rather than read, and of several that together have more bytes each of more.
_LARGE, _LARGE_TOGETHER, _LARGE_AMONG_MANY = 2**26, 2**28, 2**20
# `checks.find_wraps` of a channel that is not unwrapped.
NO_WRAPS = (np.empty(0, np.intp), np.empty(0))


def _taken(path: Path, kind: Format, notes: list[str]) -> Channels:
    """The channels that are taken where none are given, which is noted, with the joints that a list calls them by."""
    from haptid.log.survey.beside import listed_joints  # which knows the formats

    channels, sentence = guess(path, kind.names(path), kind.units(path))
    notes.append(sentence)
    if joints := listed_joints(channels.position.channels, kind.beside(path)):
        notes.append(
            f"a list in the file calls the positions {', '.join(joints)}: they are taken in this order; where the "
            "device's joints are in another one, name them in [channels]"
        )
    return channels


def read_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    time_range: tuple[float, float] | None = None,
    episodes: Sequence[int] | None = None,
    exclude: Sequence[tuple[float, float]] = (),
) -> Log:
    """Read a log file, check it, and bring it to a uniform grid in SI.

    Channels of structs and groups are named with points, `rec.q`; those of a matrix with numbers from 1 along
    its shorter side, `q[1]`. Repairs (repeated and stale samples dropped, short gaps filled, segments between longer
    gaps, irregular samples resampled, positions unwrapped) are in the log's notes;
    defects that cannot be repaired are errors.

    Args:
        path: CSV, Parquet, MAT, NPZ, NPY, HDF5, MCAP, ROS bag, TDMS, JSON; a folder of a ROS 2 bag, LeRobot data set
            or Parquet files.
        channels: which channels are what; None takes t, q1..qn in rad and tau1..taun in N m at the joints.
        time_range: the part to keep, (from, to) in s from the file's first sample; None keeps all.
        episodes: of a data set, by number; None for all. Each is a segment of the log.
        exclude: parts that are left out, (from, to) in s as in `t` of the log; a position may jump in them.

    Raises:
        LogError: LogFileError, LogChannelError, LogDataError or LogTimeError; see `haptid.errors`.
    """
    path = Path(path)
    kind = format_of(path)
    notes: list[str] = []
    if channels is None:
        channels = _taken(path, kind, notes)
    if episodes is not None and kind is not LEROBOT:
        raise LogChannelError(
            f"{path} is {kind.name}, which has no episodes.",
            where="episodes",
            found=tuple(episodes),
            limit=LEROBOT.name,
        )
    request = Request(channels.merge, None if episodes is None else tuple(episodes), notes)
    columns = kind.columns(path, channels.sources, request)
    for name in channels.sources:
        if name not in columns:
            raise _missing(path, name, kind.names(path))
    if channels.time is not None and kind is not MESSAGES:
        columns = on_rows_of_positions(path, kind, channels, columns, notes)
    count = checks.lengths(path, columns)
    if count == 0:
        raise empty(path, "channels and no rows")
    if channels.time is not None and kind is not MESSAGES:
        scale = units.scale(channels.time_unit, "time")[1]
        columns = common_rows(columns, channels.time, scale, channels.position.channels, channels.merge, notes)
        count = checks.lengths(path, columns)
    raw = None if channels.time is None else columns.pop(channels.time)
    times = Times.of(path, channels, raw, count, time_range, notes)
    del raw
    columns = {name: column[times.rows] for name, column in columns.items()}
    for name, column in columns.items():
        checks.refuse_nonfinite(path, name, column, times.seconds)
    checks.identical(path, columns)
    inspection = Inspection(path, times, notes, exclude)
    blocks, signals = {}, {"position": channels.position, "torque": channels.torque}
    for what, signal in signals.items():
        blocks[what] = block_of([columns[name] for name in signal.channels], 2 * len(signal.channels) + 1)
        scales = signal.scales(what)  # type: ignore[arg-type]
        for name, gain, scale in zip(signal.channels, signal.gain, scales, strict=True):
            columns[name] = inspection.column(name, columns[name], signal, what, scale * gain)  # type: ignore[arg-type]
    found = times.base(inspection, lambda signal: (columns[name] for name in signal.channels), channels)
    notes.extend(found.report.sentences)
    steps = () if found.position.unchanged else _steps(columns, channels.position)
    position = _block(found.position, columns, channels.position, "position", blocks["position"])
    torque = _block(found.torque, columns, channels.torque, "torque", blocks["torque"])
    if (rates := channels.velocity) is not None:
        columns |= {name: columns[name].astype(np.float64) for name in rates.channels}
        velocity = _block(found.position, columns, rates, "velocity", None)
        better, sentence = with_velocities(
            position.T, velocity.T, found.segments, float(np.median(np.diff(found.t))), rates.channels
        )
        position = freeze(np.ascontiguousarray(better.T))
        notes.append(sentence)
    log = Log(
        path,
        sha256_of(path),
        found.t,
        position.T,
        torque.T,
        channels,
        tuple(notes),
        found.segments,
        found.report,
        steps,
    )
    return _with_drift(log, found.report).without(exclude)


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


def _steps(columns: dict[str, Array], signal: Signal) -> tuple[float, ...]:
    """Resolution of each position as it was recorded, rad or m; resampled ones lie on no lattice."""
    scales = zip(signal.channels, signal.scales("position"), signal.gain, strict=True)
    return tuple(abs(scale * gain) * quantum(columns[name][:_ENOUGH]) for name, scale, gain in scales)


def _block(
    grid: Resampling,
    columns: dict[str, Array],
    signal: Signal,
    kind: Literal["position", "velocity", "torque"],
    own: Array | None,
) -> Array:
    """The channels of a signal on the grid, (channels, n), SI; each column is released once copied.

    Args:
        grid: how rows come to the grid.
        columns: of the file, inspected, (rows,) each.
        signal, kind: which of them, and their quantity.
        own: memory that the columns are in already, (channels, rows); None where there is none.
    """
    scales = signal.scales(kind)
    block = own if own is not None and grid.unchanged else np.empty((len(signal.channels), grid.t.size))
    for name, scale, gain, offset, out in zip(signal.channels, scales, signal.gain, signal.offset, block, strict=True):
        column = columns.pop(name)
        if not grid.unchanged:
            for start in range(0, grid.t.size, SAMPLES_RESAMPLED):
                stop = min(start + SAMPLES_RESAMPLED, grid.t.size)
                low, high = grid.rows(start, stop)
                how: ChannelKind = "torque" if kind == "torque" else "position"
                out[start:stop] = grid.make(column[None, low:high], low, start, stop, how)[0]
        elif not np.may_share_memory(out, column):
            out[:] = column
        if (scale * gain, offset) != (1.0, 0.0):
            out *= scale * gain
            out += offset
    return freeze(block)


def is_long(path: Path, together: int = 0) -> bool:
    """Whether a file is to be opened rather than read: it is large, and its format can be read by rows.

    Args:
        path: of the file, or of a folder of files that are one log.
        together: bytes of all logs that are used at once; of very many, shorter ones are opened too.
    """
    largest = _LARGE if together <= _LARGE_TOGETHER else _LARGE_AMONG_MANY
    if os.path.isdir(path):  # which is false, and no error, of a path that cannot be
        return format_of(path).by_rows and log_size(path) > largest
    suffixes = [suffix for kind in FORMATS if kind.by_rows for suffix in kind.suffixes]
    return os.path.isfile(path) and path.suffix.lower() in suffixes and path.stat().st_size > largest


def open_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    time_range: tuple[float, float] | None = None,
) -> Log:
    """Open a log file: the log of `read_log` with its samples left on disk.

    The file is checked once, one channel in memory at a time. `position` and `torque` are read when they are sliced
    along the samples, the only operation on them; a NumPy array made of one of them holds all of it.

    Args:
        path: Parquet, HDF5, or a folder of Parquet files.
        channels, time_range: as for `read_log`.

    Raises:
        LogFileError: the format can only be read as a whole.
        LogError: as `read_log` does.
    """
    path = Path(path)
    kind = format_of(path)
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
        channels = _taken(path, kind, notes)
    reader = _FileReader(path, kind, channels, time_range, notes)
    if channels.velocity is not None:
        notes.append("velocities are not used: the log is opened and not read as a whole")
    known = reader.inspect_positions(channels.position)
    reader.inspect_torques(channels.torque)
    found = reader.times.base(reader.inspection, reader.channels_of, channels)
    notes.extend(found.report.sentences)
    source = LazySource(path, log_size(path), kind, reader.times.rows.start)
    position = SignalOnDisk(
        source,
        found.position,
        channels.position,
        "position",
        tuple(reader.wraps[name] for name in channels.position.channels),
        known if found.position.unchanged else None,
    )
    unwrapped = (NO_WRAPS,) * len(channels.torque.channels)
    torque = SignalOnDisk(source, found.torque, channels.torque, "torque", unwrapped)
    log = Log(
        path,
        sha256_of(path),
        found.t,
        as_array(position),
        as_array(torque),
        channels,
        tuple(notes),
        found.segments,
        found.report,
    )
    del reader  # with its times and marks of all rows, before samples are read
    return _with_drift(log, found.report)


def _with_drift(log: Log, report: TimeBaseReport) -> Log:
    """The log, with a note if the torques' clock drifts against the positions'."""
    drift = clock_drift(log.position, log.torque, log.segments, log.dt)
    if drift is None:
        return log
    with_drift = replace(report, clock_drift_s=drift.seconds, sentences=(*report.sentences, drift.sentence))
    return replace(log, notes=(*log.notes, drift.sentence), time_base=with_drift)


class _FileReader:
    """Times and signals of a file, read and checked one channel at a time."""

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
        if raw is not None and kind.groups:
            refuse_other_times(path, kind, channels, dict.fromkeys(channels.sources, column))
        self.times = Times.of(path, channels, raw, self.count, time_range, notes)
        self.inspection = Inspection(path, self.times, notes)
        self.seen: dict[bytes, str] = {}
        self.wraps: dict[str, tuple[NDArray[np.intp], Array]] = {}

    def inspect_positions(self, signal: Signal) -> MotionProfile:
        """Check the positions; their profile if they are on the grid as they are."""
        scales = signal.scales("position")

        def channels() -> Iterator[Array]:
            for name, scale, gain, offset in zip(signal.channels, scales, signal.gain, signal.offset, strict=True):
                raw = self._channel(name)
                at, shift = NO_WRAPS
                if signal.unwrap:
                    signed = signal.register.signed(raw.astype(np.float64, copy=False))
                    at, shift = checks.find_wraps(signed, signal.one(name))
                self.wraps[name] = (at, freeze(shift))
                column = self.inspection.column(name, raw, signal, "position", scale * gain)
                yield column * (scale * gain) + offset

        return MotionProfile.of(channels())

    def inspect_torques(self, signal: Signal) -> None:
        """Check the torques; after the positions."""
        for name, scale, gain in zip(signal.channels, signal.scales("torque"), signal.gain, strict=True):
            self.inspection.column(name, self._channel(name), signal, "torque", scale * gain)

    def channels_of(self, signal: Signal) -> Iterator[Array]:
        """The channels of a signal that was inspected, read again, each (rows,), unwrapped."""
        for name in signal.channels:
            column = signal.register.signed(self._read(name)[self.times.rows].astype(np.float64, copy=False))
            at, shift = self.wraps.get(name, NO_WRAPS)
            yield column - checks.wrap_offset(at, shift, 0, column.size) if at.size else column

    def _channel(self, name: str) -> RawChannel:
        """The kept rows of one channel, (rows,), as they are in the file, checked."""
        raw = self._read(name)
        if raw.size != self.count:
            raise checks.unequal_lengths(self.path, self.first, self.count, name, raw.size)
        raw = raw[self.times.rows]
        checks.refuse_nonfinite(self.path, name, raw, self.times.seconds)
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
