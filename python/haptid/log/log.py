"""Log, and the mapping from the channels of its file to positions and torques."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid._internal.display import Overview, displayed, tabulated
from haptid._internal.late import dataclass
from haptid.errors import LogChannelError, LogTimeError
from haptid.log import units
from haptid.log.lazy import MotionProfile, OnDisk, as_array
from haptid.log.registers import Register
from haptid.log.request import Merge
from haptid.log.resampling import Spans
from haptid.log.row_times import Sampling
from haptid.log.time_base import TimeBaseReport

Side = Literal["joint", "motor"]
# Fewest samples of the part that `Log.busiest` returns.
LEAST_ACTIVE_SAMPLES = 4096


@dataclass(frozen=True)
class Signal:
    """Channels of the positions or of the torques, with their unit and scaling: SI = unit * gain * raw + offset.

    Attributes:
        channels: name in the file of each, in the order of the device's active joints or motors.
        unit: position: rad, deg, turn, m, mm, um, counts; torque: N m, mN m, kN m, MN m, N, mN, kN, MN, V, mV, A, mA,
            counts.
        units: one for each channel in place of `unit`, as of an arm with angles and lengths.
        side: measured at the joint or at the motor's shaft.
        gain: one for each channel, or one for all; none is 1. Counts of position need it: rad or m each.
        offset: one for each channel, or one for all; none is 0; in SI, after the gain.
        unwrap: whether the channel jumps by its period and is to be unwrapped.
        period: of a wrapped channel in its own unit; None is one turn, and for counts the power of two nearest to the
            largest jump.
        constant_ok: whether a constant channel is allowed.
        allow_saturation: whether a torque that stays at its limit is allowed.
        register: how the channels write their sign, where they are words of a drive.
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
    register: Register = field(default_factory=Register)
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = (self.channels,) if isinstance(self.channels, str) else tuple(self.channels)
        if not names or not all(isinstance(name, str) and name for name in names):
            raise _setting("channels", repr(self.channels), "at least one name, and no empty one")
        if self.side not in ("joint", "motor"):
            raise _setting("side", repr(self.side), "'joint' or 'motor'")
        if self.period is not None and not (math.isfinite(self.period) and self.period > 0):
            raise _setting("period", repr(self.period), "a finite number above zero")
        object.__setattr__(self, "channels", names)
        object.__setattr__(self, "gain", _spread("gain", self.gain, len(names), 1.0))
        object.__setattr__(self, "offset", _spread("offset", self.offset, len(names), 0.0))
        if 0.0 in self.gain:
            raise _setting("gain", "0", "a factor other than zero for each channel")
        if len(self.units) not in (0, len(names)):
            raise _setting("units", f"{len(self.units)} units for {len(names)} channels", "one for each")

    @property
    def each_unit(self) -> tuple[str, ...]:
        """Unit of each channel."""
        return self.units or (self.unit,) * len(self.channels)

    def scales(self, quantity: Literal["position", "velocity", "torque"]) -> tuple[float, ...]:
        """Factor from the unit of each channel to SI."""
        return tuple(units.scale(unit, quantity)[1] for unit in self.each_unit)

    def one(self, name: str) -> Signal:
        """The signal of one channel."""
        k = self.channels.index(name)
        return replace(
            self,
            channels=(name,),
            unit=self.each_unit[k],
            units=(),
            gain=self.gain[k : k + 1],
            offset=self.offset[k : k + 1],
        )


def _spread(name: str, given: ArrayLike, n: int, default: float) -> tuple[float, ...]:
    """One finite value for each of n channels."""
    values = [float(v) for v in np.atleast_1d(np.asarray(given, dtype=np.float64)).ravel()] or [default]
    if len(values) not in (1, n):
        raise _setting(name, f"{len(values)} values for {n} channels", "one for all, or one for each")
    if not all(math.isfinite(v) for v in values):
        raise _setting(name, repr(given), "finite numbers")
    return tuple(values * n if len(values) == 1 else values)


def _setting(name: str, found: str, wanted: str) -> LogChannelError:
    """Error of a setting of a signal or of channels."""
    return LogChannelError(f"{name} is {found}; wanted {wanted}.", where=name, found=found, limit=wanted)


@tabulated
@dataclass(frozen=True)
class Channels:
    """Mapping from a file's channels to the signals of a log.

    Attributes:
        position: the positions.
        torque: the torques, or commands proportional to them.
        time: channel of the sample times; or else `rate_hz`.
        time_unit: s, ms, us or ns.
        rate_hz: sampling rate, in place of a time channel.
        sampling: where stamps are irregular, "stamps" takes them as the times of the samples, "regular" takes the
            samples as regular, and "auto" chooses by the positions.
        stale: "drop" or "keep" rows that repeat the row before although the device moves.
        merge: of channels that have other stamps, in logs of messages.
        velocity: of the positions, in their order and at their side; used where they are less noisy than differences.
    """

    position: Signal
    torque: Signal
    time: str | None = None
    time_unit: str = "s"
    rate_hz: float | None = None
    sampling: Sampling = "auto"
    stale: Literal["drop", "keep"] = "drop"
    merge: Merge = field(default_factory=Merge)
    velocity: Signal | None = None

    def __post_init__(self) -> None:
        self.position.scales("position"), self.torque.scales("torque")
        if self.velocity is not None:
            self.velocity.scales("velocity")
            count = len(self.position.channels)
            if len(self.velocity.channels) != count:
                raise _setting("velocity", f"{len(self.velocity.channels)} channels", f"{count}, one for each position")
        units.scale(self.time_unit, "time")
        counts = [
            gain for gain, unit in zip(self.position.gain, self.position.each_unit, strict=True) if unit == "counts"
        ]
        if counts and all(gain == 1.0 for gain in counts):
            raise LogChannelError(
                "positions are in counts without a gain.",
                where="gain",
                advice="Give the position signal gain=... in rad or m per count, one value for all or one for each; or "
                "its unit, where these are no counts.",
            )
        if (self.time is None) == (self.rate_hz is None):
            raise LogChannelError(
                "neither `time` nor `rate_hz` is given."
                if self.time is None
                else f"both time={self.time!r} and rate_hz={self.rate_hz:g} are given.",
                where="time",
                found=(self.time, self.rate_hz),
                advice="Give one: the channel with the sample times, or the rate where there is none or it is more "
                "accurate than the stamps.",
            )
        if self.rate_hz is not None and not (math.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise _setting("rate_hz", repr(self.rate_hz), "a finite number above zero")
        for name, known in (("sampling", get_args(Sampling)), ("stale", ("drop", "keep"))):
            if getattr(self, name) not in known:
                raise _setting(name, repr(getattr(self, name)), " or ".join(repr(word) for word in known))
        seen: dict[str, str] = {} if self.time is None else {self.time: "time"}
        signals = {"position": self.position, "torque": self.torque}
        for kind, signal in (signals | ({} if self.velocity is None else {"velocity": self.velocity})).items():
            for k, name in enumerate(signal.channels, 1):
                place = f"{kind} {k}"
                if seen.setdefault(name, place) != place:
                    raise LogChannelError(
                        f"channel {name!r} is mapped twice, as {seen[name]} and as {place}.",
                        where=name,
                        found=(seen[name], place),
                        advice="Give each its own channel.",
                    )

    @property
    def sources(self) -> tuple[str, ...]:
        """All channels that are read, time first."""
        time = () if self.time is None else (self.time,)
        rates = () if self.velocity is None else self.velocity.channels
        return (*time, *self.position.channels, *self.torque.channels, *rates)

    @property
    def torque_unit(self) -> str:
        """Unit of the torques of a log: N m, N, V, A or counts; several are joined by commas."""
        return ", ".join(dict.fromkeys(self.torque_units))

    @property
    def torque_units(self) -> tuple[str, ...]:
        """Unit of each torque of a log."""
        return tuple(units.scale(unit, "torque")[0] for unit in self.torque.each_unit)


@displayed
@dataclass(frozen=True, eq=False)
class Log:
    """Checked recording of positions and torques, in SI, on a uniform grid.

    Each channel is contiguous in memory: `position.T` and `torque.T` are C-contiguous. In a log that was opened and
    not read, `position` and `torque` are `OnDisk`.

    Attributes:
        path: the file.
        sha256: of the file's bytes; empty for a log that was not read from one.
        t: times on a uniform grid, (n,), s from the file's first sample; uniform within each segment.
        position: (n, positions), rad or m, at the side given by `channels.position`.
        torque: (n, torques), in `channels.torque_unit`, at the side given by `channels.torque`.
        channels: mapping from the file.
        notes: findings and repairs while reading, one sentence each.
        segments: first sample and one past the last of each part without a gap; one part where left out. Nothing is
            filtered or differentiated across their ends.
        time_base: what was found in the stamps; None for a log that was not read.
        position_steps: of each position as it was recorded, rad or m, 0 where it has none; empty where positions are as
            they were recorded.
    """

    path: Path
    sha256: str
    t: Array
    position: Array
    torque: Array
    channels: Channels
    notes: tuple[str, ...] = field(default=())
    segments: Spans = ()
    time_base: TimeBaseReport | None = None
    position_steps: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", Path(self.path))
        object.__setattr__(self, "t", read_only(self.t))
        expect("t", self.t.shape, (None,))
        if self.t.size < 2:
            raise LogTimeError(
                f"{self.path}: {self.t.size} samples, below the limit of 2.",
                where=self.path,
                found=self.t.size,
                limit=2,
                advice="Record longer, or widen `time_range`.",
            )
        for name, signal in (("position", self.channels.position), ("torque", self.channels.torque)):
            expect(name, np.shape(getattr(self, name)), (self.t.size, len(signal.channels)))
            object.__setattr__(self, name, _channel_major(getattr(self, name)))
        object.__setattr__(self, "notes", tuple(self.notes))
        object.__setattr__(self, "segments", tuple(self.segments) or ((0, self.t.size),))

    @property
    def dt(self) -> float:
        """Step of the grid, s."""
        start, stop = max(self.segments, key=lambda part: part[1] - part[0])
        return float(self.t[stop - 1] - self.t[start]) / (stop - start - 1)

    @property
    def usable_bandwidth_hz(self) -> float | None:
        """Highest frequency that the channels carry where they were resampled, Hz; None where they were not."""
        return None if self.time_base is None else self.time_base.usable_bandwidth_hz

    @property
    def rate_hz(self) -> float:
        """Sampling rate, Hz."""
        return 1.0 / self.dt

    @cached_property
    def spans(self) -> tuple[tuple[float, float], ...]:
        """Minimum and maximum of each position, rad or m."""
        if isinstance(self.position, OnDisk):
            return self.profile.spans
        return tuple((float(channel.min()), float(channel.max())) for channel in self.position.T)

    @cached_property
    def profile(self) -> MotionProfile:
        """Range of each position, and their activity over time."""
        return (
            self.position.profile()
            if isinstance(self.position, OnDisk)
            else MotionProfile.of(self.position.T, self.segments)
        )

    def parts(self) -> tuple[Log, ...]:
        """Each segment as a log without gaps, those shorter than half the longest left out."""
        least = 0.5 * max(stop - start for start, stop in self.segments)
        return tuple(self.between(start, stop) for start, stop in self.segments if stop - start >= least)

    def between(self, start: int, stop: int) -> Log:
        """Samples start..stop."""
        if (start, stop) == (0, self.t.size):
            return self
        clipped = ((max(a, start) - start, min(b, stop) - start) for a, b in self.segments)
        part = slice(start, stop)
        return replace(
            self,
            t=self.t[part],
            position=self.position[part],
            torque=self.torque[part],
            segments=tuple((a, b) for a, b in clipped if b - a >= 2),
        )

    def excerpt(self, ranges: Sequence[tuple[int, int]]) -> Log:
        """Some ranges of samples, first and one past the last of each, in memory; each is a part by itself."""
        parts = [self.between(start, stop) for start, stop in ranges]
        offsets = np.cumsum([0, *(part.t.size for part in parts)]).tolist()
        return replace(
            self,
            t=np.concatenate([part.t for part in parts]),
            position=np.concatenate([part.position for part in parts]),
            torque=np.concatenate([part.torque for part in parts]),
            segments=tuple((a + k, b + k) for k, part in zip(offsets, parts, strict=False) for a, b in part.segments),
        )

    def without(self, ranges: Sequence[tuple[float, float]]) -> Log:
        """The log without these parts, s; it is split there, so that nothing is filtered across them.

        Raises:
            LogTimeError: nothing is left.
        """
        if not ranges:
            return self
        kept = np.ones(self.t.size, dtype=bool)
        for start, stop in ranges:
            kept[(self.t >= start) & (self.t <= stop)] = False
        numbers = np.cumsum(kept)
        segments = []
        for a, b in self.segments:
            edges = np.flatnonzero(np.diff(np.concatenate([[0], kept[a:b].astype(int), [0]]))).reshape(-1, 2) + a
            segments += [
                (int(numbers[low]) - 1, int(numbers[high - 1])) for low, high in edges.tolist() if high - low > 1
            ]
        if not segments:
            raise LogTimeError(
                f"{self.path}: `exclude` leaves no part of the log.", where=self.path, found=0, advice="Exclude less."
            )
        return replace(
            self,
            t=self.t[kept],
            position=np.asarray(self.position)[kept],
            torque=np.asarray(self.torque)[kept],
            segments=tuple(segments),
            notes=(*self.notes, f"{int((~kept).sum())} of {self.t.size} samples are left out, as the study says"),
        )

    def busiest(self, seconds: float) -> Log:
        """The part of given length with the most activity of its positions; LEAST_ACTIVE_SAMPLES samples at least."""
        keep = min(self.t.size, max(LEAST_ACTIVE_SAMPLES, round(seconds / self.dt)))
        if keep == self.t.size:
            return self
        total = np.concatenate([[0.0], np.cumsum(self.profile.activity)])
        start = int(np.argmax(total[keep:] - total[:-keep]))
        return self.between(start, start + keep)

    def _shown(self) -> Overview:
        own = (units.scale(unit, "position")[0] for unit in self.channels.position.each_unit)
        rows = [[name, "on disk", unit] for name, unit in zip(self.channels.position.channels, own, strict=True)]
        if not isinstance(self.position, OnDisk):
            rows = [
                [row[0], f"{low:.4g} .. {high:.4g}", row[2]] for row, (low, high) in zip(rows, self.spans, strict=True)
            ]
        about = f"{self.t.size} samples, {self.rate_hz:.5g} Hz, {float(self.t[-1] - self.t[0]):.4g} s"
        torques = f"torques {', '.join(self.channels.torque.channels)} in {self.channels.torque_unit}"
        return Overview(f"Log {self.path.name}: {about}", ("position", "range", "unit"), rows, (torques, *self.notes))


def _channel_major(array: ArrayLike) -> Array:
    """The (n, channels) array, read-only, every channel contiguous; copied only where necessary."""
    if isinstance(array, OnDisk):
        return as_array(array)
    given = np.asarray(array, dtype=np.float64)
    ordered = np.asfortranarray(given)
    return read_only(given) if ordered is given else freeze(ordered)
