"""Pictures of measured and predicted torque, as SVG: one panel for each motor.

The text is written here: to load a plotting library takes longer than to identify a device from a short log.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.escaping import one_line
from haptid._internal.late import dataclass
from haptid.validation.prediction import Prediction

# Tenths of a pixel: the picture, a panel, the space below it, and margins.
_WIDTH, _PANEL, _GAP = 10_000, 1700, 170
_LEFT, _RIGHT, _TOP, _BOTTOM = 1150, 9850, 700, 550
# Curves with colours (Okabe and Ito 2008, for the colour-blind) and widths, and the shade of excluded rows.
_CURVES = (("measured", "#000000", 34), ("predicted", "#0072B2", 14), ("residual", "#D55E00", 10))
_DROPPED = "#D9D9D9"
# Below twice as many rows every row is drawn, above it the minimum and maximum of each bin.
_BINS = 1000
# Most steps between marks on the axes of time and torque, and the space above and below the curves over their range.
_TIMES, _TORQUES, _SPACE = 10, 6, 0.05


def draw_torque(parts: Iterable[Prediction], rows: int, title: str, path: Path) -> None:
    """Measured and predicted torque, and the residual, against time, one panel for each motor.

    Args:
        parts: chunks of one prediction, in order.
        rows: of all chunks together, which sets the resolution of each.
        title, path: of the picture.
    """
    drawn = [_Outline.of(part, rows) for part in parts]
    t = [np.concatenate([part.dropped[k][0] for part in drawn]) for k in range(len(drawn[0].motors))]
    time = _Axis.of(min(float(own[0]) for own in t), max(float(own[-1]) for own in t), _LEFT, _RIGHT)
    height = _TOP + len(t) * (_PANEL + _GAP) - _GAP + _BOTTOM
    path.write_text("\n".join(_picture(drawn, time, height, html.escape(one_line(title)))) + "\n", encoding="utf-8")


def _picture(drawn: Sequence[_Outline], time: _Axis, height: int, title: str) -> Iterator[str]:
    """Lines of the file."""
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH // 10}" height="{height // 10}" '
        f'viewBox="0 0 {_WIDTH} {height}" role="img" font-family="sans-serif" font-size="120">'
    )
    yield f"<title>{title}</title>"
    yield f'<rect width="{_WIDTH}" height="{height}" fill="#FFFFFF"/>'
    yield _text(_WIDTH // 2, 250, title, 'text-anchor="middle" font-size="150"')
    yield from _legend(any(is_out.any() for part in drawn for _, is_out in part.dropped))
    last = len(drawn[0].motors) - 1
    for k in range(last + 1):
        yield from _panel(drawn, k, time, _TOP + k * (_PANEL + _GAP), k == last)
    yield _text((_LEFT + _RIGHT) // 2, height - 130, "time, s", 'text-anchor="middle"')
    yield "</svg>"


def _legend(excluded: bool) -> Iterator[str]:
    """Above the first panel, where it covers nothing."""
    x, y = _RIGHT - (3800 if excluded else 2850), _TOP - 130
    for name, colour, width in _CURVES:
        yield f'<path d="M{x} {y}h250" stroke="{colour}" stroke-width="{width}"/>'
        yield _text(x + 310, y + 40, name)
        x += 950
    if excluded:
        yield f'<rect x="{x}" y="{y - 60}" width="250" height="120" fill="{_DROPPED}"/>'
        yield _text(x + 310, y + 40, "excluded")


def _panel(drawn: Sequence[_Outline], k: int, time: _Axis, top: int, is_last: bool) -> Iterator[str]:
    """One motor: excluded stretches, marks, curves, frame."""
    curves = [
        [np.concatenate([part.curves[k][curve][axis] for part in drawn]) for axis in (0, 1)]
        for curve in range(len(_CURVES))
    ]
    known = [values[np.isfinite(values)] for _, values in curves]
    low = min((float(own.min()) for own in known if len(own)), default=0.0)
    high = max((float(own.max()) for own in known if len(own)), default=0.0)
    space = _SPACE * (high - low) or 1.0
    torque = _Axis.of(low - space, high + space, top + _PANEL, top)
    t, is_out = (np.concatenate([part.dropped[k][axis] for part in drawn]) for axis in (0, 1))
    if is_out.any():
        yield f'<path d="{_bands(time.places(t), is_out, top)}" fill="{_DROPPED}"/>'
    for place, label in torque.marks(_TORQUES):
        yield f'<path d="M{_LEFT} {place}H{_RIGHT}" stroke="#000000" stroke-opacity="0.15" stroke-width="8"/>'
        yield _text(_LEFT - 60, place + 40, label, 'text-anchor="end"')
    for place, label in time.marks(_TIMES):
        yield f'<path d="M{place} {top}v{_PANEL}" stroke="#000000" stroke-opacity="0.15" stroke-width="8"/>'
        if is_last:
            yield _text(place, top + _PANEL + 170, label, 'text-anchor="middle"')
    for (_, colour, width), (x, y) in zip(_CURVES, curves, strict=True):
        path = _line(time.places(x[np.isfinite(y)]), torque.places(y[np.isfinite(y)]))
        yield f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="{width}" stroke-linejoin="round"/>'
    yield (
        f'<rect x="{_LEFT}" y="{top}" width="{_RIGHT - _LEFT}" height="{_PANEL}" fill="none" stroke="#000000" '
        f'stroke-width="10"/>'
    )
    for at, name in ((300, drawn[0].motors[k]), (460, drawn[0].units[k])):
        turned = f'text-anchor="middle" transform="rotate(-90 {at} {top + _PANEL // 2})"'
        yield _text(at, top + _PANEL // 2, html.escape(one_line(name)), turned)


def _text(x: int, y: int, text: str, more: str = "") -> str:
    """A text that is escaped already."""
    return f'<text x="{x}" y="{y}" {more}>{text}</text>'


def _line(x: np.ndarray, y: np.ndarray) -> str:
    """Path through points at whole numbers: the first, then steps, which are short."""
    if not len(x):
        return ""
    steps = np.stack([np.diff(x), np.diff(y)], axis=1).ravel().tolist()
    return f"M{x[0]} {y[0]}" + (f"l{' '.join(map(str, steps))}" if steps else "")


def _bands(x: np.ndarray, is_out: np.ndarray, top: int) -> str:
    """Path about the stretches of excluded rows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_out.astype(int), [0]]))).reshape(-1, 2)
    return "".join(f"M{x[a]} {top}H{x[b - 1]}V{top + _PANEL}H{x[a]}z" for a, b in edges.tolist())


@dataclass(frozen=True)
class _Axis:
    """Values from `low` to `high`, and where in the picture they begin and end."""

    low: float
    high: float
    start: int
    end: int

    @staticmethod
    def of(low: float, high: float, start: int, end: int) -> _Axis:
        """Wider where both are one value."""
        return _Axis(low, high if high > low else low + 1.0, start, end)

    def places(self, values: Array) -> np.ndarray:
        """Of values, in tenths of a pixel."""
        share = (values - self.low) / (self.high - self.low)
        return np.rint(self.start + share * (self.end - self.start)).astype(int)

    def marks(self, most: int) -> Iterator[tuple[int, str]]:
        """Places and labels of round values: at most so many steps of 1, 2 or 5 and a power of ten."""
        least = (self.high - self.low) / most
        power = 10.0 ** math.floor(math.log10(least))
        step = power * next(times for times in (1, 2, 5, 10) if times * power >= least)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        for k in range(math.ceil(self.low / step), math.floor(self.high / step) + 1):
            value = k * step
            label = f"{value:.{digits}f}" if 1e-4 < step < 1e5 else f"{value:.6g}"
            yield int(self.places(np.array(value))), label


@dataclass(frozen=True, eq=False)
class _Outline:
    """A chunk thinned for drawing: times and values of each motor and curve, and excluded rows."""

    motors: tuple[str, ...]
    units: tuple[str, ...]
    curves: tuple[tuple[tuple[Array, Array], ...], ...]
    dropped: tuple[tuple[Array, np.ndarray], ...]

    @staticmethod
    def of(part: Prediction, rows: int) -> _Outline:
        """A chunk of a prediction of `rows` rows in all, thinned to the resolution of the picture."""
        bins = max(1, round(_BINS * len(part.t) / max(rows, 1))) if rows > 2 * _BINS else len(part.t)
        curves = [
            tuple(_thinned(part.t, y, bins) for y in (measured, predicted, measured - predicted))
            for measured, predicted in zip(part.measured, part.predicted, strict=True)
        ]
        every = slice(None, None, max(1, len(part.t) // (2 * bins)))
        dropped = tuple((part.t[every], ~used[every]) for used in part.used)
        return _Outline(part.motors, part.units, tuple(curves), dropped)


def _thinned(t: Array, y: Array, bins: int) -> tuple[Array, Array]:
    """Minimum and maximum of each bin, in order of time, where there are more than two points per bin."""
    if len(y) <= 2 * bins:
        return t, y
    width = -(-len(y) // bins)
    cells = np.pad(y, (0, -len(y) % width), mode="edge").reshape(-1, width)
    extremes = np.sort([cells.argmin(axis=1), cells.argmax(axis=1)], axis=0) + np.arange(0, len(y), width)
    chosen = np.minimum(extremes.T.ravel(), len(y) - 1)
    return t[chosen], y[chosen]
