"""Filters: the parallel filter of torque and columns, its shapes, and the causal differentiator of positions.

Sources: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III, for the
parallel filter; Tahmasebi, Taati, Mobasser and Hashtrudi-Zaad (2005), IEEE Conf. Control Applications, eqs (12) and
(13), for causal filters as a controller has them: torque and columns through L(s) = omega / (omega + s),
{d/dt x}_L = omega (x - {x}_L), velocity by a high-pass.
"""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array, freeze, freeze_fields, positive, read_only, whole
from haptid._internal.late import dataclass
from haptid._internal.roots import bracketed_root
from haptid.errors import TreatmentError

# Central differences of order eight. Relative error of their gain at a frequency f: (2 pi f dt)^8 / 630.
DIFFERENCES = (1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280)
# The same for the second derivative: (2 pi f dt)^8 / 3150.
SECOND_DIFFERENCES = (-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560)
# Half length of the Kaiser window times its cut-off: start value of the search.
KAISER_REACH = 0.4
# Cut-off, in cycles per sample, above which a Kaiser window is shorter than three samples.
WIDEST_KAISER = 0.2
# Half length of the windowed sinc in decimated samples. A longer one has a steeper transition and more transient.
SINC_HALF_LENGTH = 5
# Tail of an impulse response that is cut off, as a share of the response.
CUT = 1e-6
# Least cut-off as a share of half the sampling rate: below it an impulse response is longer than any log, and a
# Butterworth filter of high order is lost in rounding errors.
LOWEST = 1e-5
# Initial transient of a differentiator that is neglected, as a share: below double precision.
_FORGOTTEN = 1e-17
# Filters whose design is kept.
_DESIGNS = 32


@dataclass(frozen=True, eq=False)
class ParallelFilter:
    """FIR filter applied in parallel to the torque and every column of W: weights of the samples around a row's own.

    Attributes:
        taps: of torques and columns, oldest sample first, (odd,), unit sum.
        slope: taps whose weighted sum of a signal is the filtered rate of change of that signal, (odd,), 1/s; None
            where columns have accelerations and nothing is differentiated.
        before: samples before the row's own.
    """

    taps: Array
    slope: Array | None
    before: int

    def __post_init__(self) -> None:
        freeze_fields(self, "taps", slope=np.shape(self.taps))

    def __len__(self) -> int:
        return len(self.taps)

    @property
    def after(self) -> int:
        """Samples after the row's own."""
        return len(self) - 1 - self.before

    def main_part(self, outside: float) -> tuple[int, int]:
        """Samples before and after the row's own that hold all the weight but a share, half of it at each end."""
        weight = np.abs(self.taps) / np.abs(self.taps).sum()
        oldest, newest = (int(np.argmax(np.cumsum(w) > outside / 2)) for w in (weight, weight[::-1]))
        return max(self.before - oldest, 0), max(self.after - newest, 0)


def centred(taps: Array, dt: float, differentiated: bool) -> ParallelFilter:
    """Zero-phase filter of symmetric taps, (odd,); with a derivative it is longer by the central differences."""
    if not differentiated:
        return ParallelFilter(freeze(taps), None, len(taps) // 2)
    wide = np.pad(taps, len(DIFFERENCES) // 2)
    return ParallelFilter(freeze(wide), freeze(np.convolve(taps, DIFFERENCES) / dt), len(wide) // 2)


@dataclass(frozen=True)
class KaiserSmoother:
    """Kaiser window (beta 8, side lobes 58 dB down) as the filter itself, 0.4 / cutoff to either side.

    Zero phase, -3 dB at its cut-off. Its step response has no overshoot, so that a disturbed sample (a reversal, an
    end, the edge of a held-out block) affects only the rows within that distance; a steeper filter with the same
    noise bandwidth is three times as long.
    """

    name: ClassVar[str] = "kaiser"
    # Default cut-off as a share of the decimated Nyquist frequency: aliases are 20 dB down.
    share: ClassVar[float] = 0.4

    def reach(self, cutoff: float, decimation: int) -> float:
        """Approximate samples to either side, without designing the taps."""
        del decimation
        return KAISER_REACH / cutoff

    @lru_cache(maxsize=_DESIGNS)  # noqa: B019 - one instance
    def taps(self, cutoff: float, decimation: int) -> Array:
        """Weights, (odd,), unit sum; the cut-off in cycles per sample."""
        del decimation
        if cutoff > WIDEST_KAISER:  # too short for a window: three taps with the same cut-off
            side = (1 - np.sqrt(0.5)) / (2 - 2 * np.cos(2 * np.pi * cutoff))
            return read_only(np.array([side, 1 - 2 * side, side]))

        def excess(half: float) -> float:
            weight = kaiser(half)
            n = np.arange(len(weight)) - len(weight) // 2
            return float(weight @ np.cos(2 * np.pi * cutoff * n) - np.sqrt(0.5))

        reach = KAISER_REACH / cutoff
        return read_only(kaiser(bracketed_root(excess, 0.5 * reach, 2 * reach, 1e-3)))


def kaiser(half: float) -> Array:
    """Kaiser window of any half length, also a fractional one, (odd,), unit sum."""
    n = np.arange(-int(half), int(half) + 1)
    weight = np.i0(8.0 * np.sqrt(1 - (n / half) ** 2))
    return np.asarray(weight / weight.sum())


@dataclass(frozen=True)
class WindowedSinc:
    """Windowed sinc, the usual decimation filter: zero phase, -3 dB at its cut-off, 50 dB down soon above it.

    Source: Gautier, Janot and Vandanjon (2013), section III.
    """

    name: ClassVar[str] = "sinc"
    share: ClassVar[float] = 0.8

    def reach(self, cutoff: float, decimation: int) -> float:
        """Samples to either side."""
        return SINC_HALF_LENGTH * max(decimation, 0.4 / cutoff)

    @lru_cache(maxsize=_DESIGNS)  # noqa: B019 - one instance
    def taps(self, cutoff: float, decimation: int) -> Array:
        """Weights, (odd,), unit sum; the cut-off in cycles per sample."""
        half = round(self.reach(cutoff, decimation))
        n, window = np.arange(-half, half + 1), np.kaiser(2 * half + 1, 4.5)

        def design(corner: float) -> Array:
            weights = window * np.sinc(2 * corner * n)
            return np.asarray(weights / weights.sum())

        def excess(corner: float) -> float:  # a window design is -6 dB at its design frequency
            return float(abs(design(corner) @ np.cos(2 * np.pi * cutoff * n)) - np.sqrt(0.5))

        highest = min(2 * cutoff, 0.4995)
        return read_only(design(bracketed_root(excess, 0.5 * cutoff, highest, 1e-9 * cutoff)))


Shape = KaiserSmoother | WindowedSinc
SHAPES: dict[str, Shape] = {shape.name: shape for shape in (KaiserSmoother(), WindowedSinc())}


@dataclass(frozen=True)
class Causal:
    """Causal Butterworth low-pass for torque and columns, discretised by Tustin's rule; order one is omega/(omega + s).

    Its delay is the same on both sides of y = W beta; a row is of its newest sample. The gain is -3 dB at
    omega / (2 pi), which Tustin's rule lowers by a share of (omega dt)^2 / 12.

    Attributes:
        order: of the filter.
    """

    order: int = 1

    name: ClassVar[str] = "causal"
    # Default cut-off as a share of the decimated Nyquist frequency.
    share: ClassVar[float] = 0.2

    def __post_init__(self) -> None:
        if not (whole(self.order) and 1 <= self.order <= 12):
            raise bad_setting("parallel_shape.order", self.order, "a whole number from 1 to 12")

    def reach(self, cutoff: float, decimation: int) -> float:
        """Approximate half length in samples, from its slowest pole; the cut-off in cycles per sample."""
        del decimation
        return float(-np.log(CUT) / (4 * np.pi * cutoff * np.sin(np.pi / (2 * self.order))))

    def filter(self, cutoff_hz: float, dt: float, differentiated: bool) -> ParallelFilter:
        """Its truncated impulse response, and that of s L(s) where it differentiates.

        For order one, slope = omega (unit impulse - taps) to rounding, whatever the truncation.

        Raises:
            TreatmentError: the cut-off is too high or far too low for the sampling rate.
        """
        from scipy import signal  # slow to import, and few filters are causal

        expect_carried("parallel_cutoff_hz", cutoff_hz, dt)
        zeros, poles, gain = signal.butter(self.order, 2 * np.pi * cutoff_hz, analog=True, output="zpk")
        low = signal.bilinear_zpk(zeros, poles, gain, 1 / dt)
        slowest = max(float(np.abs(low[1]).max()), CUT)
        samples = int(np.ceil(np.log(CUT) / np.log(slowest))) + self.order
        impulse = np.zeros(samples + (samples + 1) % 2)  # odd
        impulse[0] = 1.0
        taps = signal.sosfilt(signal.zpk2sos(*low), impulse)[::-1]
        taps = np.asarray(taps / taps.sum())
        if not differentiated:
            return ParallelFilter(freeze(taps), None, len(taps) - 1)
        steep = signal.bilinear_zpk([*zeros, 0.0], poles, gain, 1 / dt)
        slope = signal.sosfilt(signal.zpk2sos(*steep), impulse)[::-1]
        slope = slope - slope.sum() * taps  # the derivative of a constant is zero
        return ParallelFilter(freeze(taps), freeze(slope), len(taps) - 1)


@dataclass(frozen=True)
class HighPass:
    """Causal differentiator: velocity as s omega / (s + omega) of the position, by Tustin's rule; lag 1 / omega.

    Attributes:
        cutoff_hz: omega / (2 pi), Hz.
    """

    cutoff_hz: float

    def __post_init__(self) -> None:
        if not positive(self.cutoff_hz):
            raise bad_setting("velocity.cutoff_hz", self.cutoff_hz, "a finite number above zero")

    def coefficients(self, dt: float) -> tuple[float, float]:
        """b and a of v[n] = b (q[n] - q[n-1]) + a v[n-1], b in 1/s.

        Raises:
            TreatmentError: the cut-off is too high or far too low for the sampling rate.
        """
        expect_carried("velocity.cutoff_hz", self.cutoff_hz, dt)
        x = 2 * np.pi * self.cutoff_hz * dt
        return 2 * x / (2 + x) / dt, (2 - x) / (2 + x)

    def memory(self, dt: float, share: float = _FORGOTTEN) -> int:
        """Samples after which less than a share of the initial velocity is left."""
        a = abs(self.coefficients(dt)[1])
        return 1 + int(np.ceil(np.log(share) / np.log(a))) if a > share else 1

    def velocity(self, q: Array, dt: float) -> Array:
        """Velocities of positions, both (coordinates, samples), at rest before the first sample."""
        from scipy import signal  # slow to import, and few velocities are by a high-pass

        b, a = self.coefficients(dt)
        velocity, _ = signal.lfilter([b, -b], [1.0, -a], q, axis=-1, zi=-b * q[:, :1])
        return np.asarray(velocity)


def expect_carried(name: str, cutoff_hz: float, dt: float) -> None:
    """Raise unless a cut-off lies between LOWEST and half the sampling rate."""
    nyquist = 0.5 / dt
    if cutoff_hz >= nyquist:
        raise high_cutoff(name, cutoff_hz, nyquist)
    if cutoff_hz < LOWEST * nyquist:
        raise bad_setting(name, cutoff_hz, f"at least {LOWEST * nyquist:g} Hz at this rate")


def high_cutoff(name: str, cutoff_hz: float, limit_hz: float, decimation: int = 1) -> TreatmentError:
    """Error of a cut-off at or above the Nyquist frequency after decimation."""
    return TreatmentError(
        f"{name} is {cutoff_hz:g} Hz, and must be well below {limit_hz:g} Hz, half the rate of samples or rows.",
        where=name,
        found=cutoff_hz,
        limit=limit_hz,
        advice=f"Lower {name}, or reduce the decimation." if decimation > 1 else f"Lower {name}.",
    )


def bad_setting(name: str, value: object, wanted: str) -> TreatmentError:
    """Error of a treatment's setting."""
    return TreatmentError(f"treatment {name} is {value!r}; write {wanted}.", where=name, found=value, limit=wanted)
