"""Causal filters, as a controller has them: a low-pass for torque and columns, a differentiator for the velocity.

Source: Tahmasebi, Taati, Mobasser and Hashtrudi-Zaad (2005), IEEE Conf. Control Applications, eqs (12) and (13):
torque and columns through L(s) = omega / (omega + s), {d/dt x}_L = omega (x - {x}_L), velocity by a high-pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, freeze, positive, whole
from haptid.errors import CutoffError, TreatmentValueError
from haptid.motion.parallel_filter import ParallelFilter

# An impulse response is cut where what is left of it weighs less than this.
CUT = 1e-6
# Below this share of half the sampling rate the response is longer than any log.
LOWEST = 1e-5
# A differentiator is started so much earlier that its start weighs less than this: nothing, in double precision.
FORGOTTEN = 1e-17


@dataclass(frozen=True)
class Causal:
    """A Butterworth low-pass for torque and columns, of order one L(s) = omega / (omega + s), by Tustin's rule.

    It has delay, the same on both sides of y = W beta; a row is of its newest sample. The gain is -3 dB at
    omega / (2 pi), but for a share (omega dt)^2 / 12 by which Tustin's rule lowers that frequency.

    Attributes:
        order: of the filter.
    """

    order: int = 1

    name: ClassVar[str] = "causal"
    # Where no cut-off is given, the share of what decimation can carry.
    share: ClassVar[float] = 0.2

    def __post_init__(self) -> None:
        if not (whole(self.order) and 1 <= self.order <= 12):
            raise TreatmentValueError("parallel_shape.order", self.order, "a whole number from 1 to 12")

    def reach(self, cutoff: float, decimation: int) -> float:
        """Half its samples, about, from its slowest pole; the cut-off in cycles a sample."""
        del decimation
        return float(-np.log(CUT) / (4 * np.pi * cutoff * np.sin(np.pi / (2 * self.order))))

    def filter(self, cutoff_hz: float, dt: float, differentiated: bool) -> ParallelFilter:
        """Its impulse response, cut where it has died out, and where it is to differentiate, that of s L(s).

        Of order one, slope = omega (unit impulse - taps) to rounding, whatever was cut.

        Raises:
            CutoffError, TreatmentValueError: the sampling rate cannot carry the cut-off, or it is far too low for it.
        """
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
        slope = slope - slope.sum() * taps  # a constant has no rate of change
        return ParallelFilter(freeze(taps), freeze(slope), len(taps) - 1)


@dataclass(frozen=True)
class HighPass:
    """Velocity as s omega / (s + omega) of the position, by Tustin's rule: it lags by 1 / omega.

    Attributes:
        cutoff_hz: omega / (2 pi), Hz.
    """

    cutoff_hz: float

    def __post_init__(self) -> None:
        if not positive(self.cutoff_hz):
            raise TreatmentValueError("velocity.cutoff_hz", self.cutoff_hz, "a finite number above zero")

    def coefficients(self, dt: float) -> tuple[float, float]:
        """b and a of v[n] = b (q[n] - q[n-1]) + a v[n-1], b in 1/s.

        Raises:
            CutoffError, TreatmentValueError: the sampling rate cannot carry the cut-off, or it is far too low for it.
        """
        expect_carried("velocity.cutoff_hz", self.cutoff_hz, dt)
        x = 2 * np.pi * self.cutoff_hz * dt
        return 2 * x / (2 + x) / dt, (2 - x) / (2 + x)

    def memory(self, dt: float, share: float = FORGOTTEN) -> int:
        """Samples after which less than a share of what the velocity was at the start is left."""
        a = abs(self.coefficients(dt)[1])
        return 1 + int(np.ceil(np.log(share) / np.log(a))) if a > share else 1

    def velocity(self, q: Array, dt: float) -> Array:
        """Velocities of positions, both (coordinates, samples), at rest before the first sample."""
        b, a = self.coefficients(dt)
        made, _ = signal.lfilter([b, -b], [1.0, -a], q, axis=-1, zi=-b * q[:, :1])
        return np.asarray(made)


def expect_carried(name: str, cutoff_hz: float, dt: float) -> None:
    """Raise unless a sampling rate can carry a cut-off."""
    nyquist = 0.5 / dt
    if cutoff_hz >= nyquist:
        raise CutoffError(name, cutoff_hz, nyquist)
    if cutoff_hz < LOWEST * nyquist:
        raise TreatmentValueError(name, cutoff_hz, f"at least {LOWEST * nyquist:g} Hz at this rate")
