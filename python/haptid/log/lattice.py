"""Lattices of encoders that lie elsewhere than those of a log: positions are rounded to them again."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import kaiser_window, welch

# Lattices that positions are rounded to, and by how much their steps differ from the encoder's, at most.
_LATTICES, _STEPS = 8, 0.1
# Of the density of their errors: length of a segment, s, and shape of its Kaiser window.
_SEGMENT, _SHAPE = 1.0, 8.0


@dataclass(frozen=True, eq=False)
class Lattice:
    """A lattice of each channel that lies elsewhere than that of its encoder.

    Attributes:
        place: by which it is moved, as a share of its step, (channels,).
        size: its step over the encoder's, (channels,).
    """

    place: Array
    size: Array

    def rounded(self, q: Array, steps: Array) -> Array:
        """Positions, (n, channels), on it; as they are where the encoder's step is 0."""
        step = np.where(steps > 0, steps * self.size, 1.0)
        return np.where(steps > 0, (np.round(q / step - self.place) + self.place) * step, q)


def lattices(channels: int) -> tuple[Lattice, ...]:
    """Shifted and rescaled lattices for a number of channels.

    Each channel's places are spread evenly over a step, in an order of its own, and so are the sizes of the steps.
    """
    rng = np.random.default_rng(0)
    places = np.array([rng.permutation(_LATTICES) for _ in range(channels)]).T / _LATTICES
    spread = np.linspace(1 - _STEPS, 1 + _STEPS, _LATTICES)
    sizes = np.array([rng.permutation(spread) for _ in range(channels)]).T
    return tuple(map(Lattice, places, sizes))


def rounding_density(q: Array, steps: Array, dt: float) -> tuple[Array, Array]:
    """Frequencies, (bins,), Hz, and density of the error of rounding, (channels, bins), rad^2/Hz or m^2/Hz.

    It is white, step^2 / 12, where every sample is many steps from the one before. A motor that turns by less than a
    step in a sampling period rounds alike for several samples, and in the band of its motion there is more: twice as
    much for an axis at 0.6 steps a sample. So positions are rounded to other lattices; zero where a step is 0.

    Args:
        q: positions, (n, channels), rad or m.
        steps: of the encoders, (channels,).
        dt: sampling period, s.
    """
    window = kaiser_window(min(len(q), max(2, round(_SEGMENT / dt))), _SHAPE)
    every = [lattice.rounded(q, steps) - q for lattice in lattices(len(steps))]
    found = [[welch(error, dt, window) for error in errors.T] for errors in every]
    return found[0][0][0], np.mean([[power for _, power in own] for own in found], axis=0)
