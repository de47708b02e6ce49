"""Zero-phase filtering and time shift of channels, piece by piece, in memory or on disk.

Each piece is processed with enough samples on both sides for the filter's transients to vanish in double precision, so
the result equals that of the whole log, and pieces can be computed in any order by any process.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid._internal.signals import both_ways, pole_radius
from haptid.log.lazy import OnDisk, as_array
from haptid.log.resampling import Spans

# Transient of a filter that is neglected beyond the samples around a piece, as a share.
_FORGOTTEN = 1e-18
# Samples in memory that are filtered at a time.
SAMPLES_FILTERED = 2**15


@dataclass(frozen=True, eq=False)
class Filtered(OnDisk):
    """Channels on disk through a filter forwards and backwards.

    Attributes:
        samples: before the filter.
        sections: second-order sections of one pass, of all channels or of each, (1 or channels, sections, 6).
        first: the channels' first sample, subtracted before and added after the filter, (channels, 1).
        around: samples to either side of a piece that it is filtered with.
        segments: parts that are filtered by themselves, see `Log.segments`.
    """

    samples: OnDisk
    sections: Array
    first: Array
    around: int
    segments: Spans

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape

    def make(self, low: int, high: int) -> Array:
        result = np.empty((self.shape[1], high - low))
        for a, b in self.segments:
            begin, end = max(a, low), min(b, high)
            if begin < end:
                start, stop = max(begin - self.around, a), min(end + self.around, b)
                piece = _both_ways(self.sections, self.samples.between(start, stop) - self.first)
                np.add(piece[:, begin - start : end - start], self.first, out=result[:, begin - low : end - low])
        return result


@dataclass(frozen=True, eq=False)
class Delayed(OnDisk):
    """Channels on disk shifted to later samples, (n, channels); see `delayed`.

    Attributes:
        samples: before the shift.
        later: samples, also a fraction; one number for all channels, or one for each.
        half: as in `delayed`.
    """

    samples: OnDisk
    later: float | tuple[float, ...]
    half: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.samples.shape

    def between(self, low: int, high: int) -> Array:
        return self.make(low, high)  # as fast as from the cache, and no more samples are read than these need

    def make(self, low: int, high: int) -> Array:
        around = lost(self.later, self.half)
        start, stop = max(low - around, 0), min(high + around, len(self))
        return delayed(self.samples[start:stop], self.later, self.half)[low - start : high - start].T


def filtered(channels: Array, sections: Array, segments: Spans) -> Array:
    """Each channel through the filter forwards and backwards, segment by segment, (n, channels).

    In memory too it is done piece by piece, so that intermediate results stay in the processor's cache. A segment too
    short for the filter stays as it is.

    Args:
        channels: (n, channels).
        sections: second-order sections of one pass, (sections, 6).
        segments: first sample and one past the last of each.
    """
    around = memory(sections)
    if isinstance(channels, OnDisk):
        return as_array(Filtered(channels, sections, channels.between(0, 1), around, segments))
    step = max(SAMPLES_FILTERED, 4 * around)
    samples, result = channels.T, np.empty((channels.shape[1], len(channels)))
    first = samples[:, :1]  # subtracted for the filter, so that a constant channel stays exactly constant
    for a, b in segments:
        for low in range(a, b, step):
            high = min(low + step, b)
            start, stop = max(low - around, a), min(high + around, b)
            piece = _both_ways(sections, samples[:, start:stop] - first)
            np.add(piece[:, low - start : high - start], first, out=result[:, low:high])
    return freeze(result).T


def _both_ways(sections: Array, channels: Array) -> Array:
    """Channels (channels, n) through the filter of each, both ways; as they are where there are too few samples."""
    return channels if channels.shape[1] <= padding(sections) else both_ways(sections, channels)


def padding(sections: Array) -> int:
    """Samples by which `both_ways` extends either end, at most."""
    return 3 * (2 * int(sections.shape[1]) + 1)


def memory(sections: Array) -> int:
    """Samples until the slowest filter's transient falls below FORGOTTEN; at least the padding of its ends."""
    slowest = max(pole_radius(own) for own in sections)
    forgets = int(np.ceil(np.log(_FORGOTTEN) / np.log(slowest))) if slowest > 0 else 0
    return max(forgets, padding(sections))


# Samples to either side that interpolate a channel between samples: of torques, which may jump (cubic), and of filtered
# positions, which are smooth (order seven, as accurate as their central differences).
CUBIC, SMOOTH = 2, 4


def delayed(channels: Array, samples: float | tuple[float, ...], half: int = CUBIC) -> Array:
    """Channels shifted to later samples, also by a fraction, by Lagrange interpolation, each (n, channels).

    The first and last `lost(samples, half)` samples repeat their neighbours.

    Args:
        channels: (n, channels).
        samples: one shift for all channels, or one for each.
        half: samples to either side that are interpolated between.
    """
    n, ends = len(channels), max(lost(samples, half), half)
    result, padded = np.empty((channels.shape[1], n)), np.empty(n + 2 * ends)
    shifts = np.broadcast_to(np.asarray(samples, dtype=np.float64), (channels.shape[1],))
    for channel, shift, target in zip(channels.T, shifts.tolist(), result, strict=True):
        whole_part = math.floor(shift)
        # `np.pad` takes longer than all the rest for a short log.
        padded[:ends], padded[ends : ends + n], padded[ends + n :] = channel[:1], channel, channel[-1:]
        begin, weights = ends - whole_part - half, lagrange(shift - whole_part, half)
        target[:] = np.convolve(padded[begin : begin + n + len(weights) - 1], weights, "valid")
    return freeze(result).T


@lru_cache(maxsize=64)  # the channels of a log are shifted again and again
def lagrange(x: float, half: int) -> Array:
    """Weights of the samples 1 - half .. half before a time that is x of a step before a sample, 0 <= x < 1."""
    nodes = range(1 - half, half + 1)
    return freeze(np.array([np.prod([(x - j) / (k - j) for j in nodes if j != k]) for k in nodes]))


def lost(samples: float | tuple[float, ...], half: int = CUBIC) -> int:
    """Samples at each end for which `delayed` has no neighbours to interpolate between."""
    furthest = float(np.max(np.abs(samples)))
    return int(np.ceil(furthest)) + half if furthest else 0
