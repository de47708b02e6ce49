"""Sections of a page that are made of paragraphs, tables of text and charts alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.report.chart import Chart, axis, chart_series, even, figure, packed, plot


@dataclass(frozen=True)
class TextTable:
    """A table of texts; its first row is the headings, its title may be empty."""

    title: str
    cells: Sequence[Sequence[str]]


@dataclass(frozen=True)
class DocumentSection:
    """Paragraphs, then tables, then charts."""

    template: ClassVar[str] = "document"
    key: str
    title: str
    text: tuple[str, ...] = ()
    tables: tuple[TextTable, ...] = ()
    charts: tuple[Chart, ...] = ()


def panels(
    key: str, title: str, labels: Sequence[str], unit: str, t: Array, curves: Mapping[str, tuple[str, Array]]
) -> list[Chart]:
    """Curves over evenly spaced times, one chart for each row of their values, with linked time axes.

    Args:
        key: unique on the page.
        title: of the figure, before each label.
        labels: of the rows, (rows,).
        unit: of the values.
        t: (n,), s.
        curves: by name a colour of `chart.COLOURS` and the values, (rows, n).
    """
    times, names = even(t[0], t[1] - t[0], len(t)), ", ".join(curves)
    charts = []
    for k, label in enumerate(labels):
        drawn = [chart_series(name, "line", colour, x=times, y=packed(y[k])) for name, (colour, y) in curves.items()]
        rms = ", ".join(f"{name} {figure(float(np.sqrt(np.mean(y[k] ** 2))))}" for name, (_, y) in curves.items())
        drawing = plot(axis("time", "s"), axis(label, unit), drawn, group=key, height=190, zoom=True)
        alt = f"{label} against time: {names}."
        charts.append(Chart(f"{key}-{k}", f"{title}: {label}", alt, f"RMS, {unit}: {rms}.", drawing))
    return charts
