"""What a chart is made of: words for those who read it, words for those who cannot see it, and plain values to draw."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array

# Colours that colour-blind readers tell apart (Okabe and Ito 2008), by the name that charts use.
COLOURS = ("black", "blue", "vermillion", "green", "purple", "orange", "sky", "yellow")
# Measured, predicted and residual have the same colours everywhere.
MEASURED, PREDICTED, RESIDUAL = "black", "blue", "vermillion"

Style = Literal["line", "envelope", "points", "band", "stack", "interval"]


@dataclass(frozen=True)
class Chart:
    """One figure of the page.

    Attributes:
        key: unique on the page, of letters, digits and hyphens.
        title: above it.
        alt: what a reader who cannot see it would be told it shows.
        caption: its numbers, in sentences.
        drawing: plain values that the page's own script draws; "kind" says how.
    """

    key: str
    title: str
    alt: str
    caption: str
    drawing: Mapping[str, Any]


def packed(values: ArrayLike) -> dict[str, Any]:
    """Numbers as the page reads them: float32, little-endian, base64; NaN where there is none."""
    flat = np.ascontiguousarray(values, dtype="<f4").ravel()
    return {"f32": base64.b64encode(flat.tobytes()).decode("ascii"), "count": len(flat)}


def even(start: float, step: float, count: int) -> dict[str, Any]:
    """Evenly spaced numbers as the page reads them."""
    return {"start": float(start), "step": float(step), "count": int(count)}


def axis(label: str, unit: str = "", **settings: Any) -> dict[str, Any]:
    """An axis: what it shows, in which unit, and settings such as log, low, high, zero."""
    return {"label": label, "unit": unit, **settings}


def plot(
    x: Mapping[str, Any], y: Mapping[str, Any], series: Sequence[Mapping[str, Any]], **more: Any
) -> dict[str, Any]:
    """A drawing of curves over two axes; `group` links horizontal axes, `height` is in pixels."""
    return {"kind": "plot", "x": dict(x), "y": dict(y), "series": [dict(s) for s in series], **more}


def series(name: str, style: Style, colour: str, **values: Any) -> dict[str, Any]:
    """One curve, cloud or band of a plot: x with y, or low and high."""
    return {"name": name, "style": style, "colour": colour, **values}


def envelope(name: str, colour: str, t0: float, step: float, y: Array, bins: int) -> dict[str, Any]:
    """A curve over evenly spaced times: every row, or the least and greatest of each bin where there are more.

    Args:
        name, colour: of the curve.
        t0, step: of the rows, s.
        y: (rows,), NaN where there is none.
        bins: kept at most.
    """
    each = -(-len(y) // bins)
    if each <= 2:
        return series(name, "line", colour, x=even(t0, step, len(y)), y=packed(y))
    low, high = extremes(y, each)
    middle = t0 + 0.5 * (each - 1) * step
    return series(name, "envelope", colour, x=even(middle, each * step, len(low)), low=packed(low), high=packed(high))


def extremes(y: Array, each: int) -> tuple[Array, Array]:
    """Least and greatest of every `each` values, the last bin of what is left; NaN counts for nothing, (bins,) each."""
    starts = np.arange(0, len(y), each)
    return np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)


def shaded(t0: float, step: float, out: np.ndarray, bins: int) -> list[list[float]]:
    """Stretches of time in which rows do not count, [[from, to], ...], s; those too short to be seen are left out.

    Args:
        t0, step: of the rows, s.
        out: whether each row does not count, (rows,).
        bins: that the chart shows; a bin is out where most of its rows are.
    """
    each = max(1, -(-len(out) // bins))
    starts = np.arange(0, len(out), each)
    most = np.add.reduceat(out.astype(int), starts) * 2 > each
    edges = np.flatnonzero(np.diff(np.concatenate([[0], most.astype(int), [0]]))).reshape(-1, 2)
    return [[round(t0 + step * (each * a - 0.5), 6), round(t0 + step * (each * b - 0.5), 6)] for a, b in edges.tolist()]


def figure(value: float, digits: int = 3) -> str:
    """A number for a sentence."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "not known"
