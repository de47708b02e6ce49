"""Up to which frequency the rigid model explains the torque: residual and predicted torque, band by band.

With X the spectrum of the predicted torque and E that of the residual, the measured torque is 1 + d times the predicted
one in a band, d = Re sum conj(X) E / sum |X|^2. A rigid device has d = 0 at every frequency. With elasticity between
motor and link d grows as the square of the frequency below the first resonance: positive where positions are measured
at the motors, negative where at the joints. A delay is in the imaginary part, which is left to its own test.

Segments of the log are clusters: noise may have any colour and vary in time. Source: the regression at one frequency of
Brillinger (1981), Time Series: Data Analysis and Theory, section 8.6, with the covariance of clusters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.finding import Finding, joined_names
from haptid.inference.diagnosis.residuals import Residuals
from haptid.log.spectrum import Spectrum, passed, spectra
from haptid.motion.motion import Motion
from haptid.uncertainty.distributions import t_tail
from haptid.uncertainty.quantities import half_width

# Segments of all logs together, and fewest that are tested; fewest rows of one, and its length over the filter's reach.
_SEGMENTS, _FEWEST, _SHORTEST, _REACHES = 24, 8, 16, 4
# Bands in an octave, and bin of a segment where the lowest begins: before it is the window's side of the mean.
_BANDS, _FIRST_BIN = 2, 2
# A band is informative where the interval of its ratio is at most so wide to either side; a ratio so far from one is a
# failure.
INFORMATIVE, FAILS = 0.1, 0.05
# Least gain of the position filter in a band, and largest share of encoder noise in the power of its positions.
_PASSED, _NOISE = 0.98, 0.01
# Segments with more of a band's power are corrected as if they had so much less; degrees of freedom, at least.
_LEVERAGE, _LEAST_DOF = 0.05, 2.0
# Bands from which growth with frequency is tested.
_LEAST_BANDS = 3
# Probability that a rigid device fails in any band of any motor.
FALSE_ALARMS = 0.03


@dataclass(frozen=True, eq=False)
class FrequencyRange:
    """Measured over predicted torque of one motor, by band of frequency.

    Attributes:
        label: of the motor.
        low, high: edges of the bands, (bands,), Hz.
        ratio, se: measured over predicted torque in phase with it, and its standard error, (bands,).
        dof: degrees of freedom of each, (bands,).
        informative: whether each band is excited enough to distinguish a ratio from one, and free of noise and filters,
            (bands,).
        p: of a ratio of one, (bands,).
    """

    label: str
    low: Array
    high: Array
    ratio: Array
    se: Array
    dof: Array
    informative: np.ndarray
    p: Array

    def fails(self, tests: int) -> np.ndarray:
        """Whether the rigid model fails in each band, at FALSE_ALARMS over so many tests, (bands,)."""
        return np.asarray(self.informative & (self.p * tests < FALSE_ALARMS) & (np.abs(self.ratio - 1) > FAILS))

    @property
    def conf_int(self) -> Array:
        """95 % intervals of the ratios, (bands, 2)."""
        half = half_width(self.se, np.maximum(self.dof, 1.0))
        return np.column_stack([self.ratio - half, self.ratio + half])

    def growth(self) -> tuple[float, float]:
        """Slope of the ratio with the square of the frequency, s^2, and its p-value, over the informative bands.

        Fitted together with a constant: other errors of a model change all bands alike.
        """
        if self.informative.sum() < _LEAST_BANDS:
            return 0.0, 1.0
        weight = 1 / self.se[self.informative]
        A = np.column_stack([weight, weight * (self.low * self.high)[self.informative]])
        scale = np.linalg.norm(A, axis=0)
        beta, *_ = np.linalg.lstsq(A / scale, weight * self.ratio[self.informative], rcond=None)
        se = float(np.sqrt(np.linalg.inv((A / scale).T @ (A / scale))[1, 1]))
        dof = float(self.dof[self.informative].min())
        return float(beta[1] / scale[1]), 2 * float(t_tail(abs(float(beta[1])) / se, dof))


def frequency_ranges(estimate: Estimate, left: Residuals) -> tuple[FrequencyRange, ...]:
    """Measured over predicted torque of every motor by frequency; none where the rows are too few.

    Args:
        estimate: whose torque.
        left: its residuals.
    """
    spans, motions = _spans(left), estimate.observation.motions
    reach = max(motion.treatment.reach(motion.dt) * motion.dt for motion in motions)
    total = sum(stop - start for start, stop in spans)
    length = max(total // _SEGMENTS, round(_REACHES * reach / left.step), _SHORTEST)
    starts = [k for start, stop in spans for k in range(start, stop - length + 1, length)]
    if len(starts) < _FEWEST:
        return ()
    pieces, window, f = np.add.outer(starts, np.arange(length)), np.hanning(length), _frequencies(length, left.step)
    edges = _edges(f, min(_highest(motion) for motion in motions))
    spectra_of = [spectra(motion.log) if motion.log else () for motion in motions]
    ranges = []
    for k, (label, row) in enumerate(zip(left.labels, device_rows(estimate), strict=True)):
        x, e = left.predicted[k][pieces], np.nan_to_num(left.e[k])[pieces]
        X, E = (np.fft.rfft(window * (s - s.mean(axis=1, keepdims=True)), axis=1) for s in (x, e))
        clean = [_clean(motion, own, row, edges) for motion, own in zip(motions, spectra_of, strict=True)]
        ranges.append(_of(label, f, edges, X, E, np.all(clean, axis=0)))
    return tuple(ranges) if len(edges) > 1 else ()


def _spans(left: Residuals) -> list[tuple[int, int]]:
    """First row and one past the last of each part without missing rows."""
    known = np.isfinite(left.t) & (left.block >= 0)
    joined = known.copy()
    joined[0] = False
    joined[1:] &= known[:-1] & (np.diff(left.t) < 1.5 * left.step)
    edges = [*np.flatnonzero(known & ~joined).tolist(), len(known)]
    return [(a, a + int(known[a:b].sum())) for a, b in pairwise(edges)]


def _frequencies(length: int, step: float) -> Array:
    """Of the bins of a segment, Hz."""
    return np.asarray(np.fft.rfftfreq(length, step), dtype=np.float64)


def _edges(f: Array, highest: float) -> list[float]:
    """Edges of the bands, each of which has a bin at least."""
    edges = [float(f[_FIRST_BIN] - 0.5 * f[1])]
    while (edge := max(edges[-1] * 2 ** (1 / _BANDS), edges[-1] + float(f[1]))) <= highest:
        edges.append(edge)
    return edges


def _highest(motion: Motion) -> float:
    """Frequency up to which rows hold the torque: that of the parallel filter, or of their rate."""
    rate = 0.5 / (motion.treatment.decimation * motion.dt)
    return min(rate, motion.treatment.parallel(motion.dt) or rate)


def _clean(motion: Motion, spectra: Sequence[Spectrum], row: int, edges: Sequence[float]) -> np.ndarray:
    """Whether neither the position filter nor the encoder of a row spoils each band, (bands,).

    Args:
        motion: treated signals.
        spectra: spectra of its position channels; none where it has no log.
        row: whose torque; its channel is the one in the same place.
        edges: of the bands, Hz.
    """
    clean = np.ones(len(edges) - 1, dtype=bool)
    if motion.treatment.cutoff_hz is not None:
        every = np.atleast_1d(np.asarray(motion.treatment.cutoff_hz, dtype=float))
        clean &= passed(np.array(edges[1:]), float(every[min(row, len(every) - 1)])) >= _PASSED
    if spectra:
        spectrum = spectra[min(row, len(spectra) - 1)]
        for k, (low, high) in enumerate(pairwise(edges)):
            inside = (spectrum.f >= low) & (spectrum.f <= high)
            power = float((spectrum.noise + spectrum.motion)[inside].sum())
            clean[k] &= bool(spectrum.noise[inside].sum() <= _NOISE * power)
    return clean


def _of(
    label: str, f: Array, edges: Sequence[float], X: np.ndarray, E: np.ndarray, clean: np.ndarray
) -> FrequencyRange:
    """Ratios of all bands, from spectra of predicted torque and residual, (segments, frequencies)."""
    figures = []
    for low, high in pairwise(edges):
        inside = (f >= low) & (f < high)
        S: Array = (np.abs(X[:, inside]) ** 2).sum(axis=1)
        A: Array = (X[:, inside].conj() * E[:, inside]).real.sum(axis=1)
        total = max(float(S.sum()), np.finfo(float).tiny)
        d, share = float(A.sum()) / total, S / total
        score = (A - d * S) / np.maximum(1 - share, _LEVERAGE)
        dof = 1 / max(float((share**2).sum()), np.finfo(float).tiny) - 1
        figures.append((1 + d, float(np.sqrt((score**2).sum())) / total, dof))
    ratio, se, freedom = np.array(figures).reshape(-1, 3).T
    usable = (freedom > _LEAST_DOF) & (se > 0)
    safe, known = np.where(usable, se, 1.0), np.maximum(freedom, 1.0)
    p = np.array([2 * float(t_tail(t, v)) for t, v in zip(np.abs(ratio - 1) / safe, known, strict=True)])
    informative = usable & (half_width(safe, known) < INFORMATIVE) & clean
    low_edges, high_edges = np.array(edges[:-1]), np.array(edges[1:])
    return FrequencyRange(
        label, low_edges, high_edges, freeze(ratio), freeze(se), freeze(freedom), informative, freeze(p)
    )


def rigid_range(ranges: Sequence[FrequencyRange]) -> Finding:
    """Up to which frequency does the rigid model explain the torque, and does it lack elasticity?"""
    tests = sum(int(frequency_range.informative.sum()) for frequency_range in ranges)
    if not tests:
        text = "No band of frequency is excited enough to know how far the rigid model holds."
        return Finding("rigid range", "ok", {}, text)
    figures: dict[str, float] = {}
    failed, elastic, held = [], [], []
    for frequency_range in ranges:
        if not frequency_range.informative.any():
            continue
        fails, highest = frequency_range.fails(tests), float(frequency_range.high[frequency_range.informative][-1])
        figures[f"{frequency_range.label}, Hz"] = end = float(frequency_range.low[fails][0]) if fails.any() else highest
        if not fails.any():
            held.append((end, frequency_range.label))
            continue
        percent = 100 * (float(frequency_range.ratio[fails][-1]) - 1)
        deviation = f"off by {percent:+.0f} % at {float(frequency_range.high[fails][-1]):.3g} Hz"
        failed.append(f"{frequency_range.label} up to {end:.3g} Hz ({deviation})")
        slope, p = frequency_range.growth()
        if (
            fails[frequency_range.informative][-1]
            and p * len(ranges) < FALSE_ALARMS
            and abs(slope) * highest**2 > FAILS
        ):
            figures[f"{frequency_range.label}, resonance, Hz"] = resonance = abs(slope) ** -0.5
            elastic.append(f"{frequency_range.label}, about {resonance:.2g} Hz")
    return Finding("rigid range", "doubt" if failed else "ok", figures, " ".join(_sentences(held, failed, elastic)))


def _sentences(held: Sequence[tuple[float, str]], failed: Sequence[str], elastic: Sequence[str]) -> Iterator[str]:
    """How far the model holds, and what the difference beyond looks like."""
    within = f"within {100 * FAILS:.0f} %"
    if held:
        motors = f" of {joined_names([label for _, label in held])}" if failed else ""
        least = min(held)[0]
        yield f"The rigid model explains the torque{motors} {within} up to at least {least:.3g} Hz."
    if failed:
        yield f"It explains the torque {within} of {joined_names(failed)}."
    if elastic:
        yield f"The difference grows as elasticity makes it, with a resonance of {joined_names(elastic)}."
    elif failed:
        yield "The difference does not grow with frequency as elasticity makes it."
