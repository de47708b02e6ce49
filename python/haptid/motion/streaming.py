"""Treatment of samples piece by piece, on disk or in memory, to what the treatment of all of them at once gives.

A filter without delay runs both ways. Pieces are filtered with so many samples around them that what they began and
ended with has died out to the last digit: each can be made alone, in any order, by any process.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, freeze
from haptid.log.on_disk import OnDisk, as_array
from haptid.motion.time_shift import delayed, lost

# What is left of a filter's start after the samples around a chunk, as a share.
FORGOTTEN = 1e-18
# Samples in memory that are filtered at a time.
PIECE = 2**15


@dataclass(frozen=True, eq=False)
class Filtered(OnDisk):
    """Channels through a filter and, backwards, through it again.

    Attributes:
        samples: before the filter.
        sections: second-order sections of one pass, (sections, 6).
        first: the channels' first sample, which is taken off for the while, (channels, 1).
        around: samples to either side of a chunk that it is filtered with.
    """

    samples: OnDisk
    sections: Array
    first: Array
    around: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape

    def make(self, low: int, high: int) -> Array:
        start, stop = max(low - self.around, 0), min(high + self.around, len(self))
        made = signal.sosfiltfilt(self.sections, self.samples.between(start, stop) - self.first)
        return np.asarray(made[:, low - start : high - start] + self.first)


@dataclass(frozen=True, eq=False)
class Late(OnDisk):
    """Channels so many samples later, (n, channels); see `haptid.motion.time_shift.delayed`.

    Attributes:
        samples: as they are.
        later: samples, which may be a fraction.
    """

    samples: OnDisk
    later: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape

    def make(self, low: int, high: int) -> Array:
        around = lost(self.later)
        start, stop = max(low - around, 0), min(high + around, len(self))
        return delayed(self.samples[start:stop], self.later)[low - start : high - start].T


def filtered(channels: Array, sections: Array) -> Array:
    """Each channel through the filter both ways, (n, channels).

    In memory too it goes piece by piece: what is made on the way then stays in the cache.
    """
    around = memory(sections)
    if isinstance(channels, OnDisk):
        return as_array(Filtered(channels, sections, channels.between(0, 1), around))
    n, step = len(channels), max(PIECE, 4 * around)
    samples, made = channels.T, np.empty((channels.shape[1], n))
    first = samples[:, :1]  # taken off for the while, so that what stands still is exactly still
    for low in range(0, n, step):
        high = min(low + step, n)
        start, stop = max(low - around, 0), min(high + around, n)
        piece = signal.sosfiltfilt(sections, samples[:, start:stop] - first)
        np.add(piece[:, low - start : high - start], first, out=made[:, low:high])
    return freeze(made).T


def memory(sections: Array) -> int:
    """Samples that a filter takes to forget, as its slowest pole says; not less than it is started with."""
    slowest = float(np.abs(signal.sos2zpk(sections)[1]).max())
    forgets = int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) if slowest > 0 else 0
    return max(forgets, 3 * (2 * len(sections) + 1))
