"""Spectra of position channels: motion and noise apart, the motion's bandwidth, and the filter that suits both.

An encoder's noise is seldom white: quantisation of slow motion, ripple and a transmission's ratio colour it, and a
floor measured near the Nyquist frequency then leaves much of it to be taken for motion. Two facts tell them apart at
any colour: the power of encoder noise rises towards low frequencies no faster than f^-3, and motion of finite jerk
falls at f^-6 or faster.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import kaiser_window, welch, without_line

if TYPE_CHECKING:
    from haptid.log.log import Log

# Kaiser window of the spectra: its side lobes, 105 dB down, are finer than an encoder.
_SHAPE = 14.0
# Length of the log over that of the segments whose spectra are averaged; fewest samples of a segment.
_SEGMENTS, _FEWEST = 2, 256
# Bands of the noise in an octave, and the exponent of frequency by which its power rises at most.
_BANDS, _STEEPEST = 6, 3.0
# Motion is where the mean power of five bins, and of half an octave, exceeds the noise by these factors.
_ABOVE, _ABOVE_WIDE = 6.0, 3.0
# Share of the velocity's power below the motion's bandwidth, and of the acceleration's below its very end.
_SHARE, _END = 0.98, 0.999
# Share of the largest power of velocity among several logs, or channels, above which one moves.
_MOVES = 0.01
# Share of the filtered acceleration's power that may be noise before the filter is narrowed.
_TOLERATED = 0.003
# RMS of what ripple may be, in steps of the encoder, and as a share of the motion where they are not known: a channel
# that was resampled lies on no lattice.
_STEPS, _SMALL = 4.0, 1e-2
# Share of the position's power that may be left out as ripple at most.
_BULK = 0.01
# Order of one pass of the position filter that cut-offs are chosen for.
_ORDER = 4
# Cut-offs tried between the lowest and the highest.
_TRIED = 80
# Values of a channel over its samples above which they do not recur; distance from a lattice, steps, that is rounding.
_RECUR, _OFF_LATTICE = 0.75, 0.05
# Fewer distinct values say nothing of a lattice.
_FEWEST_LEVELS = 4
# Longest segment, samples; longer logs are averaged over more segments.
_LONGEST_SEGMENT = 1 << 17


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power density of a position channel, motion and noise apart.

    Attributes:
        f: frequencies, (bins,), Hz.
        motion, noise: power densities, (bins,), rad^2/Hz or m^2/Hz.
        step: resolution of the encoder, rad or m; 0 where the values lie on no lattice.
        recorded: the same of the positions as they were recorded, where they were resampled since; 0 elsewhere.
        bandwidth: below it lies a share _SHARE of the velocity's power, Hz; 0 where nothing exceeds the noise.
        upper: mean of the power density in the upper half of the frequencies, rad^2/Hz or m^2/Hz.
    """

    f: Array
    motion: Array
    noise: Array
    step: float
    bandwidth: float
    recorded: float = 0.0
    upper: float = 0.0

    @staticmethod
    def of(channel: Array, dt: float, highest: float | None = None) -> Spectrum:
        """Welch's spectrum of a channel, (n,), and its parts.

        Args:
            channel: positions on a uniform grid.
            dt: its step, s.
            highest: frequency up to which the channel has its content, Hz; the Nyquist frequency where None.
        """
        n = len(channel)
        length = min(max(min(n, _FEWEST), n // _SEGMENTS), _LONGEST_SEGMENT)
        # A line is removed first: the window of so few segments leaks a drift into its neighbours.
        f, power = welch(without_line(channel), dt, kaiser_window(length, _SHAPE), line=True)
        inner = slice(1, -1) if highest is None else (f > 0) & (f <= highest) & (f < f[-1])
        made = _apart(f[inner], power[inner], quantum(channel))
        return replace(made, upper=float(power[inner][made.f >= 0.5 * made.f[-1]].mean()))

    @property
    def noise_rms(self) -> float:
        """RMS of the noise, rad or m."""
        return float(np.sqrt(np.sum(self.noise) * (self.f[1] - self.f[0])))

    @property
    def motion_rms(self) -> float:
        """RMS of the motion, rad or m."""
        return float(np.sqrt(np.sum(self.motion) * (self.f[1] - self.f[0])))

    def white(self, dt: float) -> float:
        """Variance of the white noise of a sample, rad^2 or m^2: of rounding, or of what is found far above the motion.

        Positions of a fine encoder seldom recur, and then its step is not known. `noise` is no estimate of it: it is
        chosen to lie above most single bins.

        Args:
            dt: sampling period, s.
        """
        if self.step or self.recorded:
            return (self.step or self.recorded) ** 2 / 12
        return self.upper / (2 * dt)

    def narrowed(self) -> Spectrum:
        """The same with only the bulk of the position's power as motion, and all above as noise.

        Ripple of an encoder moves with the motion, and no spectrum of positions alone tells them apart; but it is a few
        steps of the encoder only. Itself without motion.
        """
        if not self.bandwidth:
            return self
        df, total = self.f[1] - self.f[0], np.cumsum(self.motion)
        step = self.step or self.recorded
        least = (_STEPS * step) ** 2 / df if step else _SMALL**2 * total[-1]
        end = float(self.f[np.searchsorted(total, total[-1] - min(least, _BULK * total[-1]))])
        motion, power = np.where(self.f <= end, self.motion, 0.0), self.motion + self.noise
        above = (self.f > end) & (self.f <= 2 * end)
        flat = float(np.median(power[above])) if above.any() else float(power[-1])
        noise = np.where(self.f > end, power, np.maximum(self.noise, flat))
        velocity = np.cumsum(motion * self.f**2)
        edge = float(self.f[np.searchsorted(velocity, _SHARE * velocity[-1])])
        return replace(self, motion=motion, noise=noise, bandwidth=edge)

    def of_rounding(self) -> Spectrum:
        """The same with no more noise below the end of the motion than rounding has there.

        Just above the motion goes on, by dry friction for one, and what is found there is not all noise. Rounding is
        white where a sample seldom has the step of the one before; in slower motion its power is in fewer frequencies.
        Itself where the values lie on no lattice.
        """
        if not self.step:
            return self
        df, highest = self.f[1] - self.f[0], float(self.f[-1])
        speed = float(np.sqrt(np.sum(self.motion * (2 * np.pi * self.f) ** 2) * df))
        rounding = self.step**2 / 12 / min(highest, max(speed / self.step, df))
        white = max(rounding, float(np.median(self.noise[self.f > 0.5 * highest])))
        return replace(self, noise=np.minimum(self.noise, white))

    def balanced_cutoff(self, parallel_hz: float, lowest: float, highest: float) -> float:
        """Cut-off of the position filter, Hz, that leaves least squares on the filtered acceleration without bias.

        The motion's acceleration that the filter H removes balances the noise that it passes, behind the parallel
        filter B: sum f^4 B^2 M H (1 - H) = sum f^4 B^2 N H^2. The regression of torque on the filtered acceleration has
        slope one then to first order; a Wiener filter has it at every frequency (errors of Berkson's kind). Where the
        noise left is a share _TOLERATED of the motion at most, so is its effect on inertia, and the cut-off is as high
        as that allows: what a filter removes is not evenly spread in time.
        """
        tried = np.geomspace(lowest, max(highest, lowest), _TRIED)
        weight = self.f**4 * smoothed(self.f, parallel_hz) ** 2
        motion, noise = weight * self.motion, weight * self.noise

        def removes_less(cutoff: float) -> bool:
            H = passed(self.f, cutoff)
            return bool((H * H) @ noise >= (H * (1 - H)) @ motion)

        def is_noisy(cutoff: float) -> bool:
            H2 = passed(self.f, cutoff) ** 2
            return bool(H2 @ noise > _TOLERATED * (H2 @ motion))

        # What is removed falls with the cut-off, what is left rises.
        balanced, clean = (
            bisect.bisect_left(range(_TRIED), True, key=lambda k: test(float(tried[k])))
            for test in (removes_less, is_noisy)
        )
        return float(tried[min(max(balanced, clean - 1), _TRIED - 1)])

    def noise_share(self, cutoff: float, parallel_hz: float) -> float:
        """RMS of the noise in the treated acceleration over the RMS of that acceleration, 0 to 1."""
        weight = self.f**4 * smoothed(self.f, parallel_hz) ** 2 * passed(self.f, cutoff) ** 2
        noise, motion = float(np.sum(weight * self.noise)), float(np.sum(weight * self.motion))
        return float(np.sqrt(noise / (noise + motion))) if noise > 0 else 0.0

    def noise_like(self, n: int, dt: float, rng: np.random.Generator) -> Array:
        """A realisation of the noise, (n,)."""
        f = np.fft.rfftfreq(n, dt)
        level = np.exp(np.interp(f, self.f, np.log(np.maximum(self.noise, np.finfo(float).tiny))))
        z = np.sqrt(level * n / (4 * dt)) * (rng.normal(size=len(f)) + 1j * rng.normal(size=len(f)))
        z[0] = 0
        return np.fft.irfft(z, n)


# Of each log: the choice of its treatment and the diagnosis ask for the same.
_SPECTRA: WeakKeyDictionary[Log, tuple[Spectrum, ...]] = WeakKeyDictionary()


def spectra(log: Log) -> tuple[Spectrum, ...]:
    """Of each position channel of a log."""
    if log not in _SPECTRA:
        highest = log.usable_bandwidth_hz
        found = [Spectrum.of(np.asarray(y), float(log.dt), highest) for y in log.position.T]
        steps = log.position_steps or (0.0,) * len(found)
        _SPECTRA[log] = tuple(replace(one, recorded=step) for one, step in zip(found, steps, strict=True))
    return _SPECTRA[log]


def bandwidth(log: Log) -> float:
    """Bandwidth of a log's motion: the largest of its channels', Hz; 0 where nothing exceeds the noise."""
    return max(spectrum.bandwidth for spectrum in spectra(log))


def widest(channels: Sequence[Sequence[Spectrum]]) -> tuple[Spectrum, ...]:
    """Of each channel, the spectrum with the largest bandwidth among the logs that move it.

    Where one joint is moved after another, the others tremble fast and little.
    """
    return tuple(max(_moving(own), key=lambda s: s.bandwidth) for own in zip(*channels, strict=True))


def fastest(channels: Iterable[Array], dt: float) -> float:
    """Bandwidth of the bulk of a log's motion, the largest of the channels that have a part in it, Hz; 0 without any.

    A joint that is held has noise, or a vibration of a few steps of its encoder, and nothing else.
    """
    return bulk_bandwidth([Spectrum.of(channel, dt) for channel in channels])


def bulk_bandwidth(channels: Sequence[Spectrum]) -> float:
    """The same of the spectra of the channels, Hz."""
    found = [own.narrowed() for own in channels if own.motion_rms > _STEPS * own.step]
    return max(own.bandwidth for own in _moving(found)) if found else 0.0


def _moving(spectra: Sequence[Spectrum]) -> list[Spectrum]:
    """Those with a share of at least _MOVES of the largest power of velocity."""
    power = [float(s.motion @ s.f**2 * (s.f[1] - s.f[0])) for s in spectra]
    return [s for s, own in zip(spectra, power, strict=True) if own >= _MOVES * max(power)]


def passed(f: Array, cutoff: float) -> Array:
    """Gain of the position filter: Butterworth forwards and backwards, -3 dB at the cut-off."""
    return np.asarray(1 / (1 + (f / cutoff) ** (2 * _ORDER) * (np.sqrt(2) - 1)))


def smoothed(f: Array, cutoff: float) -> Array:
    """About the gain of the parallel filter: a Gaussian, -3 dB at the cut-off."""
    return np.asarray(np.exp(-0.5 * np.log(2) * (f / cutoff) ** 2))


def quantum(channel: Array) -> float:
    """Resolution of an encoder: the step of the lattice that its values lie on; 0 where they lie on none.

    Values must recur to be those of an encoder; a channel of many digits lies on the lattice of its last digit.
    """
    values = np.unique(channel)
    return lattice_step(values) if len(values) < _RECUR * len(channel) else 0.0


def lattice_step(channel: Array) -> float:
    """Step of the lattice that the values of a channel lie on; 0 where they lie on none."""
    scale = float(np.abs(channel).max())
    values = np.unique(np.round(channel / scale, 12)) if scale > 0 else np.zeros(1)
    if len(values) <= _FEWEST_LEVELS:
        return 0.0
    steps = np.diff(values)
    step = float(np.median(steps[steps < 1.5 * np.percentile(steps, 10)]))
    off = values / step - np.round(values / step)
    on_lattice = np.percentile(np.abs(off - np.median(off)), 95) < _OFF_LATTICE
    return step * scale if on_lattice else 0.0


def _apart(f: Array, power: Array, step: float) -> Spectrum:
    """Motion and noise of a power density, for a channel of a resolution."""
    noise = _noise(f, power)
    padded = np.pad(power, 2, mode="reflect") if len(power) > 2 else np.pad(power, 2, mode="edge")
    five = np.convolve(padded, np.full(5, 0.2), mode="valid")
    total, under = np.cumsum(np.append(0, power)), np.cumsum(np.append(0, noise))
    low, high = np.searchsorted(f, f * 2**-0.25), np.searchsorted(f, f * 2**0.25, side="right")
    half_octave = (total[high] - total[low]) / np.maximum(under[high] - under[low], np.finfo(float).tiny)
    motion = np.where((five > _ABOVE * noise) & (half_octave > _ABOVE_WIDE), np.maximum(power - noise, 0.0), 0.0)
    df = f[1] - f[0]
    if noise.sum() * df < 0.5 * step**2 / 12:
        # A nearly pure tone: the error of the encoder is in lines, and so much power on top is no motion.
        motion[np.cumsum(motion[::-1])[::-1] * df < step**2 / 6] = 0.0
    if not motion.any():
        return Spectrum(f, motion, noise, step, 0.0)
    velocity, acceleration = np.cumsum(motion * f**2), np.cumsum(motion * f**4)
    edge = float(f[np.searchsorted(velocity, _SHARE * velocity[-1])])
    end = float(f[np.searchsorted(acceleration, _END * acceleration[-1])])
    # Below the end of the motion the noise is hidden: it is taken to go on as it is just above.
    above = (f >= end) & (f <= 1.5 * end)
    flat = float(np.median(noise[above])) if above.any() else float(noise[-1])
    return Spectrum(f, motion, np.where(f < end, np.minimum(noise, flat), noise), step, edge)


def _noise(f: Array, power: Array) -> Array:
    """Noise from the top down, band by band: the median of a band, and nowhere steeper than f^-STEEPEST."""
    edges = f[-1] * 2.0 ** (-np.arange(0, np.log2(f[-1] / f[0]) * _BANDS + 1) / _BANDS)
    starts = np.searchsorted(f, edges, side="right")
    nearest, farthest = (np.searchsorted(f, ends, side="right") for ends in (edges[1:] / 1.2, edges[:-1] * 1.2))
    centres = np.sqrt(edges[:-1] * edges[1:]).tolist()
    noise, level, at = np.empty_like(power), 0.0, 0.0
    for stop, start, low, high, centre in zip(starts[:-1], starts[1:], nearest, farthest, centres, strict=True):
        if stop == start:
            continue
        near = np.sort(power[low:high])  # the median of so few takes `np.median` much longer
        middle = 0.5 * float(near[(len(near) - 1) // 2] + near[len(near) // 2])
        here = middle / np.log(2) if len(near) > 2 else float(near[0])
        level, at = (min(here, level * (at / centre) ** _STEEPEST) if at else here), centre
        noise[start:stop] = level
    noise[: starts[-1]] = level
    return noise
