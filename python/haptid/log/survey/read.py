"""What a log contains: topics, rates, joints, empty fields, stamps, and a `[channels]` table to begin with.

Quantities and units are guessed from names, stated units, types and ranges. A guess is printed with its reason, for a
person to check; nothing is read by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from haptid.log.by_content import Content
from haptid.log.file_format import MESSAGES, format_of
from haptid.log.formats.messages.container import Topic
from haptid.log.formats.messages.containers import containers
from haptid.log.formats.messages.topics import TopicRows, batches, refuse_unreadable, samples_in_messages
from haptid.log.formats.sniff import RawChannel, opened_file
from haptid.log.survey.channels import LOOKED_AT, ChannelRange, Survey, TopicSurvey
from haptid.log.survey.draft import channels_table
from haptid.log.survey.guesses import commanded, guessed, timed, with_voltages
from haptid.log.survey.names import element_of, words_of
from haptid.log.survey.recognised import recognised
from haptid.log.survey.table import surveyed_table

# Messages of a topic that are read as a whole, to recognise channels by how they move.
_MESSAGES = 20_000


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
    topics = _messages(path, notes) if kind is MESSAGES else [surveyed_table(path, kind, notes)]
    if command_unit:
        topics = [
            replace(topic, channels=tuple(commanded(c, command_unit) for c in topic.channels)) for topic in topics
        ]
    return Survey(
        path, kind.name, tuple(notes), tuple(topics), channels_table(topics, kind, joints, motors or joints, straight)
    )


def _messages(path: Path, notes: list[str]) -> list[TopicSurvey]:
    ranges: dict[str, dict[str, ChannelRange]] = {}
    rows: dict[str, TopicRows] = {}
    stamps: dict[str, list[NDArray[np.int64]]] = {}
    late: dict[str, list[NDArray[np.int64]]] = {}
    times: dict[str, dict[str, list[RawChannel]]] = {}
    with opened_file(path, "message"):
        opened = containers(path)
        for topic, batch, receive in batches(opened, None):
            own = rows.setdefault(topic.name, TopicRows(topic))
            own.add_counts(batch)
            stamps.setdefault(topic.name, []).append(receive)
            found = ranges.setdefault(topic.name, {})
            for name, values in batch.values.items():
                if name in found or len(found) < LOOKED_AT:
                    found.setdefault(name, ChannelRange()).add(values[batch.present[name]])
                if "time" in words_of(name) and name not in batch.stamps and batch.present[name].all():
                    times.setdefault(topic.name, {}).setdefault(name, []).append(values)
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
    topics = [_with_times_of_samples(topic, times.get(topic.name, {}), stamps.get(topic.name, [])) for topic in topics]
    known = any(channel.quantity == "position" for topic in topics for channel in topic.channels)
    return topics if known else _by_movement(path, topics)


def _with_times_of_samples(
    topic: TopicSurvey, times: dict[str, list[RawChannel]], stamps: Sequence[NDArray[np.int64]]
) -> TopicSurvey:
    """A topic with the times of its samples, as `time_from_start` of one message's points, which share its stamp."""
    if topic.count < 2 or not stamps or (np.diff(np.concatenate(stamps)) > 0).any():
        return topic
    for channel in topic.channels:
        column = np.concatenate(times.get(channel.name, [np.empty(0)]))
        if column.size == topic.count and (np.diff(column) > 0).all():
            known = "ns" if column.dtype.kind == "i" else ""
            made, rate = timed(replace(channel, quantity="time"), column, known)
            channels = tuple(made if one is channel else one for one in topic.channels)
            return replace(topic, channels=channels, rate_hz=rate)
    return topic


def _by_movement(path: Path, topics: Sequence[TopicSurvey]) -> list[TopicSurvey]:
    """Topics of arrays without names, as a `Float64MultiArray`, with channels that are recognised by how they move."""
    unnamed = [topic.name for topic in topics if {channel.quantity for channel in topic.channels} == {"other"}]
    parts: dict[str, dict[str, list[RawChannel]]] = {name: {} for name in unnamed}
    with opened_file(path, "message"):
        for topic, batch, _ in batches(containers(path), None, most=_MESSAGES) if unnamed else ():
            own = parts.get(topic.name, {})
            for name, values in batch.values.items():
                if batch.present[name].all() and (name in own or len(own) < LOOKED_AT):
                    own.setdefault(name, []).append(values)
    columns = {topic: {name: np.concatenate(values) for name, values in own.items()} for topic, own in parts.items()}
    return [
        replace(one, channels=tuple(recognised(one.channels, Content.of(columns[one.name]))))
        if one.name in columns
        else one
        for one in topics
    ]


def _topic(
    topic: Topic,
    count: int,
    rows: TopicRows | None,
    ranges: dict[str, ChannelRange],
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
    empty, told = dict(rows.empty), tuple(with_voltages(channels))
    return TopicSurvey(topic.name, topic.kind, received.size, rate, tuple(joints), empty, told, header, delay)
