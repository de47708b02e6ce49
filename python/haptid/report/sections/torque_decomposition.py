"""Torque decomposition: inertia, Coriolis and centrifugal torques, gravity, friction and the other terms."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.end_effector.torque_decomposition import TorqueDecomposition
from haptid.report.chart import COLOURS, Chart, axis, chart_series, even, packed, plot, quantised
from haptid.report.section import Section
from haptid.report.source import ReportSource, Track

# Points in time of a stacked chart.
INSTANTS = 500


@dataclass(frozen=True)
class TorqueDecompositionSection(Section):
    """Parts of the torque.

    Attributes:
        logs: for each log its name, which rows, the indices of its charts, and a table of shares by motor.
    """

    key: ClassVar[str] = "torque_decomposition"
    title: ClassVar[str] = "Torque decomposition"
    logs: list[dict[str, Any]]

    @classmethod
    def of(cls, source: ReportSource) -> TorqueDecompositionSection | None:
        charts: list[Chart] = []
        logs = []
        for k, (track, decomposition) in enumerate(zip(source.tracks, source.decompositions, strict=True)):
            if decomposition is None:
                continue
            own = [
                shares(decomposition, k),
                *(_stacked(track, decomposition, k, motor) for motor in range(len(decomposition.motors))),
            ]
            numbers = list(range(len(charts), len(charts) + len(own)))
            logs.append({"name": track.name, "seen": track.seen, "kind": track.kind, "charts": numbers})
            charts += own
        return cls(charts=tuple(charts), logs=logs) if logs else None


def shares(decomposition: TorqueDecomposition, k: int) -> Chart:
    """RMS of each part as a share of the sum of all parts' RMS, by motor."""
    totals = decomposition.rms.sum(axis=0)
    terms = present(decomposition)
    parts = decomposition.rms / np.where(totals > 0, totals, 1.0)
    largest = [decomposition.parts[int(j)] for j in np.argmax(decomposition.rms, axis=0)]
    first = ", ".join(
        f"{motor}: {part} {100 * float(parts[decomposition.parts.index(part), m]):.0f} %"
        for m, (motor, part) in enumerate(zip(decomposition.motors, largest, strict=True))
    )
    caption = f"RMS of each part over the sum of all parts' RMS. Largest part: {first}."
    drawing = {
        "kind": "bars",
        "rows": list(decomposition.motors),
        "parts": [{"name": decomposition.parts[j], "colour": _colour(j)} for j in terms],
        "values": packed(100 * parts[terms].T),
        "unit": "%",
    }
    return Chart(f"shares-{k}", "Shares", "Shares of the parts of the torque, a bar for each motor.", caption, drawing)


def _stacked(track: Track, decomposition: TorqueDecomposition, k: int, motor: int) -> Chart:
    """The parts of one motor's torque over time, positive ones stacked upwards and negative ones downwards."""
    label, unit = decomposition.motors[motor], decomposition.units[motor]
    width = -(-len(decomposition.t) // INSTANTS)
    t0 = track.t0 + 0.5 * (width - 1) * track.step
    total = averaged(decomposition.total[motor], width)
    times = even(t0, width * track.step, len(total))
    curves = [
        chart_series(
            decomposition.parts[j],
            "stack",
            _colour(j),
            x=times,
            y=quantised(averaged(decomposition.torque[j, motor], width)),
        )
        for j in present(decomposition)
    ]
    curves.append(chart_series("model", "line", "black", x=times, y=quantised(total), width=1))
    text = ", ".join(
        f"{decomposition.parts[j]} {float(decomposition.rms[j, motor]):.3g}" for j in present(decomposition)
    )
    drawn = f"Means over {width} rows are drawn ({width * track.step:.3g} s)." if width > 1 else "Every row is drawn."
    caption = f"RMS in {unit}: {text}. {drawn}"
    alt = f"Parts of the torque of {label} stacked against time, {track.name}."
    drawing = plot(axis("time", "s"), axis("torque", unit), curves, group=f"parts-{k}", height=220, zoom=True)
    return Chart(f"parts-{k}-{motor}", label, alt, caption, drawing)


def averaged(y: Array, width: int) -> Array:
    """Means of every `width` values, the last bin shorter, (bins,)."""
    starts = np.arange(0, len(y), width)
    return np.asarray(np.add.reduceat(y, starts) / np.diff(np.append(starts, len(y))))


def present(decomposition: TorqueDecomposition) -> list[int]:
    """Parts that are not zero throughout on every motor."""
    return [int(j) for j in np.flatnonzero(decomposition.rms.any(axis=1))]


def _colour(part: int) -> str:
    """Colour of a part; black is the whole torque."""
    return COLOURS[1:][part % (len(COLOURS) - 1)]
