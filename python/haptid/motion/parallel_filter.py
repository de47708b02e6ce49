"""The finite filter that torque and every column of W share, and its derivative for what has no acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, read_only

# Central differences of order eight. Their gain at a frequency f is that of d/dt but for (2 pi f dt)^8 / 630.
DIFFERENCES = (1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280)
# The same for the second derivative: but for (2 pi f dt)^8 / 3150.
SECOND_DIFFERENCES = (-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560)


@dataclass(frozen=True, eq=False)
class ParallelFilter:
    """Weights of the samples around a row's own, oldest first.

    Attributes:
        taps: of torques and columns, (odd,), unit sum.
        slope: of a signal, such that its weighted sum is the filtered rate of change of that signal, (odd,), 1/s; None
            where columns have accelerations and nothing is to be differentiated.
        before: samples before the row's own.
    """

    taps: Array
    slope: Array | None
    before: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", read_only(self.taps))
        if self.slope is not None:
            object.__setattr__(self, "slope", read_only(self.slope))
            expect("slope", self.slope.shape, self.taps.shape)

    def __len__(self) -> int:
        return len(self.taps)

    @property
    def after(self) -> int:
        """Samples after the row's own."""
        return len(self) - 1 - self.before

    def main_part(self, outside: float) -> tuple[int, int]:
        """Samples before and after the row's own that hold all the weight but a share, half of that at each end."""
        weight = np.abs(self.taps) / np.abs(self.taps).sum()
        oldest, newest = (int(np.argmax(np.cumsum(w) > outside / 2)) for w in (weight, weight[::-1]))
        return max(self.before - oldest, 0), max(self.after - newest, 0)


def centred(taps: Array, dt: float, differentiated: bool) -> ParallelFilter:
    """A symmetric filter, (odd,), about the row's own sample: it has no delay. Differentiated it is longer."""
    if not differentiated:
        return ParallelFilter(freeze(taps), None, len(taps) // 2)
    wide = np.pad(taps, len(DIFFERENCES) // 2)
    return ParallelFilter(freeze(wide), freeze(np.convolve(taps, DIFFERENCES) / dt), len(wide) // 2)
