"""Measured velocities: joined to the positions where they are less noisy than differences of these.

Above a cross-over frequency a position is taken from the integral of its velocity, below it from its own channel, by
two filters whose sum is one (complementary filters; W. T. Higgins, IEEE Trans. Aerosp. Electron. Syst. 11, 321, 1975).
All that is computed from positions then has the noise of the velocities. A velocity that a drive computes from the same
positions adds nothing, and its filter would be a delay: it is coherent with their differences in the noise, too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.signals import cross_spectrum, hann_window, welch
from haptid.log.resampling import Spans
from haptid.log.spectrum import Spectrum

# Greatest deviation of a velocity's scale from that of the position's rate, and of what is left between them.
_SCALE, _LEFT = 0.05, 0.1
# Greatest delay of a velocity, in periods of the bandwidth, and the least that is said, in sampling periods.
_LATE, _SHOWN = 0.05, 0.1
# Delay of velocities, s and sampling periods, above which the positions are suspect: filters of drives have less.
_SUSPECT, _SUSPECT_PERIODS = 0.02, 3.0
# Share by which the delays of most joints differ from their median at most.
_ALIKE = 0.3
# Power of the differences over that of the velocity, in the noise, from which on the velocity is used.
_LESS = 4.0
# Coherence in the noise from which on a velocity is taken for one that was computed from the positions.
_COHERENT = 0.5
# The noise is looked at above this multiple of the bandwidth; the cross-over is this share of it.
_ABOVE, _CROSSOVER = 4.0, 0.5
# Periods of the cross-over frequency that a segment has at least.
_PERIODS = 4.0
# Segments of the spectra, samples.
_LENGTH = 512
_Joined = tuple[Array, str]


def with_velocities(position: Array, velocity: Array, segments: Spans, dt: float, names: Sequence[str]) -> _Joined:
    """Positions with the velocities in them, (n, channels), and a sentence on what was used and why.

    Args:
        position: (n, channels), rad or m.
        velocity: (n, channels), rad/s or m/s, in the order of the positions.
        segments: parts without a gap.
        dt: sampling period, s.
        names: of the velocity channels.
    """
    made = np.array(position)
    used: list[str] = []
    refused: dict[str, list[str]] = {}  # names by the reason
    delays: list[float] = []
    for k, name in enumerate(names):
        found = _Comparison(position[:, k], velocity[:, k], segments, dt)
        if found.crossover and found.left < _LEFT:
            delays.append(found.late)
        if why := found.against():
            refused.setdefault(why, []).append(name)
            continue
        late = f", {1e3 * found.late:.2g} ms late" if abs(found.late) > _SHOWN * dt else ""
        used.append(f"{name} ({100 / np.sqrt(found.noise_ratio):.2g} %{late})")
        for start, stop in segments:
            if (stop - start) * dt * found.crossover > _PERIODS:
                at = dt * np.arange(stop - start)
                rate = found.scale * np.interp(at + found.late, at, velocity[start:stop, k])
                made[start:stop, k] = _complementary(position[start:stop, k], rate, dt, found.crossover)
    parts = []
    if used:
        parts.append(
            f"velocities are less noisy than differences of the positions: {', '.join(used)} of their noise; used"
        )
    if refused:
        reasons = (f"{', '.join(own)} {why}" for why, own in refused.items())
        parts.append(f"velocities that are not used: {'; '.join(reasons)}")
    return made, "; ".join(parts + _planned(delays, len(names), dt))


def _planned(delays: Sequence[float], count: int, dt: float) -> list[str]:
    """What it says of the positions that most velocities are late on them by one time, or ahead."""
    middle = float(np.median(delays)) if delays else 0.0
    alike = sum(abs(delay - middle) < _ALIKE * abs(middle) for delay in delays)
    if 2 * alike <= count or abs(middle) < max(_SUSPECT, _SUSPECT_PERIODS * dt):
        return []
    said = f"the velocities are {1e3 * abs(middle):.3g} ms {'late on' if middle > 0 else 'ahead of'} the positions"
    if middle > 0:
        return [
            f"{said}: were they filtered, which does no harm, or are the positions the planned ones? The torque moves "
            "the measured ones, which the log should have"
        ]
    return [f"{said}: were these filtered, or read later? The torque belongs to one of both"]


class _Comparison:
    """A velocity beside the differences of its position, in the longest segment.

    Attributes:
        scale: of the position's rate over the velocity, in the band of the motion.
        left: share of the rate that the velocity leaves, there.
        late, latest: delay of the velocity, and the greatest that is made up for, s.
        noise_ratio: power of the differences over that of the velocity, above that band.
        coherence: of the two, there.
        crossover: frequency, Hz, above which the velocity is to be used; 0 where they cannot be compared.
        unclear: why they cannot.
    """

    def __init__(self, position: Array, velocity: Array, segments: Spans, dt: float) -> None:
        start, stop = max(segments, key=lambda part: part[1] - part[0])
        self.scale = self.left = self.noise_ratio = self.coherence = self.crossover = self.late = self.latest = 0.0
        q, v = position[start:stop], velocity[start:stop]
        self.unclear = "(at rest)"
        if len(q) < 2 * _LENGTH:
            self.unclear = f"({len(q)} samples without a gap, {2 * _LENGTH} are needed to compare noise)"
            return
        if not np.ptp(v):
            return
        bandwidth = Spectrum.of(np.cumsum(v) * dt, dt).bandwidth
        rate = np.gradient(q, dt)
        length = min(len(q) // 2, max(_LENGTH, round(8 / (bandwidth * dt)) if bandwidth else 0))
        window = hann_window(length)
        f, both = cross_spectrum(rate, v, dt, window)
        own, other = (welch(x, dt, window)[1] for x in (rate, v))
        band, noise = f <= max(bandwidth, 2 * f[1]), (f > _ABOVE * bandwidth) & (f < 0.4 / dt)
        if not bandwidth:
            return
        if not noise.any():
            self.unclear = f"(motion up to {bandwidth:.2g} Hz leaves no room for noise below {0.4 / dt:.2g} Hz)"
            return
        self.crossover = _CROSSOVER * bandwidth
        w = 2 * np.pi * f[band]
        self.late = float(np.sum(w * both[band].imag) / max(np.sum(w**2 * np.abs(both[band])), 1e-300))
        both[band] *= np.exp(-1j * w * self.late)
        self.scale = float(both[band].real.sum() / other[band].sum())
        self.latest = _LATE / bandwidth
        self.left = float(np.sqrt(max(0.0, 1 - np.abs(both[band].sum()) ** 2 / (own[band].sum() * other[band].sum()))))
        self.noise_ratio = float(own[noise].sum() / other[noise].sum())
        self.coherence = float(np.mean(np.abs(both[noise]) ** 2 / np.maximum(own[noise] * other[noise], 1e-300)))

    def against(self) -> str:
        """Why the velocity is not to be used; empty where it is."""
        if not self.crossover:
            return self.unclear
        if abs(self.late) > self.latest:
            return f"({1e3 * self.late:.3g} ms late, or of another joint)"
        if abs(self.scale - 1) > _SCALE:
            return f"(the rate of its position is {self.scale:.4g} times it: check its unit and its order)"
        if self.left > _LEFT:
            return f"(it leaves {100 * self.left:.2g} % of its position's rate: of another joint?)"
        if self.coherence > _COHERENT:
            return f"(computed from the positions: coherence {self.coherence:.2g} in the noise)"
        if self.noise_ratio < _LESS:
            return f"(no less noisy than differences: {100 / np.sqrt(max(self.noise_ratio, 1e-12)):.3g} %)"
        return ""


def _complementary(position: Array, velocity: Array, dt: float, crossover: float) -> Array:
    """The position below a frequency, and the integral of the velocity above it, (n,)."""
    from scipy.signal import butter, sosfiltfilt  # takes a while to load

    integral = np.concatenate([[0.0], np.cumsum(0.5 * dt * (velocity[1:] + velocity[:-1]))])
    slow = butter(2, min(crossover * dt * 2, 0.9), output="sos")
    return np.asarray(integral + sosfiltfilt(slow, position - integral))
