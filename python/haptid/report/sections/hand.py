"""Hand force: estimated from the motors, and measured where there was a sensor."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from haptid._internal.late import dataclass
from haptid.report.chart import MEASURED, PREDICTED, Chart, axis, chart_series, envelope, even, figure, packed, plot
from haptid.report.section import Section
from haptid.report.source import HandForceData, ReportSource

# Bins of a curve, and of the band around it.
_BINS, BAND = 2000, 500


@dataclass(frozen=True)
class HandSection(Section):
    """Forces at the handle.

    Attributes:
        logs: for each log its name, sentences, and the indices of its charts.
    """

    key: ClassVar[str] = "hand"
    title: ClassVar[str] = "Hand force"
    logs: list[dict[str, Any]]

    @classmethod
    def of(cls, source: ReportSource) -> HandSection | None:
        hands = [hand for hand in source.hands if np.isfinite(hand.force).any()]
        if not hands:
            return None
        charts = tuple(_chart(hand, k, axis) for k, hand in enumerate(hands) for axis in range(3))
        logs = [
            {"name": hand.name, "notes": list(hand.notes), "charts": [3 * k, 3 * k + 1, 3 * k + 2]}
            for k, hand in enumerate(hands)
        ]
        return cls(charts=charts, logs=logs)


def _chart(hand: HandForceData, k: int, component: int) -> Chart:
    """One component: the estimate with its 95 % interval, and the sensor."""
    t, y, letter = hand.t, hand.force[:, component], "xyz"[component]
    step = float(np.median(np.diff(t)))
    curves = [envelope("estimated", PREDICTED, float(t[0]), step, y, _BINS)]
    caption = f"Estimated: RMS {figure(_rms(y))} N."
    if hand.conf_int is not None:
        width = -(-len(t) // BAND)
        low, high = (hand.conf_int[::width, component, end] for end in (0, 1))
        times = even(float(t[0]), width * step, len(low))
        curves.insert(0, chart_series("95 % interval", "band", "sky", x=times, low=packed(low), high=packed(high)))
        caption += f" Half-width of the 95 % interval: RMS {figure(_rms(0.5 * (high - low)))} N."
    if hand.measured is not None:
        measured = hand.measured[:, component]
        curves.insert(-1, envelope("measured", MEASURED, float(t[0]), step, measured, _BINS) | {"width": 2.2})
        caption += f" Measured: RMS {figure(_rms(measured))} N; RMS difference {figure(_rms(y - measured))} N."
    alt = f"Force of the hand along {letter} against time, {hand.name}."
    drawing = plot(axis("time", "s"), axis(f"force {letter}", "N"), curves, group=f"hand-{k}", height=170, zoom=True)
    return Chart(f"hand-{k}-{letter}", f"Force along {letter}", alt, caption, drawing)


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
