"""A series that remembers: autoregressive models by Burg, their order by BIC, and rows made white with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, read_only

# Sums of squares below this share of the series' own are rounding: nothing is left to tell.
NOTHING_LEFT = 1e-24


@dataclass(frozen=True, eq=False)
class Autoregression:
    """e_t + a_1 e_(t-1) + ... + a_p e_(t-p) = white, and the same of every lower order.

    Attributes:
        filters: 1, a_1, ..., a_m of the orders m = 0..p, each (m + 1,).
        powers: variance of what each of them leaves, (p + 1,).
    """

    filters: tuple[Array, ...]
    powers: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "filters", tuple(read_only(a) for a in self.filters))
        object.__setattr__(self, "powers", read_only(self.powers))

    @property
    def order(self) -> int:
        return len(self.filters) - 1

    def whitened(self, series: Array) -> Array:
        """A stretch without gaps, (n,) or (n, columns), in units of what cannot be foreseen.

        The first rows are foreseen from the few before them (Prais and Winsten 1954, for any order): none is lost, and
        the result is the stretch times the inverse of the Cholesky factor of its covariance.
        """
        p = min(self.order, len(series))
        made = signal.lfilter(self.filters[-1], [1.0], series, axis=0) / np.sqrt(self.powers[-1])
        for k in range(p):
            made[k] = self.filters[k] @ series[k::-1] / np.sqrt(self.powers[k])
        return np.asarray(made)

    def spectrum(self, length: int) -> Array:
        """Variance in each of the frequencies of a real Fourier transform of `length` rows, (length // 2 + 1,)."""
        return np.asarray(self.powers[-1] / np.abs(np.fft.rfft(self.filters[-1], length)) ** 2)


def burg(parts: Sequence[Array], most: int) -> Autoregression:
    """The model of the best order up to `most` by BIC, from one or several stretches of a series.

    Sources: Burg (1975), Maximum Entropy Spectral Analysis; Schwarz (1978), Annals of Statistics 6.
    """
    forward, backward = [np.array(p) for p in parts], [np.array(p) for p in parts]
    n = sum(len(p) for p in parts)
    power = sum(float(p @ p) for p in parts) / n
    filters, powers = [np.ones(1)], [power]
    for _ in range(min(most, n // 4)):
        pairs = [(f[1:], b[:-1]) for f, b in zip(forward, backward, strict=True) if len(f) > 1]
        size = sum(float(f @ f + b @ b) for f, b in pairs)
        if size <= NOTHING_LEFT * n * power:
            break
        k = -2.0 * sum(float(f @ b) for f, b in pairs) / size
        forward, backward = [f + k * b for f, b in pairs], [b + k * f for f, b in pairs]
        longer = np.append(filters[-1], 0.0)
        filters.append(longer + k * longer[::-1])
        powers.append(powers[-1] * (1.0 - k**2))
    best = int(np.argmin(n * np.log(np.maximum(powers, np.finfo(float).tiny)) + np.log(n) * np.arange(len(powers))))
    return Autoregression(tuple(filters[: best + 1]), np.array(powers[: best + 1]))


def unbroken(used: np.ndarray) -> Iterator[slice]:
    """Runs of rows that count, of (rows,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], used, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        yield slice(int(start), int(stop))
