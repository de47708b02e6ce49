"""Measured against predicted torque, drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from haptid._values import Array
from haptid.prediction import Prediction

# Colours that colour-blind readers tell apart (Okabe and Ito 2008).
MEASURED, PREDICTED, RESIDUAL = "#000000", "#0072B2", "#D55E00"
# More points than this cannot be seen: below it every row is drawn, above it the extremes of each pixel.
PIXELS = 2000


def plot_torque(prediction: Prediction, title: str, path: Path) -> None:
    """One panel for each motor: measured and predicted torque, and the residual, against time."""
    motors = len(prediction.motors)
    figure = Figure(figsize=(10, 1.2 + 1.9 * motors), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    panels = np.atleast_1d(figure.subplots(motors, 1, sharex=True))
    for k, panel in enumerate(panels):
        draw_motor(panel, prediction, k)
    panels[-1].set_xlabel("time, s")
    panels[0].legend(loc="upper right", ncols=3, fontsize="small", framealpha=0.9)
    figure.savefig(path, dpi=120)


def draw_motor(panel: Axes, prediction: Prediction, k: int) -> None:
    """Measured, predicted, residual of one motor; stretches that do not count are shaded."""
    measured, predicted = prediction.measured[k], prediction.predicted[k]
    for y, colour, name, width in (
        (measured, MEASURED, "measured", 2.2),
        (predicted, PREDICTED, "predicted", 0.9),
        (measured - predicted, RESIDUAL, "residual", 0.7),
    ):
        panel.plot(*thinned(prediction.t, y), color=colour, label=name, linewidth=width)
    low, high = panel.get_ylim()
    dropped = ~prediction.used[k]
    if dropped.any():
        panel.fill_between(prediction.t, low, high, where=dropped, color="0.85", linewidth=0, zorder=0)
        panel.set_ylim(low, high)
    panel.set_ylabel(f"motor {prediction.motors[k]}\n{prediction.units[k]}")
    panel.margins(x=0)
    panel.grid(alpha=0.3)


def thinned(t: Array, y: Array) -> tuple[Array, Array]:
    """The least and greatest of each of PIXELS stretches, in order, where there are more points than can be seen."""
    if len(y) <= 2 * PIXELS:
        return t, y
    edges = np.linspace(0, len(y), PIXELS + 1).astype(int)
    picks = [np.sort([a + np.argmin(y[a:b]), a + np.argmax(y[a:b])]) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    chosen = np.concatenate(picks)
    return t[chosen], y[chosen]
