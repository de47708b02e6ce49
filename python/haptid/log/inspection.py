"""Times and checks of a file's rows, before they are brought to the grid."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.log import checks, stamps, units
from haptid.log.formats.sniff import RawChannel
from haptid.log.log import Channels, Signal
from haptid.log.row_times import RawSignals
from haptid.log.time_base import TimeBase, at_rate, candidate_gaps, time_base

ChannelKind = Literal["position", "torque"]


@dataclass(frozen=True, eq=False)
class Times:
    """When the rows of a file were recorded.

    Attributes:
        path: of the file.
        rows: the part to keep.
        known: their stamps; None where a rate is given.
        seconds: times of these rows, as far as known, (rows,), s.
    """

    path: Path
    rows: slice
    known: stamps.Stamps | None
    seconds: Array

    @staticmethod
    def of(
        path: Path,
        channels: Channels,
        raw: RawChannel | None,
        count: int,
        time_range: tuple[float, float] | None,
        notes: list[str],
    ) -> Times:
        """Stamps of the part to keep, or a rate.

        Args:
            path: the file.
            channels: which of them is time.
            raw: that channel, (count,); overwritten. None where there is none.
            count: rows of the file.
            time_range: the part to keep, s.
            notes: appended to.
        """
        known = None
        if channels.time is None or raw is None:
            seconds = np.arange(count) / float(channels.rate_hz or 0.0)
            rows = stamps.part(path, seconds, time_range)
            stamps.check_length(path, rows.stop - rows.start)
        else:
            scale = units.scale(channels.time_unit, "time")[1]
            first, fineness = raw[0] * scale, stamps.resolution(raw) * scale
            seconds = stamps.since_first(path, channels.time, raw, scale)
            rows = stamps.part(path, seconds, time_range)
            known = stamps.checked(path, channels.time, seconds[rows], fineness)
            if abs(first) > 0.5 * float(np.median(np.diff(seconds[rows][:1000]))):
                notes.append(f"times count from the file's first stamp, {first:.9g} s")
        if time_range is not None:
            kept_count = rows.stop - rows.start
            notes.append(f"kept from {time_range[0]:g} to {time_range[1]:g} s: {kept_count} of {count} samples")
        return Times(path, rows, known, seconds[rows] if known is None else known.seconds)

    def gaps(self) -> NDArray[np.intp]:
        """Rows before a step too long for jitter."""
        return candidate_gaps(np.diff(self.seconds))[0]

    def base(self, inspection: Inspection, raw: Callable[[Signal], Iterable[Array]], channels: Channels) -> TimeBase:
        """The time base, once all channels are inspected.

        Args:
            inspection: of the channels.
            raw: gives the inspected channels of a signal, each (rows,).
            channels: of the file.
        """
        recorded = RawSignals(
            inspection.same["position"],
            inspection.same["torque"],
            lambda: raw(channels.position),
            lambda: raw(channels.torque),
        )
        keep = channels.stale == "keep"
        if self.known is None:
            rate = float(channels.rate_hz or 0.0)
            return at_rate(self.path, self.rows.start, self.rows.stop, rate, recorded, keep)
        return time_base(self.path, self.known, recorded, channels.sampling, keep)


class Inspection:
    """Checks and unwraps raw columns, one after the other.

    Attributes:
        path: the file.
        times: of the rows.
        notes: appended to.
        left_out: rows in parts that are left out, (rows,): a straight line stands for each channel there.
        moving: where each position differs from the sample before, as bits; complete after the positions.
        torque_ranges: of the torques so far, each (low, high) in the file's unit.
        same: whether all channels of a signal so far equal those of the row before, (rows,) each.
    """

    def __init__(self, path: Path, times: Times, notes: list[str], exclude: Sequence[tuple[float, float]] = ()) -> None:
        self.path, self.times, self.notes = path, times, notes
        self.moving: list[NDArray[np.uint8]] = []
        self.torque_ranges: list[tuple[float, float]] = []
        self.same = {kind: np.append(False, np.ones(times.seconds.size - 1, bool)) for kind in ("position", "torque")}
        self.left_out = np.zeros(times.seconds.size, dtype=bool)
        for start, stop in exclude:
            self.left_out |= (times.seconds >= start) & (times.seconds <= stop)
        self.gaps = times.gaps()

    def column(self, name: str, raw: RawChannel, signal: Signal, kind: ChannelKind, si: float) -> Array:
        """A channel of a signal at the stamps, (rows,), in the file's unit; positions before torques.

        Args:
            name, raw: of the channel; raw as it is in the file.
            signal, kind: that it belongs to.
            si: factor from its unit to SI.
        """
        column = signal.register.signed(raw.astype(np.float64, copy=False))
        self._note(checks.check_range(self.path, name, column, kind, signal.constant_ok, si))
        if kind == "position" and signal.unwrap:
            column, count = checks.unwrapped(column, signal.one(name))
            self._note(f"position channel {name!r} unwrapped at {count} jumps" if count else None)
        if self.left_out.any() and not self.left_out.all():
            if kind == "position":
                checks.refuse_lost_counts(self.path, name, column, self.times.seconds, si, self.left_out, self.gaps)
            kept = np.flatnonzero(~self.left_out)
            column = np.interp(np.arange(column.size), kept, column[kept])
        moved = column[1:] != column[:-1]
        self.same[kind][1:] &= ~moved
        if kind == "position":
            self.moving.append(np.packbits(moved))
            checks.jumps(self.path, name, column, self.times.seconds, signal.one(name), si, self.gaps)
        else:
            self._torque(name, column, signal)
        return column

    def _torque(self, name: str, column: Array, signal: Signal) -> None:
        """Check for saturation during motion of the paired position, or of any where they are not in pairs."""
        paired = len(self.moving) == len(signal.channels)
        bits = self.moving[signal.channels.index(name)] if paired else np.bitwise_or.reduce(self.moving)
        self._note(checks.saturated(self.path, name, column, bits, signal.one(name)))
        self.torque_ranges.append((float(column.min()), float(column.max())))
        if len(self.torque_ranges) == len(signal.channels):
            self._note(checks.without_sign(self.torque_ranges))

    def _note(self, sentence: str | None) -> None:
        if sentence:
            self.notes.append(sentence)
