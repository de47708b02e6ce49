"""Plots of measured and predicted torque as PNG."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.extras import needing
from haptid.validation.prediction import Prediction

with needing("drawing pictures"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

# Colour-blind safe palette (Okabe and Ito 2008).
_MEASURED, _PREDICTED, _RESIDUAL = "#000000", "#0072B2", "#D55E00"
# Shade of excluded rows.
DROPPED = "0.85"
# PNG compression level: a tenth larger than the default, in a third of the time.
_FAST = 1
# Horizontal resolution: below it every row is drawn, above it the minimum and maximum of each bin.
_PIXELS = 2000


def plot_torque(parts: Iterable[Prediction], rows: int, title: str, path: Path) -> None:
    """Measured and predicted torque, and the residual, against time, one panel for each motor.

    Args:
        parts: chunks of one prediction, in order.
        rows: of all chunks together, which sets the resolution of each.
        title, path: of the picture.
    """
    drawn = [outline(part, rows) for part in parts]
    motors, units = drawn[0].motors, drawn[0].units
    height = 1.4 + 1.9 * len(motors)
    figure = Figure(figsize=(10, height))
    FigureCanvasAgg(figure)
    figure.suptitle(title, parse_math=False, y=1 - 0.12 / height, va="top")
    # Fixed margins: an automatic layout would draw everything twice.
    edges = {"left": 0.12, "right": 0.985, "bottom": 0.5 / height, "top": 1 - 0.65 / height}
    panels = np.atleast_1d(figure.subplots(len(motors), 1, sharex=True, gridspec_kw={"hspace": 0.1, **edges}))
    for k, panel in enumerate(panels):
        draw_motor(panel, drawn, k)
        panel.set_ylabel(f"{motors[k]}\n{units[k]}", parse_math=False)
    panels[-1].set_xlabel("time, s")
    # Above the panel, where it covers nothing.
    panels[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, fontsize="small", frameon=False)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name in letters that the font lacks
        figure.savefig(path, dpi=120, pil_kwargs={"compress_level": _FAST})


@dataclass(frozen=True, eq=False)
class Outline:
    """A chunk thinned for drawing: times and values of each motor and curve, and excluded rows."""

    motors: tuple[str, ...]
    units: tuple[str, ...]
    curves: tuple[tuple[tuple[Array, Array], ...], ...]
    dropped: tuple[tuple[Array, np.ndarray], ...]


def outline(part: Prediction, rows: int) -> Outline:
    """A chunk of a prediction of `rows` rows in all, thinned to the resolution of the plot."""
    bins = max(1, round(_PIXELS * len(part.t) / max(rows, 1))) if rows > 2 * _PIXELS else len(part.t)
    curves = [
        tuple(_thinned(part.t, y, bins) for y in (measured, predicted, measured - predicted))
        for measured, predicted in zip(part.measured, part.predicted, strict=True)
    ]
    every = slice(None, None, max(1, len(part.t) // (2 * bins)))
    dropped = tuple((part.t[every], ~used[every]) for used in part.used)
    return Outline(part.motors, part.units, tuple(curves), dropped)


def draw_motor(panel: Axes, drawn: list[Outline], k: int) -> None:
    """Measured, predicted and residual torque of one motor; excluded rows are shaded."""
    styles = ((_MEASURED, "measured", 3.4), (_PREDICTED, "predicted", 1.2), (_RESIDUAL, "residual", 0.7))
    for curve, (colour, name, width) in enumerate(styles):
        t, y = (np.concatenate([part.curves[k][curve][axis] for part in drawn]) for axis in (0, 1))
        panel.plot(t, y, color=colour, label=name, linewidth=width)
    t, dropped = (np.concatenate([part.dropped[k][axis] for part in drawn]) for axis in (0, 1))
    if dropped.any():
        low, high = panel.get_ylim()
        panel.fill_between(t, low, high, where=dropped, color=DROPPED, linewidth=0, zorder=0, label="excluded")
        panel.set_ylim(low, high)
    panel.margins(x=0)
    panel.grid(alpha=0.3)


def _thinned(t: Array, y: Array, bins: int) -> tuple[Array, Array]:
    """Minimum and maximum of each bin, in order of time, where there are more than two points per bin."""
    if len(y) <= 2 * bins:
        return t, y
    edges = np.linspace(0, len(y), bins + 1).astype(int)
    picks = [np.sort([a + np.argmin(y[a:b]), a + np.argmax(y[a:b])]) for a, b in pairwise(edges)]
    chosen = np.concatenate(picks)
    return t[chosen], y[chosen]
