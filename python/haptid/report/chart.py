"""Charts of a page: title, caption, alternative text, and plain values that the page's script draws."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass

# Colour-blind safe palette (Okabe and Ito 2008), by the names that charts use.
COLOURS = ("black", "blue", "vermillion", "green", "purple", "orange", "sky", "yellow")
# Colours of measured, predicted and residual in every chart.
MEASURED, PREDICTED, RESIDUAL = "black", "blue", "vermillion"

# Levels of quantised numbers, and the one of a missing value.
_MOST_LEVEL, _MISSING = 65534, 65535

_Style = Literal["line", "path", "envelope", "points", "band", "stack", "interval"]


@dataclass(frozen=True)
class Chart:
    """One figure of the page.

    Attributes:
        key: unique on the page, of letters, digits and hyphens.
        title: above the chart.
        alt: alternative text for screen readers.
        caption: its numbers, in sentences.
        drawing: plain values for the page's script; "kind" selects how they are drawn.
    """

    key: str
    title: str
    alt: str
    caption: str
    drawing: Mapping[str, Any]


def packed(values: ArrayLike) -> dict[str, Any]:
    """Numbers in the page's format: float32, little-endian, base64; NaN where a value is missing."""
    flat = np.ascontiguousarray(values, dtype="<f4").ravel()
    return {"f32": base64.b64encode(flat.tobytes()).decode("ascii"), "count": len(flat)}


def quantised(values: ArrayLike) -> dict[str, Any]:
    """Numbers of a dense curve or cloud in half the size: 65 535 levels over their range, which no screen resolves.

    For linear axes alone. NaN where a value is missing.
    """
    flat = np.asarray(values, dtype=float).ravel()
    known = np.isfinite(flat)
    low, high = (float(flat[known].min()), float(flat[known].max())) if known.any() else (0.0, 0.0)
    step = (high - low) / _MOST_LEVEL
    levels = np.full(len(flat), _MISSING, dtype="<u2")
    levels[known] = np.rint((flat[known] - low) / step) if step > 0 else 0
    text = base64.b64encode(levels.tobytes()).decode("ascii")
    return {"u16": text, "low": low, "step": step, "count": len(flat)}


def even(start: float, step: float, count: int) -> dict[str, Any]:
    """Evenly spaced numbers in the page's format."""
    return {"start": float(start), "step": float(step), "count": int(count)}


def axis(label: str, unit: str = "", **settings: Any) -> dict[str, Any]:
    """An axis: label, unit, and settings such as log, low, high, zero."""
    return {"label": label, "unit": unit, **settings}


def plot(
    x: Mapping[str, Any], y: Mapping[str, Any], chart_series: Sequence[Mapping[str, Any]], **more: Any
) -> dict[str, Any]:
    """A plot of curves; `group` links horizontal axes, `height` is in pixels, `equal` gives both axes one scale."""
    return {"kind": "plot", "x": dict(x), "y": dict(y), "series": [dict(s) for s in chart_series], **more}


def chart_series(name: str, style: _Style, colour: str, **values: Any) -> dict[str, Any]:
    """One curve, cloud or band of a plot: x with y, or low and high."""
    return {"name": name, "style": style, "colour": colour, **values}


def envelope(name: str, colour: str, t0: float, step: float, y: Array, bins: int) -> dict[str, Any]:
    """A curve over evenly spaced times: every row, or the minimum and maximum of each bin where there are more rows.

    Args:
        name, colour: of the curve.
        t0, step: of the rows, s.
        y: (rows,), NaN where a value is missing.
        bins: largest number of bins.
    """
    width = -(-len(y) // bins)
    if width <= 2:
        return chart_series(name, "line", colour, x=even(t0, step, len(y)), y=quantised(y))
    low, high = extremes(y, width)
    middle = t0 + 0.5 * (width - 1) * step
    return chart_series(
        name, "envelope", colour, x=even(middle, width * step, len(low)), low=quantised(low), high=quantised(high)
    )


def extremes(y: Array, width: int) -> tuple[Array, Array]:
    """Minimum and maximum of every `width` values, the last bin shorter; NaN is ignored, (bins,) each."""
    starts = np.arange(0, len(y), width)
    return np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)


def shaded(t0: float, step: float, is_out: np.ndarray, bins: int) -> list[list[float]]:
    """Time ranges of excluded rows, [[from, to], ...], s; those too short to be visible are left out.

    Args:
        t0, step: of the rows, s.
        is_out: whether each row is excluded, (rows,).
        bins: of the chart; a bin is shaded where most of its rows are excluded.
    """
    width = max(1, -(-len(is_out) // bins))
    starts = np.arange(0, len(is_out), width)
    most = np.add.reduceat(is_out.astype(int), starts) * 2 > width
    edges = np.flatnonzero(np.diff(np.concatenate([[0], most.astype(int), [0]]))).reshape(-1, 2)
    return [
        [round(t0 + step * (width * a - 0.5), 6), round(t0 + step * (width * b - 0.5), 6)] for a, b in edges.tolist()
    ]


def figure(value: float, digits: int = 3) -> str:
    """A number as text."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "unknown"
