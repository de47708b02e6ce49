"""Samples that stay in their file, and are read when they are sliced: for logs that are larger than memory."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike

from haptid._internal.arrays import Array, freeze
from haptid.log.resampling import PIECE

# Samples that are made together. The same ones whoever asks, so that what is made does not depend on the order.
CHUNK = PIECE
# Chunks of all arrays together that are held ready: those that one stretch of rows needs, and their neighbours.
HELD = 16


@dataclass(frozen=True, eq=False)
class Course:
    """What is asked of all of a log's positions together.

    Attributes:
        spans: least and greatest of each channel, rad or m.
        moved: how much all channels move up to each sample from the one before: squared steps, each channel's as
            shares of its own, (n,).
    """

    spans: tuple[tuple[float, float], ...]
    moved: Array

    @staticmethod
    def of(channels: Iterable[Array]) -> Course:
        """Of channels that are each (n,), one in memory at a time."""
        spans, moved = [], np.zeros(0)
        for channel in channels:
            spans.append((float(channel.min()), float(channel.max())))
            moved = moved if moved.size else np.zeros(channel.size)
            steps = np.diff(channel)
            steps *= steps
            steps /= steps.sum() or 1.0
            moved[1:] += steps
        return Course(tuple(spans), freeze(moved))


class OnDisk(ABC):
    """An array of samples (n, channels) that can be sliced along its samples, and is made chunk by chunk.

    It goes where an array of samples goes. Whoever asks NumPy for an array of it gets all of it, in memory.
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

    def course(self) -> Course:
        """How far the channels go, and when they move."""
        return Course.of(self.T)

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> Any:
        """All samples, (n, channels)."""
        return np.asarray(self.between(0, len(self)).T, dtype=dtype)


def as_array(samples: OnDisk) -> Array:
    """The same, for a field that holds an array: it is sliced like one."""
    return cast(Array, samples)


@lru_cache(maxsize=HELD)
def _chunk(array: OnDisk, k: int) -> Array:
    return array.make(k * CHUNK, min((k + 1) * CHUNK, len(array)))
