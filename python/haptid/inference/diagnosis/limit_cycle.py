"""Does a motor that should stand still go back and forth? Limit cycles of play or friction with the controller.

Where a joint with play or dry friction is held by a controller that integrates, it swings about its place with one
period and one size for as long as it is held. Looked for in the positions alone: in each second of a log in which a
position stays in a small part of its range, whether it repeats itself, again and again, without decaying.

Source: Nordin and Gutman (2002), Automatica 38(10), section 4.1, on limit cycles of controlled play.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.estimation import Estimate
from haptid.inference.diagnosis.finding import Finding, shown_time
from haptid.log import Log
from haptid.log.spectrum import spectra
from haptid.motion.channels import position_channels
from haptid.uncertainty.quantities import half_width

# Length of a window, s; largest part of the position's range that counts as held, and the fewest steps of the encoder.
_WINDOW, _HELD, _STEPS = 1.0, 0.02, 4.0
# Fewest periods in a window, and samples in a period.
_PERIODS, _SAMPLES = 4, 6
# Least autocorrelation at a period, and least size of the second half of a window over that of the first: a vibration
# of a link on its spring decays.
_REPEATS, _STAYS = 0.8, 0.85
# Fewest windows, and largest spread of their periods over the median.
_FEWEST, _SAME = 3, 0.1


@dataclass(frozen=True, eq=False)
class _Cycles:
    """Windows of one position channel in which it swings.

    Attributes:
        begin: of each window, s, (windows,).
        size: from end to end, rad or m, (windows,).
        period: s, (windows,).
    """

    begin: Array
    size: Array
    period: Array


def limit_cycle(estimate: Estimate) -> Finding | None:
    """The test of all positions that were measured, in the first log; None where there is no log."""
    motion = estimate.observation.motions[0]
    if motion.log is None:
        return None
    log, device = motion.log, estimate.model.device
    names = position_channels(device, log.channels.position.side)
    figures, named, windows = dict[str, float](), list[str](), list[float]()
    steps = [spectrum.step for spectrum in spectra(log)]
    for k, found in _swinging(log, steps):
        name = names[k]
        size, period = float(np.median(found.size)), float(np.median(found.period))
        half = float(half_width(float(found.size.std(ddof=1)) / np.sqrt(len(found.size)), len(found.size) - 1))
        half = max(half, steps[k])  # of an encoder, at both ends
        figures |= {f"{name}, {what}": value for what, value in (("size", size), ("frequency", 1 / period))}
        figures |= {f"{name}, low": size - half, f"{name}, high": size + half}
        windows += found.begin.tolist()
        unit = log.channels.position.each_unit[k] if k < len(log.channels.position.each_unit) else ""
        unit = "m" if unit in ("m", "mm", "um") else "rad"
        named.append(
            f"{name} by {size:.2g} {unit} from end to end ({size - half:.2g} .. {size + half:.2g} at 95 %), "
            f"{1 / period:.3g} times a second"
        )
    if not named:
        return Finding("limit cycle", "ok", figures, "No position that is held goes back and forth.")
    parts = ", ".join(f"[{shown_time(a)}, {shown_time(b)}]" for a, b in _joined(windows))
    text = (
        f"Held positions go back and forth without decaying: {'; '.join(named)}. Play or dry friction with a "
        f"controller that integrates does this. Rows of it say nothing of the links: exclude = [{parts}] in [[logs]]."
    )
    return Finding("limit cycle", "bad", figures, text)


def swinging_parts(log: Log) -> tuple[tuple[int, ...], list[tuple[float, float]]]:
    """Position channels of a log that swing where they are held, by index, and the times from .. to, s, of all."""
    found = list(_swinging(log, [spectrum.step for spectrum in spectra(log)]))
    return tuple(k for k, _ in found), _joined([begin for _, one in found for begin in one.begin.tolist()])


def _swinging(log: Log, steps: Sequence[float]) -> Iterator[tuple[int, _Cycles]]:
    """Position channels that swing, by index.

    Args:
        steps: of each channel's encoder, rad or m.
    """
    for k, x in enumerate(log.position.T):  # of a log on disk one at a time
        found = _cycles(log, np.asarray(x), steps[k])
        if found is not None:
            yield k, found


def _cycles(log: Log, x: Array, step: float) -> _Cycles | None:
    """Windows in which a channel swings; None where they are few or differ."""
    dt, most = float(log.dt), _HELD * float(np.ptp(x))
    length = round(_WINDOW / dt)
    if length < 2 * _PERIODS * _SAMPLES:
        return None
    begins = [k for start, stop in log.segments for k in range(start, stop - length + 1, length)]
    held = [k for k in begins if np.ptp(x[k : k + length]) < most]
    swings = [(log.t[k], *found) for k in held if (found := _swing(x[k : k + length], _STEPS * step)) is not None]
    if len(swings) < _FEWEST:
        return None
    begin, size, lag = np.array(swings, dtype=float).T
    same = np.abs(lag / np.median(lag) - 1) < _SAME
    if same.sum() < max(_FEWEST, 0.5 * len(swings)):
        return None
    return _Cycles(begin[same], size[same], lag[same] * dt)


def _swing(x: Array, least: float) -> tuple[float, float] | None:
    """Size, and period in samples, of a window that repeats itself without decaying, beside its drift.

    Args:
        least: size of one, rad or m: encoders of something that creeps have steps that repeat.
    """
    n = len(x)
    t = np.arange(n) - 0.5 * (n - 1)
    y = x - x.mean() - t * float(t @ x) / float(t @ t)
    if not np.ptp(y) > least:
        return None
    first, second = np.ptp(y[: n // 2]), np.ptp(y[n // 2 :])
    if not second > _STAYS * first or not first > _STAYS * second:
        return None
    power = fft.irfft(np.abs(fft.rfft(y, 2 * n)) ** 2)[:n]
    r = power / power[0] * n / np.arange(n, 0, -1)
    below = int(np.argmax(r < 0))  # it has left its beginning
    last = n // _PERIODS
    if not 0 < below < last:
        return None
    lag = below + int(np.argmax(r[below : last + 1]))
    if lag < _SAMPLES or r[lag] < _REPEATS:
        return None
    whole = x[: n - n % lag].reshape(-1, lag)
    return float(np.ptp(whole, axis=1).mean()), float(lag)


def _joined(begins: list[float]) -> list[tuple[float, float]]:
    """Times from begin to end, s, of windows one behind the other."""
    made = list[tuple[float, float]]()
    for begin in sorted(set(begins)):
        if made and begin <= made[-1][1] + 0.05 * _WINDOW:  # windows are whole samples long
            made[-1] = made[-1][0], begin + _WINDOW
        else:
            made.append((begin, begin + _WINDOW))
    return made
