"""Picture of a frequency response: compliance of each motor, the others held, and the spring that fits it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.extras import needing
from haptid.inference.frequency_response import FrequencyResponse, Spring

with needing("drawing pictures"):
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

# Colour-blind safe palette (Okabe and Ito 2008).
_MEASURED, _FITTED = "#000000", "#0072B2"
_DRAWN = 400


def plot_response(response: FrequencyResponse, path: Path) -> None:
    """Plot size and phase of the compliance of each motor with 95 % bars, and its spring as a line, as PNG."""
    n = len(response.labels)
    figure = Figure(figsize=(1.0 + 4.2 * n, 5.4), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{response.device}: frequency response", parse_math=False)
    panels = figure.subplots(2, n, sharex=True, squeeze=False)
    for motor, spring in enumerate(response.springs):
        _draw(panels[:, motor], response, motor, spring if isinstance(spring, Spring) else None)
    panels[0, 0].legend(fontsize="small")
    figure.savefig(path, dpi=120)


def _draw(panels: np.ndarray, response: FrequencyResponse, motor: int, spring: Spring | None) -> None:
    size: Axes
    phase: Axes
    size, phase = panels
    Z, variance = response.stiffness(motor)
    Y = 1 / Z
    relative = np.sqrt(variance * response.circle) / np.abs(Z)
    # A circle about Y seen from the origin: its nearest and farthest point, and the half angle that it covers.
    bars = np.abs(Y) * np.minimum(relative, 0.999), np.abs(Y) * relative
    style: dict[str, Any] = {"fmt": ".", "color": _MEASURED, "capsize": 1.5, "elinewidth": 0.7}
    size.errorbar(response.f, np.abs(Y), np.array(bars), label="measured, 95 %", **style)
    angle = np.degrees(np.unwrap(np.angle(Y)))
    phase.errorbar(response.f, angle, np.degrees(np.arcsin(np.minimum(relative, 1.0))), **style)
    if spring is not None:
        f = np.geomspace(response.f[0], response.f[-1], _DRAWN)
        fitted = 1 / spring.dynamic_stiffness(f)
        turns = np.degrees(np.unwrap(np.angle(fitted)))
        turns += 360 * np.round((np.median(angle) - np.median(turns)) / 360)
        size.plot(f, np.abs(fitted), color=_FITTED, label="rotor, spring and link")
        phase.plot(f, turns, color=_FITTED)
    size.set_xscale("log")
    size.set_yscale("log")
    size.set_title(response.labels[motor], fontsize="medium", parse_math=False)
    unit = response.units[motor]
    size.set_ylabel(f"compliance, {unit}/{'N' if unit == 'm' else '(N m)'}")
    phase.set_ylabel("phase, deg")
    phase.set_xlabel("frequency, Hz")
    for panel in (size, phase):
        panel.grid(alpha=0.3, which="both")
