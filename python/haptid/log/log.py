"""What a log is, and how the channels of its file are mapped to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.errors import CountsGainError, LogTooShortError, MappedTwiceError, SignalError, TimeBaseError
from haptid.log import units
from haptid.log.on_disk import Course, OnDisk, as_array

Side = Literal["joint", "motor"]
# Samples that a stretch of a log has at least, whatever its rate.
LEAST_STRETCH = 4096


@dataclass(frozen=True)
class Signal:
    """Which channels are the positions, or the torques: SI = scale of the unit * gain * raw + offset.

    Attributes:
        channels: name in the file of each, in the order of the device's active joints or motors.
        unit: position: rad, deg, turn, m, mm, um, counts; torque: N m, mN m, N, V, mV, A, mA, counts.
        side: measured at the joint or at the motor's shaft.
        gain: one for each channel, or one for all; none is 1. Counts of position need it: rad or m each.
        offset: one for each channel, or one for all; none is 0; in SI, after the gain.
        unwrap: the channel jumps by its period: put the turns back.
        period: the jump of a wrapped channel in its own unit; None is one turn, and for counts the power of
            two nearest to the largest jump.
        constant_ok: a channel that never changes is meant to.
        allow_saturation: a torque held at its limit is meant to be used.
    """

    channels: tuple[str, ...]
    unit: str
    side: Side = "joint"
    gain: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    unwrap: bool = False
    period: float | None = None
    constant_ok: bool = False
    allow_saturation: bool = False

    def __post_init__(self) -> None:
        names = (self.channels,) if isinstance(self.channels, str) else tuple(self.channels)
        if not names or not all(isinstance(name, str) and name for name in names):
            raise SignalError("channels", repr(self.channels), "at least one name, and no empty one")
        if self.side not in ("joint", "motor"):
            raise SignalError("side", repr(self.side), "'joint' or 'motor'")
        if self.period is not None and not (math.isfinite(self.period) and self.period > 0):
            raise SignalError("period", repr(self.period), "a finite number above zero")
        object.__setattr__(self, "channels", names)
        object.__setattr__(self, "gain", _spread("gain", self.gain, len(names), 1.0))
        object.__setattr__(self, "offset", _spread("offset", self.offset, len(names), 0.0))
        if 0.0 in self.gain:
            raise SignalError("gain", "0", "a factor other than zero for each channel")


def _spread(name: str, given: ArrayLike, n: int, default: float) -> tuple[float, ...]:
    """One finite figure for each of n channels."""
    values = [float(v) for v in np.atleast_1d(np.asarray(given, dtype=np.float64)).ravel()] or [default]
    if len(values) not in (1, n):
        raise SignalError(name, f"{len(values)} figures for {n} channels", "one for all, or one for each")
    if not all(math.isfinite(v) for v in values):
        raise SignalError(name, repr(given), "finite numbers")
    return tuple(values * n if len(values) == 1 else values)


@dataclass(frozen=True)
class Channels:
    """How a file's channels become a log.

    Attributes:
        position: the positions.
        torque: the torques, or the commands that stand for them.
        time: channel of the sample times; or else `rate_hz`.
        time_unit: s, ms, us or ns.
        rate_hz: sampling rate where there is no time channel, or where it is better than the stamps.
    """

    position: Signal
    torque: Signal
    time: str | None = None
    time_unit: str = "s"
    rate_hz: float | None = None

    def __post_init__(self) -> None:
        si, _ = units.scale(self.position.unit, "position")
        units.scale(self.torque.unit, "torque")
        units.scale(self.time_unit, "time")
        if si == "counts" and all(gain == 1.0 for gain in self.position.gain):
            raise CountsGainError
        if (self.time is None) == (self.rate_hz is None):
            raise TimeBaseError(self.time, self.rate_hz)
        if self.rate_hz is not None and not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise SignalError("rate_hz", repr(self.rate_hz), "a finite number above zero")
        seen: dict[str, str] = {} if self.time is None else {self.time: "time"}
        for kind, signal in (("position", self.position), ("torque", self.torque)):
            for k, name in enumerate(signal.channels, 1):
                place = f"{kind} {k}"
                if seen.setdefault(name, place) != place:
                    raise MappedTwiceError(name, seen[name], place)

    @property
    def sources(self) -> tuple[str, ...]:
        """Every channel that is read, time first."""
        time = () if self.time is None else (self.time,)
        return (*time, *self.position.channels, *self.torque.channels)

    @property
    def torque_unit(self) -> str:
        """Unit of the torques of a log: N m, N, V, A or counts."""
        return units.scale(self.torque.unit, "torque")[0]


@dataclass(frozen=True, eq=False)
class Log:
    """What was recorded, checked, in SI and on a uniform grid.

    Each channel lies contiguous in memory: `position.T` and `torque.T` are C-contiguous. Of a log that was opened and
    not read, `position` and `torque` are `OnDisk`.

    Attributes:
        path: the file.
        sha256: of the file's bytes; empty for a log that was not read from one.
        t: times on a uniform grid, (n,), s from the file's first sample.
        position: (n, positions), rad or m, at the side that `channels.position` says.
        torque: (n, torques), in `channels.torque_unit`, at the side that `channels.torque` says.
        channels: where they come from.
        notes: what was found and done while reading, one sentence each.
    """

    path: Path
    sha256: str
    t: Array
    position: Array
    torque: Array
    channels: Channels
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "t", read_only(self.t))
        expect("t", self.t.shape, (None,))
        if self.t.size < 2:
            raise LogTooShortError(self.path, self.t.size, 2)
        for name, signal in (("position", self.channels.position), ("torque", self.channels.torque)):
            expect(name, np.shape(getattr(self, name)), (self.t.size, len(signal.channels)))
            object.__setattr__(self, name, _channel_major(getattr(self, name)))
        object.__setattr__(self, "notes", tuple(self.notes))

    @property
    def dt(self) -> float:
        """Step of the grid, s."""
        return float(self.t[-1] - self.t[0]) / (self.t.size - 1)

    @property
    def rate_hz(self) -> float:
        """Samples in a second."""
        return 1.0 / self.dt

    @cached_property
    def spans(self) -> tuple[tuple[float, float], ...]:
        """Least and greatest of each position, rad or m."""
        if isinstance(self.position, OnDisk):
            return self.course.spans
        return tuple((float(channel.min()), float(channel.max())) for channel in self.position.T)

    @cached_property
    def course(self) -> Course:
        """How far the positions go, and when they move."""
        return self.position.course() if isinstance(self.position, OnDisk) else Course.of(self.position.T)

    def busiest(self, seconds: float) -> Log:
        """The stretch in which its positions move most, each against its own spread.

        At most so long, but of LEAST_STRETCH samples where the log has them.
        """
        keep = min(self.t.size, max(LEAST_STRETCH, round(seconds / self.dt)))
        if keep == self.t.size:
            return self
        moved = self.course.moved
        total = np.concatenate([[0.0], np.cumsum(moved)])
        start = int(np.argmax(total[keep:] - total[:-keep]))
        part = slice(start, start + keep)
        return replace(self, t=self.t[part], position=self.position[part], torque=self.torque[part])


def _channel_major(array: ArrayLike) -> Array:
    """The (n, channels) array read-only with every channel contiguous; copied only where it must be."""
    if isinstance(array, OnDisk):
        return as_array(array)
    given = np.asarray(array, dtype=np.float64)
    ordered = np.asfortranarray(given)
    return read_only(given) if ordered is given else freeze(ordered)
