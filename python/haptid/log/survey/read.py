"""What a log contains: topics, rates, joints, empty fields, stamps, and a `[channels]` table to begin with.

Quantities and units are guessed from names, stated units, types and ranges. A guess is printed with its reason, for a
person to check; nothing is read by it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid.errors import LogFileError
from haptid.log.by_content import Content, period_of
from haptid.log.checks import wrap_period
from haptid.log.file_format import LEROBOT, MESSAGES, Format, format_of
from haptid.log.formats.messages.container import Topic
from haptid.log.formats.messages.containers import containers
from haptid.log.formats.messages.topics import TopicRows, batches, refuse_unreadable, samples_in_messages
from haptid.log.formats.sniff import RawChannel, opened_file
from haptid.log.log import Signal
from haptid.log.merging import SPARSE
from haptid.log.registers import register_of
from haptid.log.request import Request
from haptid.log.stamp_parts import fraction_unit, sum_of
from haptid.log.survey.channels import A_PART, ChannelSurvey, Quantity, Survey, TopicSurvey
from haptid.log.survey.draft import channels_table
from haptid.log.survey.families import WANTED_WORDS
from haptid.log.survey.guesses import MAY_TURN, STATED, commanded, guessed, lettered, timed, unit_of, usual_step
from haptid.log.survey.names import COMMAND_WORDS, NESTED, element_of, is_straight, is_time, words_of
from haptid.log.turns import turning_unit
from haptid.log.units import scale

# Channels of a topic or table that are looked at, and columns of a table that are read together.
_MOST, _TOGETHER = 400, 16
# Numbers of a table that is read as a whole, to recognise channels by how they move.
_NUMBERS = 20_000_000
# Messages of a topic that are, for the same.
_MESSAGES = 20_000
# A fraction of seconds reaches this, in any unit.
_FRACTION = 500.0
# Usual sampling rates, Hz, times powers of ten; one within this share is meant.
_RATES, _ROUNDED = (1.0, 1.2, 1.25, 1.5, 2.0, 2.4, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), 0.02
# Share of its deviation by which a channel that was taken again differs at most.
_AGAIN = 0.02


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
            replace(topic, channels=tuple(commanded(c, command_unit) for c in topic.channels)) for topic in topics
        ]
    return Survey(
        path, kind.name, tuple(notes), tuple(topics), channels_table(topics, kind, joints, motors or joints, straight)
    )


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
            own = rows.setdefault(topic.name, TopicRows(topic))
            own.add_counts(batch)
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
        notes.extend(samples_in_messages(opened, {name: sum(map(len, received)) for name, received in stamps.items()}))
        counted: dict[str, tuple[Topic, int]] = {}
        for container in opened:
            notes.extend(container.notes)
            for channel, topic in container.topics.items():
                before = counted.get(topic.name, (topic, 0))[1]
                counted[topic.name] = topic, before + container.counts.get(channel, 0)
    topics = [
        _topic(topic, count, rows.get(name), ranges.get(name, {}), stamps.get(name, []), late.get(name, []))
        for name, (topic, count) in sorted(counted.items())
    ]
    known = any(channel.quantity == "position" for topic in topics for channel in topic.channels)
    return topics if known else _by_movement(path, topics)


def _by_movement(path: Path, topics: Sequence[TopicSurvey]) -> list[TopicSurvey]:
    """Topics of arrays without names, as a `Float64MultiArray`, with channels that are recognised by how they move."""
    unnamed = [topic.name for topic in topics if {channel.quantity for channel in topic.channels} == {"other"}]
    parts: dict[str, dict[str, list[RawChannel]]] = {name: {} for name in unnamed}
    with opened_file(path, "message"):
        for topic, batch, _ in batches(containers(path), None, most=_MESSAGES) if unnamed else ():
            own = parts.get(topic.name, {})
            for name, values in batch.values.items():
                if batch.present[name].all() and (name in own or len(own) < _MOST):
                    own.setdefault(name, []).append(values)
    columns = {topic: {name: np.concatenate(values) for name, values in own.items()} for topic, own in parts.items()}
    return [
        replace(one, channels=tuple(_recognised(one.channels, Content.of(columns[one.name]))))
        if one.name in columns
        else one
        for one in topics
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
        guessed(found.channel(name, received.size), name, "rosjoint" if ros else "", "", words_of(topic.name))
        for name, found in ranges.items()
        if name not in rows.stamps
    ]
    joints = dict.fromkeys(m["element"] for name in ranges if (m := element_of(name)))
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
            advice="Save the samples as arrays, one row for each time: times, positions and torques.",
        )
    channels: list[ChannelSurvey] = []
    count, rate_of = 0, dict[str, float]()
    for k in range(0, len(names[:_MOST]), _TOGETHER):
        request = Request()
        columns = _columns(path, kind, names[k : min(k + _TOGETHER, _MOST)], request)
        notes.extend(request.notes if k == 0 else (note for note in request.notes if note not in notes))
        for name, column in columns.items():
            count = max(count, column.size)
            found, register = _Range(), register_of(column)
            found.add(register.signed(column.astype(np.float64, copy=False)) if register else column)
            channel = replace(found.channel(name, column.size), register=register)
            if is_time(name):
                channel, own = timed(channel, column, stated.get(name, ""))
                rate_of[name] = own
            if channel.quantity == "other":  # `ticks` of an encoder do not grow as those of a clock
                source = "lerobot" if kind is LEROBOT else "rosjoint" if "joint_states" in name else ""
                channel = guessed(channel, name, source, stated.get(name, ""))
            channels.append(channel)
    channels = [replace(c, quantity="other") if _is_part(c, count) else c for c in channels]
    rate = next((rate_of[c.name] for c in channels if c.quantity == "time" and rate_of.get(c.name)), 0.0)
    channels, own = _with_stamps_in_parts(channels, path, kind)
    rate = own or rate
    by_rates = 0.0
    if len(channels) * count < _NUMBERS and not {"time", "position"} <= {channel.quantity for channel in channels}:
        content = _content(channels, path, kind)
        channels, own = _with_times(channels, content.time, path, kind)
        rate = rate or own
        if not any(channel.quantity == "position" for channel in channels):
            channels = _recognised(channels, content)
        period = 0.0 if rate else _named_period(channels, path, kind) or content.dt
        by_rates = _usual(1.0 / period) if period > 0 else 0.0
    channels = _without_repeats(lettered(channels), path, kind)
    channels = _turning(_without_times(channels, path, kind), path, kind)
    if kind is not LEROBOT and sum(c.quantity == "position" for c in channels) * count < _NUMBERS:
        channels = [_wrapped(c, path, kind) if c.quantity == "position" and c.usable else c for c in channels]
    named = (m["element"] for c in channels if (m := element_of(c.name)))
    joints = dict.fromkeys(element for element in named if not element.isdecimal())
    if kind is LEROBOT:
        from haptid.log.formats import lerobot  # needs pyarrow

        rate = lerobot.describe(path).fps
    else:
        rate = _rate_of_positions(channels, count, rate, path, kind, notes)
    return TopicSurvey("", kind.name, count, rate, tuple(joints), {}, tuple(channels), by_rates_hz=by_rates)


def _rate_of_positions(
    channels: Sequence[ChannelSurvey], rows: int, rate: float, path: Path, kind: Format, notes: list[str]
) -> float:
    """Rate of the rows that have positions, where others are those of other sources, Hz; else that of all rows."""
    positions = [c for c in channels if c.quantity == "position" and c.usable]
    first = max(positions, key=lambda c: c.count, default=None)
    times = [c for c in channels if c.quantity == "time"]
    time = max(
        times, key=lambda c: first is not None and c.count + c.missing == first.count + first.missing, default=None
    )
    if time is None or not any(c.usable and c.missing >= SPARSE * rows for c in channels):
        return rate
    if first is None:
        notes.append("the rows are those of several sources, and none of them is known to have positions: no rate")
        return 0.0
    columns = _columns(path, kind, [time.name, first.name], Request())
    there = ~np.isnan(columns[first.name].astype(np.float64))
    usual, uneven = usual_step(np.diff(columns[time.name][there]))
    own = 1.0 / (usual * scale(time.unit, "time")[1]) if usual else 0.0
    said = f"{own:.6g} Hz is the rate of" if own else "no rate is stated:"
    notes.append(
        f"the rows are those of several sources: {said} the {first.count} rows with {first.name}"
        + f"; {uneven}" * bool(uneven)
    )
    return own


def _named_period(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> float:
    """Sampling period by the velocities of as many positions, all known by names, s; else 0.

    The first pair with the most rows: others may be of every hundredth row.
    """
    found: dict[str, dict[str, list[str]]] = {"position": {}, "velocity": {}}
    rows = {channel.name: channel.rows for channel in channels}
    for channel in channels:
        if channel.quantity in found:
            match = element_of(channel.name)
            array = match["array"] if match else re.sub(r"\d+", "#", channel.name)
            found[channel.quantity].setdefault(array, []).append(channel.name)
    pairs = product(found["position"].values(), found["velocity"].values())
    for positions, rates in sorted(pairs, key=lambda pair: rows[pair[0][0]], reverse=True):
        if len(positions) == len(rates) <= _TOGETHER:
            columns = _columns(path, kind, [*positions, *rates], Request())
            sizes = {column.size for column in columns.values()}
            if len(columns) == 2 * len(rates) and len(sizes) == 1:
                period = period_of([columns[name] for name in positions], [columns[name] for name in rates])
                if period > 0:
                    return period
    return 0.0


def _with_stamps_in_parts(channels: list[ChannelSurvey], path: Path, kind: Format) -> tuple[list[ChannelSurvey], float]:
    """Channels with the times that whole seconds and the fraction beside them make, and their rate; else 0."""
    for k, (whole, part) in enumerate(pairwise(channels)):
        if not (whole.whole and part.whole and whole.usable and part.low >= 0 and part.high >= _FRACTION):
            continue
        columns = _columns(path, kind, [whole.name, part.name], Request())
        unit = fraction_unit(*columns.values()) if len(columns) == 2 else ""
        if unit:
            name = sum_of(whole.name, part.name, unit)
            times = _columns(path, kind, [name], Request())[name]
            made, rate = timed(_channel(name, times), times, "ns")
            made = replace(made, reason=made.reason.replace(f"{STATED[0]} ns", "whole seconds and their fraction"))
            others = [
                replace(c, quantity="other", unit="", reason="") if c in (whole, part) or c.quantity == "time" else c
                for c in channels
            ]
            return [*others[:k], made, *others[k:]], rate
    return channels, 0.0


def _without_times(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Channels of which none is the times once more, as where every array has them beside its samples."""
    times = [channel for channel in channels if channel.quantity == "time"]
    spans = {(channel.low, channel.high, channel.count): channel.name for channel in times}
    made = []
    for channel in channels:
        time = spans.get((channel.low, channel.high, channel.count))
        if time is not None and channel not in times:
            own, same = _columns(path, kind, [channel.name, time], Request()).values()
            if np.array_equal(own, same):
                channel = replace(channel, quantity="other", unit="", reason=f"the same as {time}")
        made.append(channel)
    return made


def _is_part(channel: ChannelSurvey, rows: int) -> bool:
    """Whether it is called a time and is too short for that: `T12` of a transformation."""
    return channel.quantity == "time" and channel.rows <= A_PART * rows


def _channel(name: str, values: RawChannel) -> ChannelSurvey:
    found = _Range()
    found.add(values)
    return found.channel(name, values.size)


def _with_times(
    channels: Sequence[ChannelSurvey], name: str, path: Path, kind: Format
) -> tuple[list[ChannelSurvey], float]:
    """Channels with that of times, known by its even growth where no name says it, and its rate; else 0."""
    if not name or any(channel.quantity == "time" for channel in channels):
        return list(channels), 0.0
    k = next(k for k, channel in enumerate(channels) if channel.name == name)
    channel, rate = timed(channels[k], _columns(path, kind, [name], Request())[name], "")
    return [*channels[:k], channel, *channels[k + 1 :]], rate


def _content(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> Content:
    """What the columns contain; times alone where a rate is called a torque, which looks so where damping is most."""
    content = Content.of(_columns(path, kind, [channel.name for channel in channels], Request()))
    torques = {channel.name for channel in channels if channel.quantity == "torque"}
    return Content(content.time) if torques & set(content.rates) else content


def _recognised(channels: Sequence[ChannelSurvey], content: Content) -> list[ChannelSurvey]:
    """Channels without telling names by how they move."""
    made = []
    rates = dict(zip(content.positions, content.rates, strict=False))
    groups = [group for group in (content.torques, *content.others) if group]
    groups.sort(
        key=lambda group: bool(words_of(" ".join(group)) & (WANTED_WORDS | COMMAND_WORDS))
    )  # measured ones first
    torques, *left = groups or [()]
    for channel in channels:
        largest, words = max(abs(channel.low), abs(channel.high)), words_of(channel.name)
        if channel.name in content.positions:
            alike = words == words_of(rates.get(channel.name, ""))  # a state, `x1` with the rate `x3`, is no cart's `x`
            straight = is_straight(words) and not alike
            unit, reason = unit_of("position", words if straight else frozenset(), largest, channel, "")
            reason = f"their rates are in {rates.get(channel.name, 'no column')} and on; {reason}"
            channel = replace(channel, quantity="position", unit=unit, reason=reason)
        elif channel.name in content.rates:
            channel = replace(channel, quantity="velocity")
        elif channel.name in torques:
            current = frozenset({"current"} if channel.name.rstrip("_0123456789") in ("i", "I") else ())
            unit, reason = unit_of("torque", current, largest, channel, "")
            others = " or ".join(" to ".join(dict.fromkeys((group[0], group[-1]))) for group in left)
            reason = f"the first that is left beside positions and rates{others and ', or '}{others}; {reason}"
            channel = replace(channel, quantity="torque", unit=unit, reason=reason)
        made.append(channel)
    return made


def _without_repeats(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Channels `q[joint][sample]` that were taken again at each pose are of no quantity, but the first.

    So does the gravity compensation of the dVRK, and so are runs that were repeated. Torques are as the positions of
    their shape.
    """
    nested: dict[tuple[Quantity, str], dict[str, list[ChannelSurvey]]] = {}
    for channel in channels:
        if match := NESTED.fullmatch(channel.name):
            own = nested.setdefault((channel.quantity, match["array"]), {})
            own.setdefault(match["outer"], []).append(channel)
    groups = {key: list(found.values()) for key, found in nested.items() if len({len(x) for x in found.values()}) == 1}
    shapes = {
        (len(found), len(found[0]))
        for (quantity, _), found in groups.items()
        if quantity == "position" and len(found) > 1 and len(found[0]) > 2 and _are_repeats(found, path, kind)
    }
    again = {
        channel.name: own[0].name
        for found in groups.values()
        if (len(found), len(found[0])) in shapes
        for own in found
        for channel in own[1:]
    }
    return [
        replace(c, quantity="other", unit="", reason=f"taken again, as {again[c.name]}") if c.name in again else c
        for c in channels
    ]


def _are_repeats(groups: Sequence[Sequence[ChannelSurvey]], path: Path, kind: Format) -> bool:
    """Whether the samples of the channels of that array which moves farthest are the same."""
    farthest = max(groups, key=lambda own: own[0].high - own[0].low if own[0].usable else 0.0)
    names = [channel.name for channel in farthest[:_TOGETHER] if channel.count]
    if not farthest[0].usable or len(names) < 2:
        return False
    columns = np.stack([column.astype(np.float64) for column in _columns(path, kind, names, Request()).values()])
    known = columns[:, np.isfinite(columns).all(axis=0)]
    apart = np.linalg.norm(known[1:] - known[:1], axis=1)
    return bool((apart < _AGAIN * np.linalg.norm(known[0] - known[0].mean())).all()) if known.size else False


def _turning(channels: Sequence[ChannelSurvey], path: Path, kind: Format) -> list[ChannelSurvey]:
    """Positions that may be several turns or some degrees in the unit that their torques tell."""
    torques = [c.name for c in channels if c.quantity == "torque" and c.usable][:_TOGETHER]
    doubtful = [c for c in channels if MAY_TURN in c.reason]
    if not doubtful or kind is LEROBOT:
        return list(channels)
    loads = list(_columns(path, kind, torques, Request()).values()) if torques else []
    made = []
    for channel in channels:
        meant = ""
        if channel in doubtful:
            meant = turning_unit(_columns(path, kind, [channel.name], Request())[channel.name], loads)
        if meant:
            largest = max(abs(channel.low), abs(channel.high))
            moves = "turns several times" if meant == "rad" else "moves by degrees"
            reason = f"it reaches {largest:.4g}, and its torque or its swing is that of a joint that {moves}"
            channel = replace(channel, unit=meant, reason=reason)
        made.append(channel)
    return made


def _wrapped(channel: ChannelSurvey, path: Path, kind: Format) -> ChannelSurvey:
    """The channel with the period by which it jumps."""
    column = _columns(path, kind, [channel.name], Request())[channel.name].astype(np.float64)
    column = column[np.isfinite(column)]
    if column.size < 2:
        return channel
    largest = float(np.abs(np.diff(column)).max())
    found = wrap_period(column, Signal((channel.name,), channel.unit or "rad"), largest)
    return replace(channel, period=found[0]) if found else channel


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
        raise LogFileError(
            f"{path}: none of its columns is one of numbers ({request.notes[-1]}).",
            where=path,
            limit=kind.name,
            advice="Export a table: one line of names, then rows of numbers, one for each time.",
        )
    return found
