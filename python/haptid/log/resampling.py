"""Resampling of a signal's samples to the uniform grid of a log, segment by segment."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Grid points that are computed together, at fixed places; influence of a sample k away decays as (2 - sqrt(3))^k in
# the interpolating spline, and as fast by the knot in the fitted one.
SAMPLES_RESAMPLED = 2**16
_MARGIN = 40
# Distance of the fitted spline's knots, mean steps: fewer coefficients than samples, also where every tenth is missing.
KNOT = 1.5
# Gaps from so many mean steps on are bridged by a polynomial, fitted to this many samples on either side at least.
_BRIDGED, _LEAST_BESIDE = 4.5, 6
# Weight of its squared third differences against one squared residual; it only matters where samples are missing.
STIFFNESS = 1e-4
# Share of half the sampling rate that a fitted spline carries; the error at a frequency f is (2 pi f h)^4 / 1100 of the
# signal with knots h apart (2 % there, 0.005 % at a tenth of half the rate).
CARRIED = 0.35
# Third differences.
_THIRD = (-1.0, 3.0, -3.0, 1.0)

Kind = Literal["position", "torque"]
Spans = tuple[tuple[int, int], ...]


@dataclass(frozen=True, eq=False)
class Resampling:
    """How the samples of one signal come to the grid.

    Attributes:
        method: direct (a sample is a grid point), interpolated (through the samples) or fitted (least squares).
        kept: rows of the file that are used, (m,); None for all.
        times: of those rows, (m,), s.
        t: uniform grid, (n,), s.
        segments: first grid point and one past the last of each segment.
        samples: first kept row and one past the last of each segment.
        knot: distance of the fitted spline's knots, s.
        slots: grid point of each kept row, (m,), where the rows are on the grid: only what is missing between them is
            fitted then.
    """

    method: Literal["direct", "interpolated", "fitted"]
    kept: NDArray[np.intp] | None
    times: Array
    t: Array
    segments: Spans
    samples: Spans
    knot: float = 0.0
    slots: NDArray[np.intp] | None = None

    @property
    def unchanged(self) -> bool:
        """Whether the grid holds every row of the file, as it is."""
        return self.method == "direct" and self.kept is None

    def rows(self, start: int, stop: int) -> tuple[int, int]:
        """First row of the file and one past the last that grid points start..stop need."""
        parts = [self._needed(k, a, b) for k, a, b in self._overlaps(start, stop)]
        low, high = parts[0][0], parts[-1][1]
        return (low, high) if self.kept is None else (int(self.kept[low]), int(self.kept[high - 1]) + 1)

    def make(self, values: Array, low: int, start: int, stop: int, kind: Kind) -> Array:
        """Grid points start..stop of channels.

        Positions are smooth and are interpolated by a cubic spline; torques have edges (dry friction, limits) and are
        interpolated by the monotone cubic of Fritsch and Butland (1984), SIAM J. Scientific and Statistical Computing
        5(2), which does not overshoot. Both are fitted by the same least-squares cubic B-spline (de Boor 1978, A
        Practical Guide to Splines, chapter XIV): where stamps nearly coincide, an interpolant would magnify the noise.

        Args:
            values: channels at rows low.. of the file, (channels, rows).
            low: as `rows` says.
            start, stop: grid points.
            kind: of the signal.

        Returns:
            (channels, stop - start).
        """
        if self.unchanged:
            return values
        made = np.empty((len(values), stop - start))
        for k, a, b in self._overlaps(start, stop):
            first, last = self._needed(k, a, b)
            index = slice(first - low, last - low) if self.kept is None else self.kept[first:last] - low
            out = made[:, a - start : b - start]
            if self.method == "direct":
                out[:] = values[:, index]
            elif self.method == "fitted":
                origin = float(self.t[self.segments[k][0]])
                times, bridged = bridge(self.times[first:last], values[:, index], self.knot / KNOT)
                out[:] = least_squares_spline(times, bridged, origin, self.knot, self.t[a:b])
                if self.slots is not None:
                    place = self.slots[first:last] - a
                    inside = (place >= 0) & (place < b - a)
                    out[:, place[inside]] = values[:, index][:, inside]
            else:
                from scipy.interpolate import CubicSpline, PchipInterpolator  # slow to import, and few logs need it

                curve = {"position": CubicSpline, "torque": PchipInterpolator}[kind]
                out[:] = curve(self.times[first:last], values[:, index], axis=-1)(self.t[a:b])
        return made

    def _overlaps(self, start: int, stop: int) -> list[tuple[int, int, int]]:
        """Segments that grid points start..stop lie in, and which of these points."""
        spans = ((k, max(start, a), min(stop, b)) for k, (a, b) in enumerate(self.segments))
        return [span for span in spans if span[1] < span[2]]

    def _needed(self, k: int, start: int, stop: int) -> tuple[int, int]:
        """First kept sample and one past the last that grid points start..stop of segment k need."""
        first, last = self.samples[k]
        if self.method == "direct":
            offset = first - self.segments[k][0]
            return start + offset, stop + offset
        around = _MARGIN * max(self.knot, 0.0)
        times = self.times[first:last]
        low = first + int(np.searchsorted(times, self.t[start] - around, side="left"))
        high = first + int(np.searchsorted(times, self.t[stop - 1] + around, side="right"))
        return max(low - _MARGIN, first), min(high + _MARGIN, last)


def bridge(times: Array, values: Array, step: float) -> tuple[Array, Array]:
    """Samples with others added in each gap, by a cubic polynomial that is fitted to as long a part on either side.

    A spline alone would go on with the slope that the noise of the last few samples has.

    Args:
        times: of the samples, (m,), s, not decreasing.
        values: (channels, m).
        step: mean step, s.

    Returns:
        Times and values of all samples, (more,) and (channels, more).
    """
    gaps = np.flatnonzero(np.diff(times) > _BRIDGED * step)
    if not gaps.size:
        return times, values
    at, made = [times], [values]
    for k in gaps:
        length = float(times[k + 1] - times[k])
        many = int(np.clip(np.ceil(length / step), _LEAST_BESIDE, _MARGIN))
        part = slice(max(0, k + 1 - many), k + 1 + many)
        new = times[k] + length * np.arange(1, round(length / step)) / round(length / step)
        centre = times[k] + 0.5 * length
        u, w = (np.vander((x - centre) / length, 4) for x in (times[part], new))
        at.append(new)
        made.append((w @ np.linalg.lstsq(u, values[:, part].T, rcond=None)[0]).T)
    order = np.argsort(np.concatenate(at), kind="stable")
    return np.concatenate(at)[order], np.concatenate(made, axis=1)[:, order]


def least_squares_spline(times: Array, values: Array, origin: float, knot: float, at: Array) -> Array:
    """Least-squares cubic B-spline through samples with independent errors, at some times, (channels, times).

    Args:
        times: of the samples, (m,), s, not decreasing.
        values: (channels, m).
        origin: time of a knot, s.
        knot: distance of the knots, s.
        at: (times,), s.
    """
    first = int(np.floor((min(times[0], at[0]) - origin) / knot))
    last = int(np.floor((max(times[-1], at[-1]) - origin) / knot))
    size = last - first + 4
    place, weights = _basis(times, origin, knot, first)
    banded = np.zeros((4, size))
    for i in range(4):
        for j in range(i, 4):
            banded[j - i] += np.bincount(place + i, weights[i] * weights[j], size)
    for i in range(4):
        for j in range(i, 4):
            banded[j - i, i : size - 3 + i] += STIFFNESS * _THIRD[i] * _THIRD[j]
    right = np.empty((size, len(values)))
    for channel, out in zip(values, right.T, strict=True):
        out[:] = sum(np.bincount(place + i, weights[i] * channel, size) for i in range(4))
    coefficients = solveh_banded(banded, right, lower=True, overwrite_ab=True, overwrite_b=True, check_finite=False).T
    place, weights = _basis(at, origin, knot, first)
    made = weights[0] * coefficients[:, place]
    for i in range(1, 4):
        made += weights[i] * coefficients[:, place + i]
    return np.asarray(made)


def _basis(times: Array, origin: float, knot: float, first: int) -> tuple[NDArray[np.intp], Array]:
    """Index of the first of four uniform cubic B-splines at each time, and their values, (4, times)."""
    u = (times - origin) / knot - first
    place = np.floor(u).astype(np.intp)
    u -= place
    v = 1 - u
    return place, np.stack([v**3, 4 - 6 * u**2 + 3 * u**3, 4 - 6 * v**2 + 3 * v**3, u**3]) / 6
