"""Zero-phase filtering and time shift of channels, piece by piece, in memory or on disk.

Each piece is processed with enough samples on both sides for the filter's transients to vanish in double precision, so
the result equals that of the whole log, and pieces can be computed in any order by any process.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, freeze
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
        sections: second-order sections of one pass, (sections, 6).
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
        made = np.empty((self.shape[1], high - low))
        for a, b in self.segments:
            begin, end = max(a, low), min(b, high)
            if begin < end:
                start, stop = max(begin - self.around, a), min(end + self.around, b)
                piece = _both_ways(self.sections, self.samples.between(start, stop) - self.first)
                np.add(piece[:, begin - start : end - start], self.first, out=made[:, begin - low : end - low])
        return made


@dataclass(frozen=True, eq=False)
class Late(OnDisk):
    """Channels on disk shifted to later samples, (n, channels); see `delayed`.

    Attributes:
        samples: before the shift.
        later: samples, also a fraction.
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
    samples, made = channels.T, np.empty((channels.shape[1], len(channels)))
    first = samples[:, :1]  # subtracted for the filter, so that a constant channel stays exactly constant
    for a, b in segments:
        for low in range(a, b, step):
            high = min(low + step, b)
            start, stop = max(low - around, a), min(high + around, b)
            piece = _both_ways(sections, samples[:, start:stop] - first)
            np.add(piece[:, low - start : high - start], first, out=made[:, low:high])
    return freeze(made).T


def _both_ways(sections: Array, samples: Array) -> Array:
    """The samples through the filter forwards and backwards, (channels, n); as they are where too few."""
    if samples.shape[1] <= padding(sections):
        return samples
    return np.asarray(signal.sosfiltfilt(sections, samples))


def padding(sections: Array) -> int:
    """Samples by which `sosfiltfilt` extends either end, at most."""
    return 3 * (2 * len(sections) + 1)


def memory(sections: Array) -> int:
    """Samples until a filter's transient falls below FORGOTTEN, by its slowest pole; at least sosfiltfilt's padding."""
    slowest = float(np.abs(signal.sos2zpk(sections)[1]).max())
    forgets = int(np.ceil(np.log(_FORGOTTEN) / np.log(slowest))) if slowest > 0 else 0
    return max(forgets, padding(sections))


def delayed(channels: Array, samples: float) -> Array:
    """Channels shifted to later samples, also by a fraction, by cubic interpolation, each (n, channels).

    The first and last `lost(samples)` samples repeat their neighbours.
    """
    whole_part = int(np.floor(samples))
    x = samples - whole_part  # between the samples n - whole_part - 1 (1) and n - whole_part (0)
    weights = {
        -1: -x * (x - 1) * (x - 2) / 6,
        0: (x + 1) * (x - 1) * (x - 2) / 2,
        1: -(x + 1) * x * (x - 2) / 2,
        2: (x + 1) * x * (x - 1) / 6,
    }
    n, ends = len(channels), lost(samples)
    made = np.zeros((channels.shape[1], n))
    for channel, out in zip(channels.T, made, strict=True):
        padded = np.pad(channel, ends, mode="edge")
        for back, weight in weights.items():
            if weight:
                begin = ends - whole_part - back
                out += weight * padded[begin : begin + n]
    return freeze(made).T


def lost(samples: float) -> int:
    """Samples at each end for which `delayed` has no neighbours to interpolate between."""
    return int(np.ceil(abs(samples))) + 2 if samples else 0
