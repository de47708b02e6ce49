"""Shapes of the low-pass that torque and columns share: how it falls, and how far it reaches.

Both are finite and symmetric, so without delay, and -3 dB at their cut-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import optimize, signal

from haptid._internal.arrays import Array

# Half length of the bell times its cut-off, to begin the search with.
REACH = 0.4
# Cut-off, in cycles a sample, above which that window has no room for a shape.
WIDEST_BELL = 0.2
# Half length of the sharp one, in decimated samples. A longer one is sharper still, and reaches further.
HALF_LENGTH = 5


@dataclass(frozen=True)
class KaiserSmoother:
    """All main lobe: a Kaiser window (beta 8, side lobes 58 dB down), 0.4 / cutoff to either side.

    It rings nowhere, so that what disturbs a sample (a reversal, an end, a held-out edge) disturbs only the rows
    within that reach; a sharper filter that lets as much noise through reaches three times as far.
    """

    name: ClassVar[str] = "bell"
    # Where no cut-off is given, the share of what decimation can carry: what folds back is 20 dB down.
    share: ClassVar[float] = 0.4

    def reach(self, cutoff: float, decimation: int) -> float:
        """Samples to either side, about; known without making the weights."""
        del decimation
        return REACH / cutoff

    def taps(self, cutoff: float, decimation: int) -> Array:
        """Weights, (odd,), unit sum; the cut-off in cycles a sample."""
        del decimation
        if cutoff > WIDEST_BELL:  # too short for a window: three weights that do the same
            side = (1 - np.sqrt(0.5)) / (2 - 2 * np.cos(2 * np.pi * cutoff))
            return np.array([side, 1 - 2 * side, side])

        def excess(half: float) -> float:
            weight = kaiser(half)
            n = np.arange(len(weight)) - len(weight) // 2
            return float(weight @ np.cos(2 * np.pi * cutoff * n) - np.sqrt(0.5))

        return kaiser(float(optimize.brentq(excess, 0.5 * REACH / cutoff, 2 * REACH / cutoff, xtol=1e-3)))


def kaiser(half: float) -> Array:
    """A Kaiser window of any half length, which need not be whole, (odd,), unit sum."""
    n = np.arange(-int(half), int(half) + 1)
    weight = np.i0(8.0 * np.sqrt(1 - (n / half) ** 2))
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True)
class WindowedSinc:
    """A windowed sinc, as published recipes decimate: flat below its cut-off, 50 dB down soon above it.

    Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III.
    """

    name: ClassVar[str] = "sharp"
    share: ClassVar[float] = 0.8

    def reach(self, cutoff: float, decimation: int) -> float:
        """Samples to either side."""
        return HALF_LENGTH * max(decimation, 0.4 / cutoff)

    def taps(self, cutoff: float, decimation: int) -> Array:
        """Weights, (odd,), unit sum; the cut-off in cycles a sample."""
        half = round(self.reach(cutoff, decimation))

        def design(corner: float) -> Array:
            return np.asarray(signal.firwin(2 * half + 1, corner, fs=1.0, window=("kaiser", 4.5)))

        def excess(corner: float) -> float:  # a window design is -6 dB at the frequency it is given
            _, gain = signal.freqz(design(corner), worN=[cutoff], fs=1.0)
            return float(abs(gain[0]) - np.sqrt(0.5))

        highest = min(2 * cutoff, 0.4995)
        return design(float(optimize.brentq(excess, 0.5 * cutoff, highest, xtol=1e-9 * cutoff)))


Shape = KaiserSmoother | WindowedSinc
SHAPES: dict[str, Shape] = {shape.name: shape for shape in (KaiserSmoother(), WindowedSinc())}
