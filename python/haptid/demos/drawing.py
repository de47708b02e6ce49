"""Curves and panels of the demonstrations' figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from haptid._internal.arrays import Array

# Colours that colour-blind readers tell apart (Okabe and Ito 2008).
BLACK, BLUE, ORANGE, GREEN, PURPLE = "#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7"


@dataclass(frozen=True)
class Curve:
    """A line to be drawn: its name, its values by panel, (panels, n), colour, width and style."""

    name: str
    values: Array
    colour: str
    width: float = 1.2
    style: str = "-"


def panels(title: str, t: Array, curves: Sequence[Curve], labels: Sequence[str], path: Path) -> None:
    """One panel for each motor, one above the other."""
    figure = picture(title, (10, 1.2 + 2.1 * len(labels)))
    rows = figure.subplots(len(labels), 1, sharex=True)
    for k, (panel, label) in enumerate(zip(rows, labels, strict=True)):
        lines(panel, t, curves, k, label)
    rows[-1].set_xlabel("time, s")
    figure.savefig(path, dpi=120)


def picture(title: str, size: tuple[float, float]) -> Figure:
    """An empty picture with a title."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    return figure


def lines(panel: Axes, t: Array, curves: Sequence[Curve], row: int, label: str) -> None:
    """The curves of one panel, with a legend where it is the first of them."""
    for curve in curves:
        panel.plot(
            t, curve.values[row], color=curve.colour, linewidth=curve.width, linestyle=curve.style, label=curve.name
        )
    panel.set_ylabel(label)
    panel.margins(x=0)
    panel.grid(alpha=0.3)
    if row == 0:
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(curves), fontsize="small", frameon=False)
