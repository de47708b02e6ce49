"""A log that stays on disk: checked like any other, one channel in memory at a time, and read again when needed."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array, freeze
from haptid.errors import (
    ChangedLogError,
    EmptyLogError,
    IdenticalChannelsError,
    MissingChannelError,
    NotByRowsError,
    UnequalChannelsError,
)
from haptid.log import checks, resampling, units
from haptid.log.formats.content import Column
from haptid.log.formats.guess import guess
from haptid.log.log import Channels, Log, Signal
from haptid.log.on_disk import CHUNK, Course, OnDisk, as_array
from haptid.log.read import FORMATS, Format, Inspection, Kind, format_of, sha256_of, time_base

# A file of more bytes is long.
LARGE = 2**26
# Of a channel that is not unwrapped.
UNTURNED = (np.empty(0, np.intp), np.empty(0))


@dataclass(frozen=True, eq=False)
class Source:
    """The rows of a file that a log is made of.

    Attributes:
        path, size: of the file; size in bytes.
        kind: its format.
        first: row of the first sample.
        base: where the samples go.
    """

    path: Path
    size: int
    kind: Format
    first: int
    base: resampling.TimeBase

    def raw(self, names: tuple[str, ...], low: int, high: int) -> Array:
        """Samples low..high at the stamps, repeated ones left out, in the file's unit, (channels, high - low).

        Raises:
            ChangedLogError: the file is no longer what it was.
        """
        size = self.path.stat().st_size
        if size != self.size:
            raise ChangedLogError(self.path, size, self.size)
        # Sample k is in row k + (repeated rows up to it).
        dropped = self.base.repeated - np.arange(self.base.repeated.size)
        start, stop = (int(k + np.searchsorted(dropped, k, side="right")) for k in (low, high - 1))
        columns = self.kind.rows(self.path, names, self.first + start, self.first + stop + 1)
        again = self.base.repeated[(self.base.repeated > start) & (self.base.repeated <= stop)] - start
        return np.stack([np.delete(column, again).astype(np.float64, copy=False) for column in columns])


@dataclass(frozen=True, eq=False)
class Recorded(OnDisk):
    """The channels of a signal on the grid, in SI, as they are in the file.

    Attributes:
        source: the file.
        signal, quantity: which channels, and what they are.
        turns: where each channel jumps by whole periods, and what is taken off from there on.
        known: how far positions go, and when they move.
    """

    source: Source
    signal: Signal
    quantity: Kind
    turns: tuple[tuple[NDArray[np.intp], Array], ...]
    known: Course | None = None

    @property
    def shape(self) -> tuple[int, int]:
        return self.source.base.t.size, len(self.signal.channels)

    def make(self, low: int, high: int) -> Array:
        return self._made(low, high, range(self.shape[1]))

    def channel(self, k: int) -> Array:
        step = len(self) if self.source.base.regular else CHUNK
        starts = range(0, len(self), step)
        return np.concatenate([self._made(a, min(a + step, len(self)), range(k, k + 1))[0] for a in starts])

    def course(self) -> Course:
        return super().course() if self.known is None else self.known

    def _made(self, low: int, high: int, channels: range) -> Array:
        """Samples low..high of some channels, (channels, high - low), rad, m or the torques' unit."""
        base = self.source.base
        start, stop = (low, high) if base.regular else resampling.around(base, low, high)
        made = self.source.raw(tuple(self.signal.channels[k] for k in channels), start, stop)
        for column, k in zip(made, channels, strict=True):
            if self.turns[k][0].size:
                column -= checks.taken_off(*self.turns[k], start, stop)
        if not base.regular:
            made = np.asarray(resampling.curve(base, made, start, self.quantity)(base.t[low:high]))
        scale = units.scale(self.signal.unit, self.quantity)[1]
        made *= np.array([[scale * self.signal.gain[k]] for k in channels])
        made += np.array([[self.signal.offset[k]] for k in channels])
        return made


def is_long(path: Path) -> bool:
    """Whether a file is better opened than read: it is large, and of a format that has rows."""
    return (
        path.is_file()
        and path.stat().st_size > LARGE
        and any(kind.by_rows and path.suffix.lower() in kind.suffixes for kind in FORMATS)
    )


def open_log(
    path: str | os.PathLike[str],
    channels: Channels | None = None,
    stretch: tuple[float, float] | None = None,
) -> Log:
    """The log that `read_log` gives of the same file, its samples left on disk.

    The file is checked once, one channel in memory at a time. `position` and `torque` are read when they are sliced
    along the samples, and can be no other way; an array made of one of them holds all of it.

    Args:
        path: Parquet or HDF5.
        channels, stretch: as for `read_log`.

    Raises:
        NotByRowsError: the format can only be read as a whole.
        LogError: as `read_log` does.
    """
    path = Path(path)
    kind, sha256 = format_of(path), sha256_of(path)
    if not kind.by_rows:
        raise NotByRowsError(path, kind.name, [other.name for other in FORMATS if other.by_rows])
    notes: list[str] = []
    if channels is None:
        channels, sentence = guess(path, kind.names(path))
        notes.append(sentence)
    survey = _Survey(path, kind, channels, stretch, notes)
    position, torque = survey.position(channels.position), survey.torque(channels.torque)
    return Log(path, sha256, survey.base.t, as_array(position), as_array(torque), channels, tuple(notes))


class _Survey:
    """A file on its way to a log: its time base, then channel after channel."""

    def __init__(
        self, path: Path, kind: Format, channels: Channels, stretch: tuple[float, float] | None, notes: list[str]
    ) -> None:
        self.path, self.kind = path, kind
        self.first = channels.sources[0]
        column = self._read(self.first)
        self.count = column.size
        if self.count == 0:
            raise EmptyLogError(path, "channels and no rows")
        raw = None if channels.time is None else column
        self.base, self.rows, self.stamps = time_base(path, channels, raw, self.count, stretch, notes)
        self.inspection = Inspection(path, self.base, notes)
        self.seen: dict[bytes, str] = {}

    def position(self, signal: Signal) -> Recorded:
        """The positions, checked."""
        scale, turns = units.scale(signal.unit, "position")[1], []

        def channels() -> Iterator[Array]:
            for name, gain, offset in zip(signal.channels, signal.gain, signal.offset, strict=True):
                raw = self._channel(name)
                kept = np.delete(raw, self.base.repeated).astype(np.float64, copy=False)
                at, shift = checks.turns(kept, signal) if signal.unwrap else UNTURNED
                turns.append((at, freeze(shift)))
                column = self.inspection.column(name, raw, signal, "position", scale * gain)
                yield self._on_grid(column) * (scale * gain) + offset

        course = Course.of(channels())
        return Recorded(self._source(), signal, "position", tuple(turns), course)

    def torque(self, signal: Signal) -> Recorded:
        """The torques, checked; after the positions."""
        scale = units.scale(signal.unit, "torque")[1]
        for name, gain in zip(signal.channels, signal.gain, strict=True):
            self.inspection.column(name, self._channel(name), signal, "torque", scale * gain)
        return Recorded(self._source(), signal, "torque", (UNTURNED,) * len(signal.channels))

    def _on_grid(self, column: Array) -> Array:
        """A position at the stamps as one on the grid, (n,)."""
        if self.base.regular:
            return column
        out = np.empty(self.base.t.size)
        resampling.interpolate(self.base, column, "position", out)
        return out

    def _source(self) -> Source:
        return Source(self.path, self.path.stat().st_size, self.kind, self.rows.start, self.base)

    def _channel(self, name: str) -> Column:
        """The rows of the stretch of one channel, (rows,), as they are in the file; what is wrong with them is said."""
        raw = self._read(name)
        if raw.size != self.count:
            raise UnequalChannelsError(self.path, self.first, self.count, name, raw.size)
        raw = raw[self.rows]
        checks.finite(self.path, name, raw, self.stamps)
        if self.base.repeated.size:
            checks.repeats(self.path, {name: raw}, self.stamps, self.base.repeated)
        if raw.min() != raw.max():
            digest = hashlib.sha256(np.ascontiguousarray(raw, dtype=np.float64).data).digest()
            if digest in self.seen:
                raise IdenticalChannelsError(self.path, self.seen[digest], name)
            self.seen[digest] = name
        return raw

    def _read(self, name: str) -> Column:
        found = self.kind.columns(self.path, (name,))
        if name not in found:
            raise MissingChannelError(self.path, name, self.kind.names(self.path))
        return found[name]
