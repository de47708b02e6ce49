"""What was found in a log: its channels, topics and the whole of it."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from haptid._internal.late import dataclass
from haptid.log.formats.sniff import RawChannel, group_of
from haptid.log.registers import Register

Quantity = Literal["time", "position", "velocity", "torque", "other"]
# How reasons begin of units that the file has, and that are no guess.
STATED = ("the file states", "by its name")
# How reasons end of torques of no stated unit beside a device file.
OF_DEVICE = "that of the device's motors"
# Arrays of fewer elements than this share of the rows are settings or results beside the recording.
A_PART = 0.02
# Channels of a topic or table that are looked at.
LOOKED_AT = 400


@dataclass(frozen=True)
class ChannelSurvey:
    """One channel.

    Attributes:
        name: in the file.
        count: samples that have it.
        missing: messages without it (empty, of other joints), and samples that are NaN.
        low, high: range of the others; NaN where there are none.
        whole: whether all are whole numbers.
        quantity, unit, reason: guess of what it is; no unit where there is no reason for one.
        register: how it seems to write its sign, where it is a word of a drive; its range is that with the sign.
        period: by which a position jumps, in its own unit; 0 where it does not.
        joint: name of its joint, where a column of texts beside it has that in every row, or a list names its array's.
    """

    name: str
    count: int
    missing: int
    low: float
    high: float
    whole: bool
    quantity: Quantity = "other"
    unit: str = ""
    reason: str = ""
    register: Register = field(default_factory=Register)
    period: float = 0.0
    joint: str = ""

    @property
    def rows(self) -> int:
        """Samples and missing ones."""
        return self.count + self.missing

    @property
    def usable(self) -> bool:
        """Whether it holds numbers that change."""
        return self.count > 0 and self.high > self.low


@dataclass(frozen=True)
class TopicSurvey:
    """One topic of a log of messages, or the table that a file is.

    Attributes:
        name: of the topic; empty for a table.
        kind: type of the messages; of a table its format.
        count: messages or rows.
        rate_hz: of the messages; 0 where not known.
        joints: names of the elements, in order of appearance.
        empty: arrays without elements, and in how many messages.
        channels: in order of appearance.
        header: the stamp of the messages; empty where they have none.
        late_ms: median of receive stamp minus header stamp, ms; NaN where there is no header.
        why_not: why it is not decoded; empty where it is.
        by_rates_hz: rate at which velocities are the rates of positions, of a table without times; 0 where not known.
        stated_hz: rate that a number beside the samples states; 0 where none does.
        stated_by: that number with its name; empty where none does.
    """

    name: str
    kind: str
    count: int
    rate_hz: float = 0.0
    joints: tuple[str, ...] = ()
    empty: dict[str, int] = field(default_factory=dict)
    channels: tuple[ChannelSurvey, ...] = ()
    header: str = ""
    late_ms: float = math.nan
    why_not: str = ""
    by_rates_hz: float = 0.0
    stated_hz: float = 0.0
    stated_by: str = ""


@dataclass(frozen=True)
class Survey:
    """A log's contents.

    Attributes:
        path: of the file or folder.
        format: name.
        notes: dialect, repairs, losses.
        topics: those of a log of messages, or one for a table.
        table: `[channels]` in TOML, units and choices marked as guesses; empty where no positions were found.
    """

    path: Path
    format: str
    notes: tuple[str, ...]
    topics: tuple[TopicSurvey, ...]
    table: str

    @property
    def lacking(self) -> tuple[Quantity, ...]:
        """Signals that the table has not: positions or torques that were not recognised."""
        named = tomllib.loads(self.table).get("channels", {}) if self.table else {}
        wanted: tuple[Quantity, ...] = ("position", "torque")
        return tuple(key for key in wanted if key not in named)

    @property
    def unequal(self) -> str:
        """Which channels of the table have more rows than others, in words; empty where none of them has.

        Of a folder of tables, whose files without times belong together row by row.
        """
        if not self.table or any(topic.name for topic in self.topics):
            return ""  # messages have stamps
        named = tomllib.loads(self.table).get("channels", {})
        rows = {channel.name: channel.rows for topic in self.topics if not topic.name for channel in topic.channels}
        chosen = {key: _first(named[key]) for key in ("position", "torque", "velocity", "time") if key in named}
        timed = {
            (group_of(channel.name), channel.rows)
            for topic in self.topics
            for channel in topic.channels
            if channel.quantity == "time" or channel.name.endswith("@time")
        }
        apart = {name for name in rows if (group_of(name), rows[name]) in timed and group_of(name)}  # merged by these
        first = chosen.get("position", "")
        for name in chosen.values():
            if first in rows and rows.get(name, rows[first]) != rows[first] and name not in apart:
                more, less = sorted((first, name), key=rows.__getitem__, reverse=True)
                return (
                    f"{more} has {rows[more]} rows and {less} has {rows[less]}, {rows[more] - rows[less]} fewer: "
                    "without times of their own, which rows belong together is not known"
                )
        return ""

    @property
    def quantities(self) -> frozenset[Quantity]:
        """What its channels seem to be."""
        return frozenset(channel.quantity for topic in self.topics for channel in topic.channels)

    def to_json(self) -> dict[str, Any]:
        """As JSON values; NaN where a number is not known."""
        return asdict(self) | {"path": str(self.path)}


@dataclass
class ChannelRange:
    """Running count and range of a channel."""

    count: int = 0
    nan: int = 0
    low: float = math.inf
    high: float = -math.inf
    whole: bool = True

    def add(self, values: RawChannel) -> None:
        if values.dtype.kind == "f":
            good = values[np.isfinite(values)]
            self.whole = self.whole and bool(np.array_equal(good, np.rint(good)))
        else:
            good = values
        self.count += good.size
        self.nan += values.size - good.size
        if good.size:
            self.low, self.high = min(self.low, float(good.min())), max(self.high, float(good.max()))

    def channel(self, name: str, rows: int) -> ChannelSurvey:
        low, high = (self.low, self.high) if self.count else (math.nan, math.nan)
        return ChannelSurvey(name, self.count, rows - self.count, low, high, self.whole)


def _first(entry: str | dict[str, Any]) -> str:
    """The first channel of an entry of a table of channels."""
    if isinstance(entry, str):
        return entry
    return str(entry["channels"][0]) if "channels" in entry else f"{entry['field']}[{entry['joints'][0]}]"
