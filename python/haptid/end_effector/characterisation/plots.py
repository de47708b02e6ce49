"""Plots of a characterisation: sweeps of a joint with confidence bands, and maps over two joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array, expect, freeze_fields
from haptid._internal.extras import needing
from haptid._internal.late import dataclass
from haptid.uncertainty.quantities import Field

with needing("drawing pictures"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Picture
    from matplotlib.ticker import LogLocator

# Colour-blind safe colours (Okabe and Ito 2008), and line styles.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_STYLES = ("-", "--", ":", "-.")
# Colour of unknown values on a map.
UNKNOWN = "0.8"
DECADE = 10.0


@dataclass(frozen=True, eq=False)
class SweepCurve:
    """Quantities along a sweep.

    Attributes:
        label: of the axis, with its unit, such as "q2, deg".
        x: (poses,).
        figures: by name, each (poses,) or (poses, values); all of one unit.
    """

    label: str
    x: Array
    figures: Mapping[str, Field]

    def __post_init__(self) -> None:
        freeze_fields(self, "x")
        for name, figure in self.figures.items():
            expect(name, figure.values.shape[:1], self.x.shape)


def plot_sweeps(sweeps: Sequence[SweepCurve], quantity: str, path: Path) -> None:
    """One panel for each sweep: a line style for each name, a colour for each value, confidence intervals as bands.

    Args:
        sweeps: to plot.
        quantity: label of the vertical axis, with its unit.
        path: of the picture.
    """
    picture = Picture(figsize=(1.5 + 4.2 * len(sweeps), 4.2), layout="constrained")
    FigureCanvasAgg(picture)
    panels = np.atleast_1d(picture.subplots(1, len(sweeps), sharey=True))
    for panel, sweep in zip(panels, sweeps, strict=True):
        for style, (name, figure) in zip(cycle(_STYLES), sweep.figures.items(), strict=False):
            _draw(panel, sweep.x, name, figure, style)
        panel.set_xlabel(sweep.label, parse_math=False)
        panel.grid(alpha=0.3)
        panel.margins(x=0)
    panels[0].set_ylabel(quantity, parse_math=False)
    panels[0].set_ylim(bottom=0)
    panels[-1].legend(fontsize="small", framealpha=0.9)
    picture.savefig(path, dpi=120)


def _draw(panel: Axes, x: Array, name: str, figure: Field, style: str) -> None:
    """Plot the values of one quantity: colours in order, one legend entry."""
    values = figure.values.reshape(len(x), -1)
    band = figure.conf_int()
    for k, colour in zip(range(values.shape[1]), cycle(_COLOURS), strict=False):
        panel.plot(x, values[:, k], color=colour, linestyle=style, label=name if k == 0 else None)
        if band is not None:
            low, high = np.moveaxis(band.reshape(len(x), -1, 2)[:, k], -1, 0)
            panel.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0)


def plot_map(x: Array, y: Array, value: Array, labels: tuple[str, str, str], path: Path) -> None:
    """A map of one positive quantity over two joints, on a logarithmic colour scale; unknown values are grey.

    Args:
        x, y: of the cells' centres, (columns,) and (rows,).
        value: (rows, columns), NaN where unknown.
        labels: of x, y and the value, with units.
        path: of the picture.
    """
    expect("value", value.shape, (len(y), len(x)))
    picture = Picture(figsize=(6.4, 4.8), layout="constrained")
    FigureCanvasAgg(picture)
    panel = picture.subplots()
    panel.set_facecolor(UNKNOWN)
    known = np.ma.masked_invalid(value)
    if known.count():
        mesh = panel.pcolormesh(x, y, known, cmap="cividis", norm="log", shading="nearest", rasterized=True)
        bar = picture.colorbar(mesh, ax=panel, label=labels[2])
        bar.ax.yaxis.set_major_formatter("{x:g}")
        # Over several decades the labels of minor ticks would overlap.
        bar.ax.yaxis.set_minor_formatter("{x:g}" if known.max() < DECADE * known.min() else "")
    if known.count() and known.min() < known.max():
        levels = LogLocator(subs=(1.0, 2.0, 5.0))
        lines = panel.contour(x, y, known, colors="white", linewidths=0.7, norm="log", locator=levels)
        panel.clabel(lines, fontsize="small")
    panel.set_xlabel(labels[0], parse_math=False)
    panel.set_ylabel(labels[1], parse_math=False)
    picture.savefig(path, dpi=120)
