"""Drift of the parameters over a series of results: what is significant, and every parameter against time."""

from __future__ import annotations

from collections.abc import Sequence

from haptid.inference.drift import Drift
from haptid.report.chart import Chart, axis, chart_series, figure, packed, plot
from haptid.report.document import DocumentSection, TextTable
from haptid.uncertainty.quantities import half_width


def drift_section(drift: Drift, dates: Sequence[str]) -> DocumentSection:
    """The section of a drift.

    Args:
        drift: the drift.
        dates: of the results, as they were given.
    """
    series, days = drift.series, drift.times - drift.times.min()
    half = half_width(series.se, series.dof, series.confidence)
    low, high = drift.conf_int().T
    margin = 0.03 * float(days.max())
    units = [f"{unit}/{drift.unit}" for unit in series.units]
    share = f"{100 * series.confidence:g} %"
    rows = [
        (name, figure(slope), f"{figure(a)} to {figure(b)}", unit, figure(p, 2), "yes" if name in drift.drifts else "")
        for name, slope, a, b, unit, p in zip(drift.names, drift.slope, low, high, units, drift.holm, strict=True)
    ]
    head = ("parameter", "slope", f"{share} interval", "unit", "p, Holm", "drifts")
    charts = [
        Chart(
            f"drift-{k}",
            name,
            f"{name} at {len(days)} dates with {share} intervals.",
            f"Slope {figure(drift.slope[k])} {units[k]}, {figure(low[k])} to {figure(high[k])}.",
            plot(
                axis(f"time since {min(dates)}", drift.unit, low=-margin, high=days.max() + margin),
                axis(name, series.units[k]),
                [
                    chart_series(
                        name,
                        "interval",
                        "vermillion" if name in drift.drifts else "blue",
                        x=packed(days),
                        y=packed(series.value[:, k]),
                        low=packed(series.value[:, k] - half[:, k]),
                        high=packed(series.value[:, k] + half[:, k]),
                    )
                ],
                height=170,
            ),
        )
        for k, name in enumerate(drift.names)
    ]
    joint = series.joint.sentences if series.joint else ()
    return DocumentSection(
        "drift", "Drift", (*drift.sentences, *joint), (TextTable("Slopes", (head, *rows)),), tuple(charts)
    )
