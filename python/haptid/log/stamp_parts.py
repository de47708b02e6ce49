"""Times in two channels, whole seconds and their fraction, as messages of ROS and clients of robots write them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from haptid.log.formats.sniff import RawChannel

# Nanoseconds in the unit of the fraction.
_UNITS = {"ns": 1, "us": 1_000, "ms": 1_000_000}
_SUM = re.compile(r"(?P<seconds>.+) \[s\] \+ (?P<fraction>.+) \[(?P<unit>ns|us|ms)\]")
# Longest log, s: whole seconds that cover more are something else.
_LONGEST = 1e6
# Seconds of an epoch and of a fraction in one 64-bit number of nanoseconds.
_MOST_SECONDS = 9e9


def sum_of(seconds: str, fraction: str, unit: str) -> str:
    """Name of the channel of times that two channels make."""
    return f"{seconds} [s] + {fraction} [{unit}]"


def with_parts(wanted: Sequence[str]) -> list[str]:
    """The wanted channels, those that are sums replaced by their parts."""
    found: dict[str, None] = {}
    for name in wanted:
        match = _SUM.fullmatch(name)
        found.update(dict.fromkeys((match["seconds"], match["fraction"]) if match else (name,)))
    return list(found)


def with_sums(wanted: Sequence[str], found: Mapping[str, RawChannel]) -> dict[str, RawChannel]:
    """The wanted channels, sums in whole nanoseconds, of those that were found.

    Args:
        wanted: names, some of them sums.
        found: channels, parts of sums among them.
    """
    made: dict[str, RawChannel] = {}
    for name in wanted:
        match = _SUM.fullmatch(name)
        if name in found:
            made[name] = found[name]
        elif match and match["seconds"] in found and match["fraction"] in found:
            made[name] = _nanoseconds(found[match["seconds"]], found[match["fraction"]], _UNITS[match["unit"]])
    return made


def fraction_unit(seconds: RawChannel, fraction: RawChannel) -> str:
    """Unit of the second channel, where it holds the fraction of the whole seconds in the first; else empty.

    The fraction starts again wherever the seconds go on, and their sum grows.
    """
    columns = [np.asarray(column, dtype=np.float64) for column in (seconds, fraction)]
    if seconds.size != fraction.size or seconds.size < 3 or not all(np.isfinite(column).all() for column in columns):
        return ""
    whole, part = columns
    if not all(np.array_equal(column, np.rint(column)) and column.min() >= 0 for column in columns):
        return ""
    steps = np.diff(whole)
    if not ((steps >= 0).all() and 0 < whole[-1] - whole[0] < _LONGEST and whole[-1] < _MOST_SECONDS):
        return ""
    for unit, scale in _UNITS.items():
        times = _nanoseconds(whole, part, scale)
        fills = part.max() * scale < 1e9 and np.ptp(part) * scale > 5e8
        if (
            fills
            and (np.diff(times) >= 0).all()
            and (np.diff(part) < 0).any()
            and not (np.diff(part)[steps == 0] < 0).any()
        ):
            return unit
    return ""


def _nanoseconds(seconds: RawChannel, fraction: RawChannel, scale: int) -> NDArray[np.int64] | NDArray[np.float64]:
    """The sum of two columns, whole where all of their rows have a value."""
    if np.isfinite(seconds).all() and np.isfinite(fraction).all() and np.abs(seconds).max(initial=0.0) < _MOST_SECONDS:
        return np.rint(seconds).astype(np.int64) * 10**9 + np.rint(fraction).astype(np.int64) * scale
    return np.asarray(seconds, dtype=np.float64) * 1e9 + np.asarray(fraction, dtype=np.float64) * scale
