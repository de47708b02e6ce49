"""Residuals against position and velocity, and their spectrum."""

from __future__ import annotations

from dataclasses import field
from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import hann_window, welch
from haptid.inference.diagnosis import FrequencyRange
from haptid.inference.frequency_response import FrequencyResponse, modelled_compliance
from haptid.report.chart import (
    MEASURED,
    PREDICTED,
    RESIDUAL,
    Chart,
    axis,
    chart_series,
    figure,
    packed,
    plot,
    quantised,
)
from haptid.report.section import Section
from haptid.report.source import ReportSource, Track
from haptid.study.identify import Identification

# Points of a scatter plot, and bins for the mean.
CLOUD, _BINS = 1200, 40
# Segment length of Welch's method, and frequencies that are drawn.
WELCH_SAMPLES, FREQUENCIES = 1024, 300
# Least number of rows of a bin.
_FEWEST = 5


@dataclass(frozen=True)
class ResidualSection(Section):
    """Residuals.

    Attributes:
        logs: for each log its name, which rows, and the indices of its charts.
        ranges: indices of the charts of measured over predicted torque by frequency.
        responses: indices of the charts of compliance by frequency, of logs that repeat.
    """

    key: ClassVar[str] = "residual"
    title: ClassVar[str] = "Residuals"
    logs: list[dict[str, Any]]
    ranges: list[int]
    responses: list[int] = field(default_factory=list)

    @classmethod
    def of(cls, source: ReportSource) -> ResidualSection:
        charts: list[Chart] = []
        logs = []
        for k, track in enumerate(source.tracks):
            own = [chart for motor in track.motors_used for chart in _charts(track, k, motor)]
            numbers = list(range(len(charts), len(charts) + len(own)))
            logs.append({"name": track.name, "seen": track.seen, "kind": track.kind, "charts": numbers})
            charts += own
        informative = [
            frequency_range for frequency_range in source.diagnosis.ranges if frequency_range.informative.sum() > 1
        ]  # a curve
        ranges = list(range(len(charts), len(charts) + len(informative)))
        charts += [frequency_response(frequency_range) for frequency_range in informative]
        own = _compliances(source.identification)
        responses = list(range(len(charts), len(charts) + len(own)))
        return cls(charts=(*charts, *own), logs=logs, ranges=ranges, responses=responses)


def _compliances(identification: Identification) -> list[Chart]:
    """Measured and modelled compliance of every motor, where the logs repeat."""
    response = identification.response
    if response is None:
        return []
    estimate = identification.estimate
    motion = estimate.observation.motions[0]
    modelled = np.abs(modelled_compliance(estimate.model, estimate.beta, motion, response.f))
    return [_compliance(response, modelled[:, k, k], k) for k in range(len(response.labels))]


def _compliance(response: FrequencyResponse, modelled: Array, motor: int) -> Chart:
    """Size of a motor's position by its torque, the other motors free, with its 95 % band, and that of the model."""
    f, label, unit = response.f, response.labels[motor], response.unit(motor, motor)
    size, radius = np.abs(response.G[:, motor, motor]), response.radius[:, motor, motor]
    low, high = np.maximum(size - radius, 1e-3 * size), size + radius
    curves = [
        chart_series("95 % band", "band", "sky", x=packed(f), low=packed(low), high=packed(high)),
        chart_series("measured", "line", MEASURED, x=packed(f), y=packed(size), width=2.2),
        chart_series("model", "line", PREDICTED, x=packed(f), y=packed(modelled)),
    ]
    worst = int(np.argmax(np.abs(np.log(modelled / size))))
    inside = 100 * float(np.mean((low <= modelled) & (modelled <= high)))
    caption = (
        f"The model is in the band at {inside:.0f} % of {len(f)} frequencies; its size is farthest off at "
        f"{figure(float(f[worst]))} Hz, {figure(float(modelled[worst] / size[worst]))} times the measured one. The "
        "model's is of small motion about the mean pose, without dry friction."
    )
    alt = f"Compliance of {label} against frequency, measured with its 95 % band, and of the model."
    drawing = plot(
        axis("frequency", "Hz", log=True, low=float(f[0])), axis("compliance", unit, log=True), curves, height=200
    )
    return Chart(f"compliance-{motor}", f"{label}: compliance", alt, caption, drawing)


def _charts(track: Track, k: int, motor: int) -> tuple[Chart, Chart, Chart]:
    unit = track.coordinate_units[motor]
    return (
        against(track, k, motor, "position", track.position[motor], unit),
        against(track, k, motor, "velocity", track.velocity[motor], f"{unit}/s"),
        spectrum(track, k, motor),
    )


def against(track: Track, k: int, motor: int, quantity: str, x: Array, unit: str) -> Chart:
    """The residual against a signal, and its mean in each bin."""
    label, known = track.labels[motor], track.used[motor]
    x, y = x[known], track.residual[motor][known]
    centres, means = binned(x, y)
    some = np.linspace(0, len(x) - 1, min(len(x), CLOUD)).astype(int)
    curves = [
        chart_series("rows", "points", "sky", x=quantised(x[some]), y=quantised(y[some])),
        chart_series("mean", "line", RESIDUAL, x=packed(centres), y=packed(means), width=2.2),
    ]
    rms = float(np.sqrt(np.mean(y**2)))
    largest = int(np.nanargmax(np.abs(means)))
    caption = (
        f"Largest mean of a bin: {figure(float(abs(means[largest])))} {track.units[motor]}, at "
        f"{figure(float(centres[largest]))} {unit}; the residual's RMS is {figure(rms)}. "
        f"{_drawn(len(some), len(x))}; means are over all rows."
    )
    alt = f"Residual of {label} against its {quantity}, {track.name}, with the mean of {_BINS} bins."
    drawing = plot(axis(quantity, unit), axis("residual", track.units[motor], zero=True), curves, height=200)
    return Chart(f"{quantity}-{k}-{motor}", f"{label}: against {quantity}", alt, caption, drawing)


def _drawn(some: int, rows: int) -> str:
    return f"All {rows} rows are drawn" if some == rows else f"{some} of {rows} rows are drawn, evenly spaced"


def binned(x: Array, y: Array, bins: int = _BINS) -> tuple[Array, Array]:
    """Centres of equal bins of x, and the mean of y in each, NaN where there are few rows, (bins,) each."""
    low, high = float(x.min()), float(x.max())
    width = (high - low) / bins or 1.0
    place = np.clip(((x - low) / width).astype(int), 0, bins - 1)
    counts = np.bincount(place, minlength=bins)
    sums = np.bincount(place, weights=y, minlength=bins)
    means = np.where(counts >= min(_FEWEST, counts.max()), sums / np.maximum(counts, 1), np.nan)
    return np.asarray(low + width * (np.arange(bins) + 0.5)), np.asarray(means)


def spectrum(track: Track, k: int, motor: int) -> Chart:
    """Amplitude spectral densities of torque and residual; unused rows are zero in both."""
    label, unit = track.labels[motor], track.units[motor]
    known = track.used[motor]
    f, left = density(np.where(known, track.residual[motor], 0.0), track.step)
    _, torque = density(np.where(known, track.measured[motor], 0.0), track.step)
    curves = [
        chart_series("torque", "line", MEASURED, x=packed(f), y=packed(torque)),
        chart_series("residual", "line", RESIDUAL, x=packed(f), y=packed(left)),
    ]
    peak = int(np.argmax(left))
    caption = (
        f"Maximum of the residual: {figure(float(left[peak]))} {unit}/\u221aHz at {figure(float(f[peak]))} Hz; the "
        f"torque has {figure(float(torque[peak]))} there. Unused rows are set to zero."
    )
    alt = f"Amplitude spectral density of torque and residual of {label} against frequency, {track.name}."
    low = float(f[0])
    drawing = plot(
        axis("frequency", "Hz", log=True, low=low), axis("density", f"{unit}/\u221aHz", log=True), curves, height=200
    )
    return Chart(f"spectrum-{k}-{motor}", f"{label}: spectrum", alt, caption, drawing)


def frequency_response(frequency_range: FrequencyRange) -> Chart:
    """Measured over predicted torque of a motor by frequency, with its 95 % band."""
    informative = frequency_range.informative
    f, interval = (
        np.sqrt(frequency_range.low * frequency_range.high)[informative],
        frequency_range.conf_int[informative],
    )
    ratio = frequency_range.ratio[informative]
    curves = [
        chart_series("95 % band", "band", "sky", x=packed(f), low=packed(interval[:, 0]), high=packed(interval[:, 1])),
        chart_series("measured / predicted", "line", RESIDUAL, x=packed(f), y=packed(ratio), width=2.2),
        chart_series("rigid model", "line", MEASURED, x=packed(f), y=packed(np.ones_like(f))),
    ]
    worst = int(np.argmax(np.abs(ratio - 1)))
    caption = (
        f"Farthest from one: {figure(float(ratio[worst]))} at {figure(float(f[worst]))} Hz. Bands that are "
        "not excited, or spoiled by encoder noise or the position filter, are not drawn."
    )
    quantity = f"Measured over predicted torque of {frequency_range.label}"
    alt = f"{quantity} against frequency, rows of the fit, with its 95 % band."
    drawing = plot(axis("frequency", "Hz", log=True, low=float(f[0])), axis("ratio", ""), curves, height=200)
    return Chart(
        f"ratio-{frequency_range.label.replace(' ', '-')}",
        f"{frequency_range.label}: frequency response",
        alt,
        caption,
        drawing,
    )


def density(y: Array, step: float) -> tuple[Array, Array]:
    """Frequencies, Hz, logarithmically spaced where there are many, and the amplitude spectral density at each."""
    f, power = welch(y, step, hann_window(min(WELCH_SAMPLES, len(y))))
    picks = np.unique(np.geomspace(1, len(f) - 1, FREQUENCIES).astype(int)) if len(f) > 1 else np.array([0])
    return np.asarray(f[picks]), np.sqrt(np.maximum(power[picks], np.finfo(np.float32).tiny))
