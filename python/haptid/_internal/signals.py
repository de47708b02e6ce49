"""Butterworth and polynomial filters, and spectra of sampled signals: what every identification calls.

They are those of `scipy.signal`, which the tests compare them with. Importing that module loads `scipy.stats` and a
third of SciPy, and takes longer than all that an identification of a short log computes.
"""

from __future__ import annotations

from functools import lru_cache
from math import factorial

import numpy as np
from numpy import fft

from haptid import _core
from haptid._internal.arrays import Array, freeze

# Samples that a polynomial filter takes at a time: its sums stay in the processor's cache.
_IN_CACHE = 1 << 14


def butterworth(order: int, cutoff: float) -> Array:
    """Second-order sections of a Butterworth low-pass, (sections, 6), by the bilinear transform.

    Args:
        order: of the filter.
        cutoff: -3 dB, as a share of half the sampling rate.
    """
    warped = 4 * np.tan(0.5 * np.pi * cutoff)
    analog = -warped * np.exp(0.5j * np.pi * np.arange(1 - order, 1, 2) / order)  # one of each pair
    poles = (4 + analog) / (4 - analog)
    sections = np.zeros((len(poles), 6))
    for section, p in zip(sections, poles, strict=True):
        single = p.imag == 0 or (order % 2 == 1 and p is poles[-1])
        section[:2] = 1.0
        section[3:5] = 1.0, -p.real if single else -2 * p.real
        if not single:
            section[1:3], section[5] = (2.0, 1.0), abs(p) ** 2
    sections = sections[np.argsort(np.abs(poles))]  # the most resonant section last
    sections[:, :3] *= (sections[:, 3:].sum(axis=1) / sections[:, :3].sum(axis=1))[:, None]  # unit gain of a constant
    return sections


def pole_radius(sections: Array) -> float:
    """Largest magnitude of a pole of second-order sections, (sections, 6)."""
    a1, a2 = sections[:, 4], sections[:, 5]
    square = a1**2 - 4 * a2  # negative for a pair of complex poles, whose product a2 is
    radii = np.where(square < 0, np.sqrt(np.abs(a2)), 0.5 * (np.abs(a1) + np.sqrt(np.maximum(square, 0.0))))
    return float(radii.max())


def both_ways(sections: Array, channels: Array, padding: int | None = None) -> Array:
    """Filter forwards and backwards, (channels, n) to (channels, n).

    Both ends are extended by the signal turned about its end point, and the filter starts in the steady state of its
    first value, as in `scipy.signal.sosfiltfilt`.

    Args:
        sections: second-order sections of one pass, (sections, 6), or those of each channel, (channels, sections, 6).
        channels: longer than the extension.
        padding: samples of the extension; three times the filter's length, the longest one's, where None.
    """
    x = np.ascontiguousarray(channels, dtype=np.float64)
    each = np.ascontiguousarray(np.broadcast_to(sections, (len(x), *sections.shape[-2:])))
    return _core.filter_both_ways(each, x, max(map(end_padding, each)) if padding is None else padding)


def end_padding(sections: Array) -> int:
    """Samples by which `both_ways` extends either end."""
    short = min(int((sections[:, 2] == 0).sum()), int((sections[:, 5] == 0).sum()))
    return 3 * (2 * len(sections) + 1 - short)


def polynomial_filter(x: Array, window: int, degree: int, order: int = 0) -> Array:
    """Derivative of a polynomial fitted to the samples around each, per sample, along the first axis.

    At the ends it is that of the polynomial of the first and the last window.

    Source: Savitzky and Golay (1964), Analytical Chemistry 36(8).

    Args:
        x: signals, (n, ...), not shorter than the window.
        window: samples of the fit, odd.
        degree: of the polynomial.
        order: of the derivative.
    """
    x, (fit, basis) = np.asarray(x, dtype=np.float64), _polynomials(window, degree, order)
    half = window // 2
    filtered, weights = np.empty(x.shape), basis[half] @ fit
    step = max(window, _IN_CACHE // max(1, x[:1].size))
    for low in range(half, len(x) - half, step):
        high = min(low + step, len(x) - half)
        filtered[low:high] = paired_sums(x[low - half : high + half], weights)
    filtered[:half] = np.tensordot(basis[:half] @ fit, x[:window], axes=1)
    filtered[-half:] = np.tensordot(basis[-half:] @ fit, x[-window:], axes=1)
    return filtered


@lru_cache(maxsize=16)
def _polynomials(window: int, degree: int, order: int) -> tuple[Array, Array]:
    """Coefficients from a window's samples, (degree + 1, window); derivative at each, (window, degree + 1)."""
    k = np.arange(window) / (window // 2) - 1.0
    powers = np.arange(degree + 1)
    factors = np.array([factorial(p) / factorial(p - order) if p >= order else 0.0 for p in powers])
    basis = factors * k[:, None] ** np.maximum(powers - order, 0) / (window // 2) ** order
    return freeze(np.asarray(np.linalg.pinv(k[:, None] ** powers), dtype=np.float64)), freeze(basis)


def paired_sums(x: Array, weights: Array | tuple[float, ...]) -> Array:
    """Sums of samples around each with symmetric or antisymmetric weights, (n, ...) to (n - len(weights) + 1, ...).

    Samples at equal distances are added first: antisymmetric weights of a constant signal give exactly zero, so that
    dry friction has no sign at rest.
    """
    w = np.asarray(weights)
    half, count = len(w) // 2, len(x) - len(w) + 1
    symmetric = np.abs(w - w[::-1]).sum() < np.abs(w + w[::-1]).sum()
    sums = np.asarray(x[half : half + count] * w[half])
    for k in range(half):
        after = x[2 * half - k : 2 * half - k + count]
        sums += (x[k : k + count] + after if symmetric else x[k : k + count] - after) * w[k]
    return sums


@lru_cache(maxsize=64)
def fast_length(n: int) -> int:
    """Least length, of `n` at least, whose only prime factors are 2, 3 and 5: its real Fourier transform is fast."""
    best = 1 << max(n - 1, 0).bit_length()
    fives = 1
    while fives < best:
        odd = fives
        while odd < best:
            best = min(best, odd << (-(-n // odd) - 1).bit_length())
            odd *= 3
        fives *= 5
    return best


def running_maximum(x: Array, length: int) -> Array:
    """Largest of the `length` samples around each, of those that there are, (n,); from `length // 2` samples before.

    Source: van Herk (1992), Pattern Recognition Letters 13(7): maxima from either end of blocks of this length.
    """
    rows = np.full((-(-(len(x) + length - 1) // length), length), -np.inf)
    rows.reshape(-1)[length // 2 : length // 2 + len(x)] = x
    to_here = np.maximum.accumulate(rows, axis=1).reshape(-1)
    from_here = np.maximum.accumulate(rows[:, ::-1], axis=1)[:, ::-1].reshape(-1)
    return np.asarray(np.maximum(from_here[: len(x)], to_here[length - 1 : length - 1 + len(x)]))


def running_mean(x: Array, length: int) -> Array:
    """Mean of the `length` samples around each, (n,), from `length // 2` before; beyond the ends the signal turns."""
    wide = np.pad(x, (length // 2, length - 1 - length // 2), "symmetric")
    total = np.concatenate([[0.0], np.cumsum(wide)])
    return np.asarray((total[length:] - total[:-length]) / length)


def without_line(x: Array) -> Array:
    """A signal less its straight line of least squares, along the last axis."""
    t = np.arange(x.shape[-1]) - 0.5 * (x.shape[-1] - 1)
    level = x - x.mean(axis=-1, keepdims=True)
    return np.asarray(level - (level @ t / (t @ t))[..., None] * t) if len(t) > 1 else level


def welch(x: Array, dt: float, window: Array, line: bool = False) -> tuple[Array, Array]:
    """Frequencies, Hz, and one-sided power density of a signal, from windows that overlap by half.

    Source: Welch (1967), IEEE Trans. Audio and Electroacoustics 15(2).

    Args:
        x: (n,), not shorter than the window.
        dt: sampling period, s.
        window: weights of a segment's samples.
        line: whether each segment's straight line is removed, and not only its mean.
    """
    spectra = segment_spectra(x, window, line)
    return _density(np.mean(np.abs(spectra) ** 2, axis=0), dt, window)


def cross_spectrum(x: Array, y: Array, dt: float, window: Array) -> tuple[Array, np.ndarray]:
    """Frequencies, Hz, and one-sided cross power density of two signals, complex, as `welch` gives that of one."""
    first, second = (segment_spectra(signal, window, line=False) for signal in (x, y))
    return _density(np.mean(first * second.conj(), axis=0), dt, window)


def segment_spectra(x: Array, window: Array, line: bool = False) -> np.ndarray:
    """Transforms of the windowed segments of a signal, (segments, bins)."""
    length = len(window)
    segments = np.lib.stride_tricks.sliding_window_view(x, length)[:: length - length // 2]
    level = without_line(segments) if line else segments - segments.mean(axis=-1, keepdims=True)
    return np.asarray(fft.rfft(level * window, axis=-1))


def _density(products: np.ndarray, dt: float, window: Array) -> tuple[Array, np.ndarray]:
    """Frequencies, and mean products of transforms as one-sided density, (bins,)."""
    length = len(window)
    density = products * (dt / (window @ window))
    density[1 : -1 if length % 2 == 0 else None] *= 2
    return np.asarray(fft.rfftfreq(length, dt), dtype=np.float64), density


@lru_cache(maxsize=8)  # all channels of a log have the same
def kaiser_window(length: int, beta: float) -> Array:
    """Kaiser window of one period."""
    return freeze(np.kaiser(length + 1, beta)[:-1])


def hann_window(length: int) -> Array:
    """Hann window of one period."""
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length))
