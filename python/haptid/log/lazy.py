"""Arrays of samples that stay on disk and are read when sliced, for logs larger than memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.errors import LogFileError
from haptid.log import checks, resampling
from haptid.log.formats.folders import log_size

if TYPE_CHECKING:
    from haptid.log.file_format import Format
    from haptid.log.inspection import ChannelKind
    from haptid.log.log import Signal

# Samples that are computed together, at fixed places, so that the result does not depend on what is sliced first.
CHUNK = resampling.SAMPLES_RESAMPLED
# Chunks of all arrays that are cached: those that one segment of rows needs, and their neighbours.
HELD = 16


@dataclass(frozen=True, eq=False)
class MotionProfile:
    """Range of each position channel, and the activity of all of them over time.

    Attributes:
        spans: minimum and maximum of each channel, rad or m.
        activity: squared steps from the sample before, each channel's normalised to unit sum, added up, (n,).
    """

    spans: tuple[tuple[float, float], ...]
    activity: Array

    @staticmethod
    def of(channels: Iterable[Array], segments: resampling.Spans = ()) -> MotionProfile:
        """Of channels that are each (n,), one in memory at a time; steps between segments do not count."""
        breaks = [start for start, _ in segments[1:]]
        spans, activity = [], np.zeros(0)
        for channel in channels:
            spans.append((float(channel.min()), float(channel.max())))
            activity = activity if activity.size else np.zeros(channel.size)
            steps = np.diff(channel)
            steps[[k - 1 for k in breaks]] = 0.0
            steps *= steps
            steps /= steps.sum() or 1.0
            activity[1:] += steps
        return MotionProfile(tuple(spans), freeze(activity))


class OnDisk(ABC):
    """An array of samples (n, channels) that is computed chunk by chunk when sliced along its samples.

    It can be passed wherever an array of samples can. Converted to a NumPy array, all of it is read into memory.
    """

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """(n, channels)."""

    @abstractmethod
    def make(self, low: int, high: int) -> Array:
        """Samples low..high, (channels, high - low)."""

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> Array:
        """The samples of a slice without a step, (m, channels), each channel contiguous."""
        low, high, _ = rows.indices(len(self))
        return freeze(self.between(low, high)).T

    def between(self, low: int, high: int) -> Array:
        """Samples low..high, (channels, high - low)."""
        out = np.empty((self.shape[1], max(high - low, 0)))
        for k in range(low // CHUNK, -(-high // CHUNK)):
            start, stop = max(low, k * CHUNK), min(high, (k + 1) * CHUNK)
            out[:, start - low : stop - low] = _chunk(self, k)[:, start - k * CHUNK : stop - k * CHUNK]
        return out

    @property
    def T(self) -> Iterator[Array]:
        """Channel after channel, each (n,), one in memory at a time."""
        for k in range(self.shape[1]):
            yield self.channel(k)

    def channel(self, k: int) -> Array:
        """One channel, (n,)."""
        return np.concatenate([_chunk(self, chunk)[k] for chunk in range(-(-len(self) // CHUNK))])

    def profile(self) -> MotionProfile:
        """Range and activity of the channels."""
        return MotionProfile.of(self.T)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Any:
        """All samples, (n, channels)."""
        return np.asarray(self.between(0, len(self)).T, dtype=dtype)


@dataclass(frozen=True, eq=False)
class PartlyInMemory(OnDisk):
    """Channels on disk of which some ranges of samples are kept in memory, each from the first slice within it on.

    Attributes:
        samples: all of them.
        ranges: first sample and one past the last of each, increasing.
    """

    samples: OnDisk
    ranges: tuple[tuple[int, int], ...]
    _kept: dict[int, Array] = field(default_factory=dict, init=False, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape

    def make(self, low: int, high: int) -> Array:
        return self.samples.make(low, high)

    def between(self, low: int, high: int) -> Array:
        k = bisect_right(self.ranges, low, key=lambda one: one[0]) - 1
        if k < 0 or high > self.ranges[k][1]:
            return self.samples.between(low, high)
        start, stop = self.ranges[k]
        if k not in self._kept:
            self._kept[k] = freeze(self.samples.between(start, stop))
        return self._kept[k][:, low - start : high - start]

    def channel(self, k: int) -> Array:
        return self.samples.channel(k)


def as_array(samples: OnDisk) -> Array:
    """The same object, typed as an array, for a field that holds an array: it is sliced like one."""
    return cast(Array, samples)


@lru_cache(maxsize=HELD)
def _chunk(array: OnDisk, k: int) -> Array:
    return array.make(k * CHUNK, min((k + 1) * CHUNK, len(array)))


@dataclass(frozen=True, eq=False)
class LazySource:
    """The rows of a file, or of a folder of files, that a log consists of.

    Attributes:
        path, size: of the file or folder; size in bytes.
        kind: its format.
        first: row of the first sample.
    """

    path: Path
    size: int
    kind: Format
    first: int

    def raw(self, names: tuple[str, ...], low: int, high: int) -> Array:
        """Rows low..high, in the file's unit, (channels, high - low).

        Raises:
            LogFileError: the file's size has changed.
        """
        size = log_size(self.path)
        if size != self.size:
            raise LogFileError(
                f"{self.path} has {size} bytes, and had {self.size} when it was checked.",
                where=self.path,
                found=size,
                limit=self.size,
                advice="Wait until nothing writes to it, and start again; another machine requires the same file.",
            )
        columns = self.kind.rows(self.path, names, self.first + low, self.first + high)
        return np.stack([column.astype(np.float64, copy=False) for column in columns])


@dataclass(frozen=True, eq=False)
class SignalOnDisk(OnDisk):
    """The channels of a signal on the uniform grid, in SI, read from the file when sliced.

    Attributes:
        source: the file.
        grid: how its rows come to the grid.
        signal, quantity: which channels, and their quantity.
        wraps: rows at which each channel jumps by whole periods, and the offset to subtract from there on.
        known: profile of the positions, computed while the file was checked.
    """

    source: LazySource
    grid: resampling.Resampling
    signal: Signal
    quantity: ChannelKind
    wraps: tuple[tuple[NDArray[np.intp], Array], ...]
    known: MotionProfile | None = None

    @property
    def shape(self) -> tuple[int, int]:
        return self.grid.t.size, len(self.signal.channels)

    def make(self, low: int, high: int) -> Array:
        return self._made(low, high, range(self.shape[1]))

    def channel(self, k: int) -> Array:
        step = len(self) if self.grid.unchanged else CHUNK
        starts = range(0, len(self), step)
        return np.concatenate([self._made(a, min(a + step, len(self)), range(k, k + 1))[0] for a in starts])

    def profile(self) -> MotionProfile:
        return MotionProfile.of(self.T, self.grid.segments) if self.known is None else self.known

    def _made(self, low: int, high: int, channels: range) -> Array:
        """Samples low..high of some channels, (channels, high - low), rad, m or the torques' unit."""
        start, stop = self.grid.rows(low, high)
        made = self.signal.register.signed(
            self.source.raw(tuple(self.signal.channels[k] for k in channels), start, stop)
        )
        for column, k in zip(made, channels, strict=True):
            if self.wraps[k][0].size:
                column -= checks.wrap_offset(*self.wraps[k], start, stop)
        made = self.grid.make(made, start, low, high, self.quantity)
        scales = self.signal.scales(self.quantity)
        made *= np.array([[scales[k] * self.signal.gain[k]] for k in channels])
        made += np.array([[self.signal.offset[k]] for k in channels])
        return made
