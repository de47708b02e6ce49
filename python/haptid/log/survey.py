"""What a log contains: topics, rates, joints, empty fields, stamps, and a `[channels]` table to begin with.

Quantities and units are guessed from names, stated units, types and ranges. A guess is printed with its reason, for a
person to check; nothing is read by it.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from haptid._internal.toml_text import basic_string
from haptid.errors import LogFileError
from haptid.log.by_content import Content
from haptid.log.formats.messages.containers import Topic, containers
from haptid.log.formats.messages.topics import TopicRows, batches, refuse_unreadable
from haptid.log.formats.sniff import RawChannel, corrupt, opened_file
from haptid.log.read import LEROBOT, MESSAGES, Format, format_of
from haptid.log.registers import Register, register_of
from haptid.log.request import Request
from haptid.log.turns import turning_unit
from haptid.log.units import known_unit

Quantity = Literal["time", "position", "velocity", "torque", "other"]
# Channels of a topic or table that are looked at, and columns of a table that are read together.
_MOST, _TOGETHER = 400, 16
# Numbers of a table that is read as a whole, to recognise channels by how they move.
_NUMBERS = 20_000_000
# Words of channels' names, after the last point and without digits and units.
_WORDS: tuple[tuple[Quantity, frozenset[str]], ...] = (
    ("velocity", frozenset({"qd", "dq", "v", "vel", "velocity", "velocities", "speed", "omega", "qdot"})),
    ("torque", frozenset({"tau", "torque", "torques", "effort", "efforts", "eff", "u", "current", "currents", "moment",
                          "load", "force", "i", "amps", "iq"})),
    ("position", frozenset({"q", "pos", "position", "positions", "angle", "angles", "th", "theta", "joint", "enc",
                            "encoder", "phi"})),
)  # fmt: skip
# Settings, and differences from what is wanted.
_NEITHER = frozenset({"limit", "limits", "min", "max", "gain", "gains", "error", "err"})
# Names of joints and not only of their positions.
_JOINT = frozenset({"joint"})
# A command of nothing in particular stands for a torque.
_COMMAND = frozenset({"command", "commands", "commanded", "cmd"})
_CURRENT = frozenset({"current", "currents", "i", "amps", "iq"})
# Before one of these words "current" means the present value.
_PRESENT = re.compile(r"current(?=[_ ]?(?:joint|motor)?[_ ]?(?:angle|pos|theta|vel|speed|torque|effort|state))", re.I)
# Less likely to be measured: the wanted value, and not the motion.
_WANTED = frozenset({"target", "desired", "des", "reference", "ref", "command", "cmd", "goal", "action"})
# More likely than a command, where both are there.
_MEASURED = frozenset({"measured", "meas", "actual", "act", "present", "feedback", "fb"})
# Usual sampling rates, Hz, times powers of ten; one within this share is meant.
_RATES, _ROUNDED = (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), 0.02
_TIME = re.compile(
    r"(?:.*[._ ])?(?:t|time|times|timestamp|stamp|date|date[_ ]?time|secs?|seconds|elapsed)(?:_\w{1,3})?", re.IGNORECASE
)
_SPLIT = re.compile(r"[^a-z]+")
# Rates in names of positions: `D_Theta`, `theta_dot`; `q_d` is what is desired.
_RATE = re.compile(r"^d(?P<second>d)?_|(?P<second_dot>d)?dot(?=[^a-z]|$)", re.I)
_ELEMENT = re.compile(r"^(?P<array>.*)\[(?P<element>[^\[\]]*)\]$")
# Positions beyond this, rad, and counts beyond that, are not radians.
_RADIANS, _COUNTS = 4 * math.pi, 2000.0
# Counts of a turn of most hobby servos; their angle is zero in the middle.
_TWELVE_BITS = 4096
# Positions beyond this, m, of a prismatic joint are in mm.
_METRES = 5.0
# Below this, rad, a joint may have turned, as a pendulum or a wheel.
_FEW_TURNS = 20 * math.pi
_UNSTATED = "no unit is stated"
_MAY_TURN = "a joint that turns so far is in rad"
# Currents beyond this are in mA.
_AMPERES = 200.0
# Torques on fewer rows than this share of the positions' are commands that are held until the next.
_FEW = 0.2
# Torques that are whole numbers, and reach more than this, are in a driver's unit.
_WHOLE = 10.0


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
    def quantities(self) -> frozenset[Quantity]:
        """What its channels seem to be."""
        return frozenset(channel.quantity for topic in self.topics for channel in topic.channels)

    def to_json(self) -> str:
        """The same as JSON; NaN is null."""
        told = asdict(replace(self, path=Path(self.path.name)))
        return json.dumps(_plain(told | {"path": str(self.path)}), indent=2) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def survey(
    path: str | Path,
    joints: Sequence[tuple[str, ...]] = (),
    motors: Sequence[tuple[str, ...]] = (),
    command_unit: str = "",
    straight: Sequence[bool] = (),
) -> Survey:
    """Look through a log.

    Args:
        path: of the file or folder.
        joints: names of every joint that is wanted, in order: positions are chosen and ordered by them.
        motors: the same of torques; those of the joints where left out.
        command_unit: of the motors, for torques whose unit is not stated; empty where not known.
        straight: whether each joint is prismatic; none is where left out.

    Raises:
        LogFileError: it cannot be read.
    """
    path = Path(path)
    kind, notes = format_of(path), list[str]()
    topics = _messages(path, notes) if kind is MESSAGES else [_tabulated(path, kind, notes)]
    if command_unit:
        topics = [
            replace(topic, channels=tuple(_commanded(c, command_unit) for c in topic.channels)) for topic in topics
        ]
    return Survey(path, kind.name, tuple(notes), tuple(topics), _toml(topics, kind, joints, motors or joints, straight))


@dataclass
class _Range:
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


def _messages(path: Path, notes: list[str]) -> list[TopicSurvey]:
    ranges: dict[str, dict[str, _Range]] = {}
    rows: dict[str, TopicRows] = {}
    stamps: dict[str, list[NDArray[np.int64]]] = {}
    late: dict[str, list[NDArray[np.int64]]] = {}
    with opened_file(path, "message"):
        opened = containers(path)
        for topic, batch, receive in batches(opened, None):
            own = rows.setdefault(topic.name, TopicRows(topic, receive[:0]))
            own.stamps |= batch.stamps
            own.other += batch.other
            for array, count in batch.empty.items():
                own.empty[array] = own.empty.get(array, 0) + count
            stamps.setdefault(topic.name, []).append(receive)
            found = ranges.setdefault(topic.name, {})
            for name, values in batch.values.items():
                if name in found or len(found) < _MOST:
                    found.setdefault(name, _Range()).add(values[batch.present[name]])
            header = own.header()
            if header is not None and header in batch.values:
                there = batch.present[header] & (batch.values[header] != 0)  # 0 is a stamp that was never set
                late.setdefault(topic.name, []).append(receive[there] - batch.values[header][there])
        refuse_unreadable(opened)
        counted: dict[str, tuple[Topic, int]] = {}
        for container in opened:
            notes.extend(container.notes)
            for channel, topic in container.topics.items():
                before = counted.get(topic.name, (topic, 0))[1]
                counted[topic.name] = topic, before + container.counts.get(channel, 0)
    return [
        _topic(topic, count, rows.get(name), ranges.get(name, {}), stamps.get(name, []), late.get(name, []))
        for name, (topic, count) in sorted(counted.items())
    ]


def _topic(
    topic: Topic,
    count: int,
    rows: TopicRows | None,
    ranges: dict[str, _Range],
    stamps: Sequence[NDArray[np.int64]],
    late: Sequence[NDArray[np.int64]],
) -> TopicSurvey:
    if rows is None:
        why = "no messages" if not count else f"{topic.encoding} {topic.schema} is not decoded"
        return TopicSurvey(topic.name, topic.kind, count, why_not=why)
    received = np.sort(np.concatenate(stamps))
    span = float(received[-1] - received[0]) * 1e-9
    behind = np.concatenate([np.empty(0, np.int64), *late])
    header = (rows.header() or "") if behind.size else ""
    ros = topic.kind.endswith("/JointState")
    channels = [
        _guessed(found.channel(name, received.size), name, "rosjoint" if ros else "", "", _words(topic.name))
        for name, found in ranges.items()
        if name not in rows.stamps
    ]
    joints = dict.fromkeys(m["element"] for name in ranges if (m := _ELEMENT.match(name)))
    delay = float(np.median(behind)) * 1e-6 if behind.size else math.nan
    rate = (received.size - 1) / span if span > 0 else 0.0
    empty = dict(rows.empty)
    return TopicSurvey(
        topic.name, topic.kind, received.size, rate, tuple(joints), empty, tuple(channels), header, delay
    )


def _tabulated(path: Path, kind: Format, notes: list[str]) -> TopicSurvey:
    names, stated = kind.names(path), kind.units(path)
    if not names:
        raise LogFileError(
            f"{path}: nothing in it is an array of numbers.",
            where=path,
            limit=kind.name,
            advice="Cell arrays and objects such as Simulink's data sets are not read: save plain arrays, a struct of "
            "arrays or a timetable, one file for each run.",
        )
    channels: list[ChannelSurvey] = []
    count, rate = 0, 0.0
    for k in range(0, len(names[:_MOST]), _TOGETHER):
        request = Request()
        columns = _columns(path, kind, names[k : min(k + _TOGETHER, _MOST)], request)
        notes.extend(request.notes if k == 0 else (note for note in request.notes if note not in notes))
        for name, column in columns.items():
            count = max(count, column.size)
            found, register = _Range(), register_of(column)
            found.add(register.signed(column.astype(np.float64, copy=False)) if register else column)
            channel = replace(found.channel(name, column.size), register=register)
            if _TIME.fullmatch(_last(name.split(" [")[0].split(" (")[0])) or name.endswith("@time"):
                channel, own = _timed(channel, column, stated.get(name, ""))
                rate = rate or own
            else:
                source = "lerobot" if kind is LEROBOT else "rosjoint" if "joint_states" in name else ""
                channel = _guessed(channel, name, source, stated.get(name, ""))
            channels.append(channel)
    by_rates = 0.0
    if len(channels) * count < _NUMBERS and not {"time", "position"} <= {channel.quantity for channel in channels}:
        content = Content.of(_columns(path, kind, names[:_MOST], Request()))
        if not any(channel.quantity == "position" for channel in channels):
            channels, own = _recognised(channels, content, path, kind)
            rate = rate or own
        by_rates = 0.0 if rate or not content.dt else _usual(1.0 / content.dt)
    channels = _turning(channels, path, kind)
    named = (m["element"] for c in channels if (m := _ELEMENT.match(c.name)) and not _UNIT_LIKE.search(c.name))
    joints = dict.fromkeys(element for element in named if not element.isdecimal())
    if kind is LEROBOT:
        from haptid.log.formats import lerobot  # needs pyarrow

        rate = lerobot.describe(path).fps
    return TopicSurvey("", kind.name, count, rate, tuple(joints), {}, tuple(channels), by_rates_hz=by_rates)


def _recognised(
    channels: Sequence[ChannelSurvey], content: Content, path: Path, kind: Format
) -> tuple[list[ChannelSurvey], float]:
    """Channels without telling names by how they move, and the rate that their times have; 0 where there are none."""
    made, rate = [], 0.0
    rates = dict(zip(content.positions, content.rates, strict=False))
    for channel in channels:
        largest = max(abs(channel.low), abs(channel.high))
        if channel.name == content.time:
            channel, rate = _timed(channel, _columns(path, kind, [channel.name], Request())[channel.name], "")
        elif channel.name in content.positions:
            unit, reason = _unit("position", frozenset(), largest, channel, "")
            reason = f"their rates are in {rates.get(channel.name, 'no column')} and on; {reason}"
            channel = replace(channel, quantity="position", unit=unit, reason=reason)
        elif channel.name in content.rates:
            channel = replace(channel, quantity="velocity")
        elif channel.name in content.torques:
            unit, reason = _unit("torque", frozenset(), largest, channel, "")
            others = " or ".join(f"{group[0]} to {group[-1]}" for group in content.others)
            reason = f"the first that is left beside positions and rates{others and ', or '}{others}; {reason}"
            channel = replace(channel, quantity="torque", unit=unit, reason=reason)
        made.append(channel)
    return made, rate


def _turning(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Positions that may be several turns or some degrees in the unit that their torques tell."""
    torques = [c.name for c in channels if c.quantity == "torque" and c.usable][:_TOGETHER]
    doubtful = [c for c in channels if _MAY_TURN in c.reason]
    if not doubtful or kind is LEROBOT:
        return list(channels)
    loads = list(_columns(path, kind, torques, Request()).values()) if torques else []
    made = []
    for channel in channels:
        told = ""
        if channel in doubtful:
            told = turning_unit(_columns(path, kind, [channel.name], Request())[channel.name], loads)
        if told:
            largest = max(abs(channel.low), abs(channel.high))
            moves = "turns several times" if told == "rad" else "moves by degrees"
            reason = f"it reaches {largest:.4g}, and its torque or its swing is that of a joint that {moves}"
            channel = replace(channel, unit=told, reason=reason)
        made.append(channel)
    return made


def _usual(rate: float) -> float:
    """The usual sampling rate that is meant, Hz, or this one to three digits."""
    scale = 10.0 ** math.floor(math.log10(rate))
    nearest = min((x * k * scale for x in _RATES for k in (1.0, 10.0)), key=lambda x: abs(x - rate))
    return nearest if abs(nearest - rate) < _ROUNDED * rate else float(f"{rate:.3g}")


def _columns(path: Path, kind: Format, names: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """Columns of numbers; those that are none are noted."""
    try:
        return kind.columns(path, names, request)
    except LogFileError as error:
        if not isinstance(error.where, tuple) or len(names) == 1:
            raise
    found: dict[str, RawChannel] = {}
    for name in names:
        try:
            found |= kind.columns(path, [name])
        except LogFileError as error:
            request.notes.append(f"{name} is not a channel: {str(error).partition(': ')[2].partition('. ')[0]}")
    if not found:
        raise corrupt(path, kind.name, request.notes[-1])
    return found


def _timed(channel: ChannelSurvey, column: RawChannel, stated: str) -> tuple[ChannelSurvey, float]:
    """A channel that is called a time, with its unit, and the rate; no time where it does not grow."""
    own = column[~np.isnan(column)] if column.dtype.kind == "f" else column  # rows of other topics have none
    steps = np.diff(own[: 2**16].astype(np.float64) if own.dtype.kind == "f" else own[: 2**16])
    step = float(np.median(steps)) if steps.size else 0.0
    if not (steps.size and np.isfinite(steps).all() and step > 0 and (steps >= 0).mean() > 0.99):
        return channel, 0.0
    scales = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    known = known_unit(stated) if stated else None
    suffix = channel.name.rpartition("_")[2]
    if known is not None and known[0] == "time":
        unit, reason = known[1], f"the file states {stated}"
    elif suffix in scales and "_" in channel.name:
        unit, reason = suffix, "by its name"
    elif channel.name.endswith("@time"):
        unit, reason = "ns", "as stamps of a waveform are read"
    elif column.dtype.kind in "iu" and channel.low > 1e17:
        unit, reason = "ns", "whole numbers of that size are nanoseconds since 1970"
    else:
        fits = [u for u, scale in scales.items() if 2e-5 < step * scale < 0.2] or ["s"]
        unit, reason = fits[0], f"its usual step is {step:.4g}"
    return replace(channel, quantity="time", unit=unit, reason=reason), 1.0 / (step * scales[unit])


def _guessed(
    channel: ChannelSurvey, name: str, source: str, stated: str, topic: frozenset[str] = frozenset()
) -> ChannelSurvey:
    """What a channel is, by its name and that of its topic, its stated unit and its range."""
    base = (m["array"] if (m := _ELEMENT.match(name)) else name).split(" [")[0].split(" (")[0]
    base = _PRESENT.sub("", base)
    words = _words(base) or _words(name)
    quantity = _quantity(_words(_last(base)), words)
    if quantity == "position" and (rate := _RATE.search(base.rpartition(".")[2])):
        quantity = "other" if rate["second"] or rate["second_dot"] else "velocity"
    if words and words <= _COMMAND:
        quantity = "torque"
    if quantity == "other" and "state" in words and _ELEMENT.match(name):  # an array, and no state of a switch
        quantity = "position"
    if quantity == "other" and topic and base == "data":
        words, quantity = topic, next((q for q, known in _WORDS if topic & known), "other")
    elif quantity == "other" and (m := _ELEMENT.match(name)):
        words = _words(m["element"])
        quantity = next((q for q, known in _WORDS if words & known), "other")
    elif source == "lerobot" and (m := _ELEMENT.match(name)):  # joint.pos, joint.torque in one list
        inner = _words(m["element"].rpartition(".")[2])
        quantity = next((q for q, known in _WORDS if inner & known), quantity)
    known = known_unit(stated) if stated else None
    if known is not None and known[0] != "time":
        if quantity == "other" and known[0] in ("position", "torque"):
            quantity = known[0]
        return replace(channel, quantity=quantity, unit=known[1], reason=f"the file states {stated}")
    suffix = known_unit(base.rpartition("_")[2]) if "_" in base else None
    if suffix is not None and suffix[0] == quantity and base.rpartition("_")[2] not in ("m", "a", "v", "n"):
        return replace(channel, quantity=quantity, unit=suffix[1], reason="by its name")
    largest = max(abs(channel.low), abs(channel.high)) if channel.count else 0.0
    unit, reason = _unit(quantity, words | topic, largest, channel, source)
    return replace(channel, quantity=quantity, unit=unit, reason=reason)


def _unit(
    quantity: Quantity, words: frozenset[str], largest: float, channel: ChannelSurvey, source: str
) -> tuple[str, str]:
    if quantity == "position":
        if channel.whole and largest > _COUNTS:
            return "counts", f"whole numbers up to {largest:.4g}; a gain in rad per count is required"
        if largest > _RADIANS and not (source == "rosjoint" and channel.high - channel.low < _RADIANS):
            more = (
                "; LeRobot also writes -100..100 of a motor's range, which is no angle" if source == "lerobot" else ""
            )
            few = f"; {_MAY_TURN}" if largest < _FEW_TURNS and not more else ""
            whole = "; whole numbers: degrees, or counts" if channel.whole else ""
            return "deg", f"it reaches {largest:.4g}, more than two turns in rad{more}{whole or few}"
        more = "as ROS prescribes" if source == "rosjoint" else _UNSTATED
        return "rad", f"{more}, and its range of {largest:.3g} fits"
    if quantity == "torque":
        counted = channel.whole and largest > _WHOLE
        if words & _CURRENT and (largest > _AMPERES or not counted):
            own = "; whole numbers: mA, or the driver's own unit (a servo's 2.69 or 6.5 mA)" if counted else ""
            return ("mA" if largest > _AMPERES else "A"), f"called a current, up to {largest:.4g}{own}"
        if counted:
            return "counts", f"whole numbers up to {largest:.4g}, of a driver, a servo's load or a PWM; not N m"
        more = "as ROS prescribes; some drivers write A, mA or per cent" if source == "rosjoint" else _UNSTATED
        return "N m", f"{more}; up to {largest:.4g}"
    return "", ""


def _last(name: str) -> str:
    """The last part of a path, as of a field of a topic."""
    return re.split(r"[/.]", name)[-1]


def _quantity(last: frozenset[str], words: frozenset[str]) -> Quantity:
    """By the words of a name's last part, else by all of them; "joint" alone names a position, and no topic's field."""
    if last & _NEITHER:
        return "other"
    for known_words in (last - _JOINT, words - _JOINT, last & _JOINT):
        for quantity, known in _WORDS:
            if known_words & known:
                return quantity
    return "other"


def _commanded(channel: ChannelSurvey, unit: str) -> ChannelSurvey:
    """A torque of no stated unit in that of the device's motors."""
    if channel.quantity != "torque" or not channel.reason.startswith(_UNSTATED) or channel.unit == unit:
        return channel
    return replace(channel, unit=unit, reason=f"{_UNSTATED}; that of the device's motors")


def _words(name: str) -> frozenset[str]:
    return frozenset(_SPLIT.split(name.lower())) - {""}


@dataclass(frozen=True)
class _Family:
    """Channels of one quantity that belong together, in order."""

    topic: TopicSurvey
    array: str
    channels: tuple[ChannelSurvey, ...]

    @property
    def rank(self) -> tuple[bool, bool, bool, int, int]:
        """Usable ones first, then not those that are wanted, then measured ones, then many, then long ones."""
        words = _words(f"{self.topic.name} {self.array}")
        usable = sum(channel.usable for channel in self.channels)
        return (
            usable > 0,
            not words & _WANTED,
            bool(words & _MEASURED),
            usable,
            min(channel.count for channel in self.channels),
        )

    @property
    def prefix(self) -> str:
        """Name before the last point."""
        return self.array.rpartition(".")[0]

    def of(self, joints: Sequence[tuple[str, ...]]) -> _Family:
        """The channels of these joints, in their order; all channels where not every joint is found by a name."""
        if not joints:
            return self
        heads = [_joint_words(c.name, self.channels) for c in self.channels]
        found = [[c for c, head in zip(self.channels, heads, strict=True) if head in names] for names in joints]
        return replace(self, channels=tuple(c for (c,) in found)) if all(len(x) == 1 for x in found) else self

    def ordered(self, other: _Family) -> _Family:
        """The channels in the order of another family that has the same elements."""
        own = {m["element"]: c for c in self.channels if (m := _ELEMENT.match(c.name))}
        wanted = [m["element"] for c in other.channels if (m := _ELEMENT.match(c.name))]
        if len(own) == len(self.channels) and set(own) >= set(wanted) and len(wanted) == len(other.channels):
            return replace(self, channels=tuple(own[element] for element in wanted))
        return self


def _fit(position: _Family, torque: _Family) -> tuple[object, ...]:
    """Order of pairs: both usable, equally many, of one group or topic, then their own ranks."""
    same = position.topic is torque.topic and position.prefix == torque.prefix
    equal = len(position.channels) == len(torque.channels)
    return position.rank[0], torque.rank[0], equal, position.rank[1], torque.rank[1], same, position.rank, torque.rank


def _joint_words(name: str, family: Sequence[ChannelSurvey]) -> str:
    """The part of a channel's name that differs between the channels of its family: the joint's name."""
    names = [c.name.rpartition("[")[2].rstrip("]") if _ELEMENT.match(c.name) else c.name for c in family]
    own = name.rpartition("[")[2].rstrip("]") if _ELEMENT.match(name) else name
    words = re.split(r"([./ ])", own)
    alike = [re.split(r"([./ ])", one) for one in names]
    while len(words) > 1 and all(one[-1] == words[-1] for one in alike if one):
        words, alike = words[:-1], [one[:-1] for one in alike]
    while len(words) > 1 and all(one[0] == words[0] for one in alike if one):
        words, alike = words[1:], [one[1:] for one in alike]
    return "".join(words)


def _families(topics: Iterable[TopicSurvey], quantity: Quantity) -> list[_Family]:
    found: list[_Family] = []
    for topic in topics:
        arrays: dict[str, list[ChannelSurvey]] = {}
        for channel in topic.channels:
            if channel.quantity == quantity:
                element = _ELEMENT.match(channel.name)
                array = element["array"] if element and not _UNIT_LIKE.search(channel.name) else ""
                arrays.setdefault(array or _pattern(channel.name), []).append(channel)
        found.extend(_Family(topic, array, tuple(channels)) for array, channels in arrays.items())
    return sorted(found, key=lambda family: family.rank, reverse=True)


def _pattern(name: str) -> str:
    """A channel's name without what tells it from those of other joints: numbers, or the joint's name in a path."""
    parts = re.split(r"([/.])", name)
    numbered = any(re.search(r"\d", part) for part in parts[-3:])
    side = len(parts) > 2 and _words(parts[-3]) & (_WANTED | _MEASURED | {"motor", "joint"})
    if len(parts) > 2 and not numbered and not side and any(_words(parts[-1]) <= known for _, known in _WORDS):
        parts[-3] = "#"
    return re.sub(r"\d+", "#", "".join(parts))


_UNIT_LIKE = re.compile(r"\s\[[^\[\]]*\]$")


def _toml(
    topics: Sequence[TopicSurvey],
    kind: Format,
    joints: Sequence[tuple[str, ...]],
    motors: Sequence[tuple[str, ...]],
    straight: Sequence[bool],
) -> str:
    """A `[channels]` table of the most likely signals; empty where there are no positions or torques."""
    positions = [family.of(joints) for family in _families(topics, "position")]
    torques = [family.of(motors) for family in _families(topics, "torque")]
    if joints and any(len(family.channels) == len(joints) for family in positions):
        positions = [family for family in positions if len(family.channels) == len(joints)]
    if not positions:
        return ""
    pairs = [(p, t if joints else t.ordered(p)) for p in positions for t in torques]
    position, torque = max(pairs, key=lambda pair: _fit(*pair), default=(positions[0], None))
    lines = ["[channels]  # units and choices are guesses: check each of them"]
    lines.append(_time_line(position, torque, kind))
    if len(straight) == len(position.channels):
        position = replace(position, channels=tuple(map(_of_joint, position.channels, straight)))
        if torque is not None and len(torque.channels) == len(straight):
            torque = replace(torque, channels=tuple(map(_of_joint, torque.channels, straight)))
    lines.append(_signal_line("position", position))
    if torque is None:
        lines.append("# torque = ...  # no channel of torques, currents or commands was found")
    else:
        lines.append(_signal_line("torque", torque))
        lines += _instead(torques, torque)
        lines += _merge_line(position, torque, kind)
    return "\n".join(lines) + "\n"


def _of_joint(channel: ChannelSurvey, straight: bool) -> ChannelSurvey:
    """A channel of a prismatic joint whose unit was guessed as that of an angle or a moment."""
    if straight and channel.unit in ("rad", "deg"):
        largest = max(abs(channel.low), abs(channel.high))
        unit = "mm" if largest > _METRES else "m"
        return replace(channel, unit=unit, reason=f"its joint is prismatic, and it reaches {largest:.3g}")
    if straight and channel.unit == "N m":
        return replace(channel, unit="N", reason="its joint is prismatic")
    return channel


def _merge_line(position: _Family, torque: _Family, kind: Format) -> list[str]:
    """How torques come to the rows of the positions, where they have rows of their own."""
    if torque.topic is not position.topic:
        return ['merge = { onto = "position", method = "linear" }  # two topics, merged by time']
    samples, own = (min(c.count for c in family.channels) for family in (position, torque))
    if kind in (MESSAGES, LEROBOT) or own == 0 or max(samples, own) == position.topic.count:
        return []
    words = _words(torque.array)
    if own < _FEW * samples and position.topic.rate_hz:
        seconds = math.ceil(position.topic.count / position.topic.rate_hz)
        return [f'merge = {{ method = "hold", largest_gap = {seconds} }}  # guess: {own} commands, each held']
    method = "hold" if words & (_COMMAND | _WANTED | {"control"}) else "linear"
    return [f'merge = {{ method = "{method}" }}  # rows of several sources, merged by time']


def _instead(families: Sequence[_Family], chosen: _Family) -> list[str]:
    """Other channels that may be meant, as comments."""
    taken = {(chosen.topic.name, channel.name) for channel in chosen.channels}
    rest = [
        f
        for f in families
        if len(f.channels) == len(taken) and f.rank[0] and {(f.topic.name, c.name) for c in f.channels} != taken
    ]
    return [f"# also there: {', '.join(c.name for c in family.channels)}" for family in rest[:3]]


def _time_line(position: _Family, torque: _Family | None, kind: Format) -> str:
    if kind is MESSAGES:
        headers = all(f.topic.header for f in (position, torque) if f is not None)
        stamp = "header" if headers else "receive"
        why = "" if headers else "  # not every topic has stamps in its messages"
        return f"time = {{ topic = {basic_string(position.topic.name)}, stamp = {basic_string(stamp)} }}{why}"
    if kind is LEROBOT:
        return f'time = "time"  # frames at {position.topic.rate_hz:g} Hz, a pause between episodes'
    times = [channel for channel in position.topic.channels if channel.quantity == "time"]
    if not times:
        if own := position.topic.by_rates_hz:
            return (
                f"rate_hz = {own:g}  # guess: no channel of times was found; at this rate velocities fit the positions"
            )
        return "# rate_hz = ...  # no channel of times was found: write the rate at which the log was sampled"
    time = max(times, key=lambda channel: channel.name.rpartition(".")[0] == position.prefix)
    return f"time = {basic_string(time.name)}\ntime_unit = {basic_string(time.unit)}  # guess: {time.reason}"


def _signal_line(key: str, family: _Family) -> str:
    units = dict.fromkeys(channel.unit for channel in family.channels)
    reasons = dict.fromkeys(channel.reason for channel in family.channels)
    elements = [m["element"] for channel in family.channels if (m := _ELEMENT.match(channel.name))]
    if len(elements) == len(family.channels) and not family.array.endswith("#") and "#" not in family.array:
        topic = f"topic = {basic_string(family.topic.name)}, " if family.topic.name else ""
        joints = ", ".join(e if e.isdecimal() else basic_string(e) for e in elements)
        where = f"{topic}field = {basic_string(family.array)}, joints = [{joints}]"
    else:
        prefix = f"{family.topic.name}." if family.topic.name else ""
        where = "channels = [" + ", ".join(basic_string(prefix + channel.name) for channel in family.channels) + "]"
    reason = next(iter(reasons)) + ("; units differ between channels" if len(units) > 1 and not _mixed(units) else "")
    still = [channel.name for channel in family.channels if not channel.usable]
    constant = ""
    if still:
        reason += f"; without a change, is it connected?: {', '.join(still[:6])}"
        constant = ", constant_ok = true" if len(still) < len(family.channels) else ""
    unit = next(iter(units))
    mixed = _mixed(units)
    stated = (
        "[" + ", ".join(basic_string(channel.unit) for channel in family.channels) + "]"
        if mixed
        else basic_string(unit)
    )
    commanded = key == "torque" and (unit not in ("N m", "mN m", "N") or _words(family.array) <= _COMMAND)
    side = ', side = "motor"' if commanded else ""
    if key == "torque" and len(family.channels) > 1 and all(c.low >= 0 for c in family.channels):
        reason += "; never negative: is it a magnitude without a sign?"
    register = next((c.register for c in family.channels if c.register), Register())
    if register:
        reason += f"; their sign is written as of {register}"
    counted, more = "", f", {register}" if register else ""
    if key == "position" and unit == "counts" and all(c.low >= 0 and c.high < _TWELVE_BITS for c in family.channels):
        counted = f", gain = {2 * math.pi / _TWELVE_BITS:.9f}, offset = {-math.pi:.5f}"
        reason = f"whole numbers below {_TWELVE_BITS}, as of servos of 12 bits a turn with their zero at the middle"
    return f"{key} = {{ {where}, unit = {stated}{counted}{more}{side}{constant} }}  # guess: {reason}"


def _mixed(found: Iterable[str]) -> bool:
    """Whether units are of angles and of lengths, or of moments and of forces."""
    kinds = set(found)
    return any(kinds & one and kinds - one for one in ({"m", "mm", "um"}, {"N"}))
