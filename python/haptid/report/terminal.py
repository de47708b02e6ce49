"""Sparklines of the residual for a terminal: one line for each log and motor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from haptid._internal.arrays import Array
from haptid.report.source import ReportSource, Track

BARS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"
# Characters of a line.
_WIDTH = 40


def sparklines(source: ReportSource) -> tuple[str, ...]:
    """RMS of the residual over time, a line for each log and motor with used rows."""
    return tuple(line for track in source.tracks for line in _lines(track))


def _lines(track: Track) -> Iterator[str]:
    width = max(len(label) for label in track.labels)
    yield f"Residual along {track.name} ({track.kind}), {track.seconds:.3g} s"
    for k in track.motors_used:
        levels = rms_of_bins(track.residual[k], _WIDTH)
        yield f"  {track.labels[k]:{width}s} {sparkline(levels)} up to {np.nanmax(levels):.2g} {track.units[k]}"


def rms_of_bins(y: Array, bins: int) -> Array:
    """Root mean square in each of at most `bins` bins, NaN where all of its values are missing, (bins,)."""
    starts = np.unique(np.linspace(0, len(y), bins, endpoint=False).astype(int))
    known = np.isfinite(y)
    power = np.add.reduceat(np.where(known, y, 0.0) ** 2, starts)
    count = np.add.reduceat(known.astype(float), starts)
    return np.sqrt(np.where(count > 0, power / np.maximum(count, 1.0), np.nan))


def sparkline(levels: Array) -> str:
    """Levels as bars from zero to the largest; a space where one is missing."""
    top = float(np.nanmax(levels, initial=0.0)) or 1.0
    heights = np.ceil(len(BARS) * np.nan_to_num(levels) / top).astype(int)
    return "".join(BARS[max(h, 1) - 1] if np.isfinite(v) else " " for h, v in zip(heights, levels, strict=True))
