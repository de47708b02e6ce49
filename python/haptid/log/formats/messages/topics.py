"""Topics of a log as channels: joints by name, stamps in whole nanoseconds, several topics on the rows of one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.late import dataclass
from haptid.errors import LogChannelError, LogTimeError
from haptid.log.formats.messages.batch import HEADER, Batch, Decoder
from haptid.log.formats.messages.container import Container, Topic
from haptid.log.formats.messages.containers import containers
from haptid.log.formats.messages.decoding import decoder_of
from haptid.log.formats.sniff import RawChannel, channel_list, corrupt, opened_file
from haptid.log.merging import Stream, at_stamps
from haptid.log.request import Request

_KIND = "message"
RECEIVE = "@receive"
# Messages of a topic that are decoded together, and their bytes.
BATCH, BATCH_BYTES = 4096, 2**22
# Messages of each topic that tell its channels.
TOLD = 200
# Names of the stamp of a message, the first that it has.
_STAMPS = ("header.stamp", "header.timestamp", "stamp", "timestamp", "time")
# A channel of a topic that shares this share of the rows of its rarest channel is read by rows, not merged by time.
_SHARED = 0.5


@dataclass
class TopicRows:
    """Wanted channels of the messages of one topic.

    Attributes:
        topic: one of its channels in the container.
        count: messages, n.
        receive: stamps, ns, (n,).
        values, present: of each channel, (n,).
        empty: arrays without elements, and in how many messages.
        stamps: channels that are stamps.
        other: messages that could not be decoded.
    """

    topic: Topic
    count: int = 0
    receive: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    values: dict[str, NDArray[Any]] = field(default_factory=dict)
    present: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    empty: dict[str, int] = field(default_factory=dict)
    stamps: set[str] = field(default_factory=set)
    other: int = 0

    def header(self) -> str | None:
        """The channel that is the stamp of the messages."""
        named = [name for name in _STAMPS if name in self.stamps]
        return next(iter([*named, *sorted(self.stamps)]), None)

    def add(self, batch: Batch, receive: NDArray[np.int64]) -> None:
        """Further messages: arrays are longer than `count` until `whole` cuts them."""
        begin, self.count = self.count, self.count + batch.count
        self.receive = _written(self.receive, begin, receive)
        for leaf, values in batch.values.items():
            self.values[leaf] = _written(self.values.get(leaf), begin, values)
            self.present[leaf] = _written(self.present.get(leaf), begin, batch.present[leaf])
        self.add_counts(batch)

    def add_counts(self, batch: Batch) -> None:
        """What further messages tell besides values: stamps, empty arrays, undecodable ones."""
        self.stamps |= batch.stamps
        self.other += batch.other
        for array, count in batch.empty.items():
            self.empty[array] = self.empty.get(array, 0) + count

    def whole(self) -> TopicRows:
        """The same with arrays of length `count`; the last messages may lack a channel."""
        for column in (self.values, self.present):
            for leaf, values in column.items():
                column[leaf] = _written(values, self.count, values[:0])
        return self.taken(slice(self.count))

    def taken(self, rows: slice | NDArray[np.intp]) -> TopicRows:
        """The same messages in another order, or the first of them."""
        values = {leaf: column[rows] for leaf, column in self.values.items()}
        present = {leaf: column[rows] for leaf, column in self.present.items()}
        return replace(self, receive=self.receive[rows], values=values, present=present)


def names(path: Path) -> list[str]:
    """Names of the channels, as the first messages of each topic have them."""
    found: dict[str, None] = {}
    with opened_file(path, _KIND):
        opened = containers(path)
        for topic, batch, _ in batches(opened, None, TOLD):
            for name in (HEADER, RECEIVE):
                if name == RECEIVE or batch.stamps:
                    found[topic.name + name] = None
            found.update(dict.fromkeys(f"{topic.name}.{name}" for name in batch.values))
        refuse_unreadable(opened)
    return list(found)


def refuse_unreadable(opened: Iterable[Container]) -> None:
    """Refuse a log of which nothing can be read."""
    for container in opened:
        if container.notes and not container.topics:
            what = container.notes[0].partition(":")[0]
            raise corrupt(container.path, "message", f"{what}, and nothing whole comes before")


def samples_in_messages(opened: Iterable[Container], rows: Mapping[str, int]) -> list[str]:
    """A sentence on each topic of which there are more rows than messages.

    Args:
        opened: the containers, read to their ends.
        rows: of each topic.
    """
    messages = Counter[str]()
    for container in opened:
        for channel, topic in container.topics.items():
            messages[topic.name] += container.counts.get(channel, 0)
    return [
        f"{messages[name]} messages of {name} hold {count} samples: these are taken as evenly spaced from message to "
        "message; a channel of times among them can be given as `time`"
        if messages[name] > 1
        else f"one message of {name} holds {count} samples, all with its stamp"
        for name, count in rows.items()
        if count > messages[name] > 0
    ]


def columns(path: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels that the log has, each (n,), on the rows of the topic of the first one.

    A row is a message that has all wanted channels of its topic; messages of other joints, and ones in which a value is
    empty or NaN, are left out. Channels of other topics are merged by time, see `haptid.log.request.Merge`.

    Raises:
        LogFileError: a topic cannot be decoded.
        LogChannelError: a channel is empty or NaN in every message; the topics have no common stamps.
    """
    with opened_file(path, _KIND):
        opened = containers(path)
        every = _topics(opened)
        asked: dict[str, dict[str, str]] = {}
        for name in dict.fromkeys(wanted):
            topic = max((t for t in every if name.startswith((f"{t}.", f"{t}@"))), key=len, default=None)
            if topic is not None:
                asked.setdefault(topic, {})[name] = name[len(topic) :].removeprefix(".")
        leaves = {topic: {*named.values(), HEADER} for topic, named in asked.items()}
        rows = _collected(batches(opened, leaves), request.notes)
        refuse_unreadable(opened)
    for container in opened:
        request.notes.extend(container.notes)
    if wanted[0].endswith((HEADER, RECEIVE)):
        request.notes.extend(samples_in_messages(opened, {name: own.count for name, own in rows.items()}))
    streams = [
        s for topic, named in asked.items() if topic in rows for s in _streams(path, rows[topic], named, request)
    ]
    return _merged(path, streams, wanted, request) if streams else {}


def batches(
    opened: Iterable[Container], leaves: Mapping[str, set[str]] | None, most: int | None = None
) -> Iterator[tuple[Topic, Batch, NDArray[np.int64]]]:
    """Decoded messages of the topics, some thousand at a time, with their receive stamps, ns.

    Args:
        opened: the containers, one after the other.
        leaves: wanted channels of the wanted topics; all where None.
        most: messages of each topic; all where None.

    Raises:
        LogFileError: a wanted topic cannot be decoded; where all are wanted, such a topic is left out and noted.
    """
    for container in opened:
        pending: dict[int, _Pending] = {}
        for channel, stamps, data in container.messages(None if leaves is None else set(leaves)):
            if channel not in pending:
                if channel not in container.topics:
                    continue
                topic = container.topics[channel]
                wanted = None if leaves is None else leaves[topic.name]
                pending[channel] = _Pending(topic, _decoder(container, channel, leaves is not None), wanted)
            before = container.counts.get(channel, 0)
            container.counts[channel] = before + len(data)
            own = pending[channel]
            if own.decoder is None or (most is not None and before >= most):
                continue
            left = None if most is None else most - before
            own.messages += data[:left]
            own.stamps += stamps[:left]
            own.size += sum(map(len, data))
            if len(own.messages) >= BATCH or own.size > BATCH_BYTES:
                yield own.flush()
        for own in pending.values():
            if own.messages:
                yield own.flush()


@dataclass
class _Pending:
    """Messages of a channel that are to be decoded together."""

    topic: Topic
    decoder: Decoder | None
    wanted: set[str] | None
    messages: list[bytes] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    size: int = 0
    last: int | None = None

    def flush(self) -> tuple[Topic, Batch, NDArray[np.int64]]:
        """What was collected, a row for each sample, and the stamps of the rows."""
        assert self.decoder is not None
        batch, rows = self.decoder.decode(self.messages, self.wanted).by_samples()
        stamps = np.array([min(stamp, 2**63 - 1) for stamp in self.stamps], np.int64)
        last, self.last = self.last, int(stamps[-1])
        self.messages, self.stamps, self.size = [], [], 0
        return self.topic, batch, stamps if (rows == 1).all() else _of_samples(stamps, rows, last)


def _of_samples(stamps: NDArray[np.int64], rows: NDArray[np.intp], last: int | None) -> NDArray[np.int64]:
    """Stamps of samples that came together: evenly from the message before to their own, of which the last one is.

    Args:
        stamps: of the messages, ns, (n,).
        rows: samples of each, (n,).
        last: stamp of the message before; None where these are the first.
    """
    apart = np.diff(stamps, prepend=stamps[0] if last is None else last)
    if last is None and stamps.size > 1:
        apart[0] = apart[1] * rows[0] // rows[1]
    behind = np.repeat(np.cumsum(rows), rows) - 1 - np.arange(int(rows.sum()))  # samples to the last one of a message
    earlier: NDArray[np.int64] = np.rint(behind * np.repeat(apart / rows, rows)).astype(np.int64)
    return np.repeat(stamps, rows) - earlier


def _decoder(container: Container, channel: int, wanted: bool) -> Decoder | None:
    topic = container.topics[channel]
    try:
        return decoder_of(topic)
    except (ValueError, RecursionError) as error:
        if not wanted:
            return None
        raise LogChannelError(
            f"{container.path}: topic {topic.name} cannot be decoded: {error}.",
            where=topic.name,
            found=topic.kind,
            advice="Record it as MCAP, where definitions travel along (`ros2 bag convert`), or choose another topic.",
        ) from error


def _topics(opened: Iterable[Container]) -> set[str]:
    """Names of the topics."""
    for container in opened:
        for _ in container.messages(()):
            pass
    return {topic.name for container in opened for topic in container.topics.values()}


def _collected(found: Iterable[tuple[Topic, Batch, NDArray[np.int64]]], notes: list[str]) -> dict[str, TopicRows]:
    """The messages of each topic, joined and in the order of their receive stamps."""
    growing: dict[str, TopicRows] = {}
    for topic, batch, stamps in found:
        growing.setdefault(topic.name, TopicRows(topic)).add(batch, stamps)
    rows = {name: grown.whole() for name, grown in growing.items()}
    for name, joined in rows.items():
        back = int(np.count_nonzero(np.diff(joined.receive) < 0))
        if back:
            order = np.argsort(joined.receive, kind="stable")
            rows[name] = joined.taken(order)
            notes.append(f"{back} messages of {name} are stored before earlier ones: sorted by receive stamps")
        if joined.other:
            notes.append(f"{joined.other} of {joined.count} messages of {name} are not of its type: left out")
    return rows


def _written(column: NDArray[Any] | None, begin: int, values: NDArray[Any]) -> NDArray[Any]:
    """Values from row `begin` on of a column, (>= begin + n,), which grows by a quarter where it is too short.

    Parts that are joined at the end would hold a long log twice.
    """
    end = begin + values.size
    kind = values.dtype if column is None else np.result_type(column, values)
    if column is None or column.size < end or column.dtype != kind:
        longer = np.zeros(max(end, 5 * begin // 4), kind)
        if column is not None:
            longer[:begin] = column[:begin]
        column = longer
    column[begin:end] = values
    return column


def _streams(path: Path, rows: TopicRows, named: Mapping[str, str], request: Request) -> list[Stream]:
    """The wanted channels of a topic, as one stream where they come in the same messages."""
    topic, count = rows.topic.name, rows.receive.size
    there: dict[str, NDArray[np.bool_]] = {}
    for full, leaf in named.items():
        if leaf in (RECEIVE, HEADER):
            continue
        if leaf not in rows.values:
            array = leaf.rpartition("[")[0]
            if rows.empty.get(array):
                raise _useless(path, full, f"{array} is empty in {rows.empty[array]} of {count} messages of {topic}")
            continue
        present = rows.present[leaf]
        if rows.values[leaf].dtype.kind == "f":
            nan = np.isnan(rows.values[leaf]) & present
            if nan.any() and np.array_equal(nan, present):
                raise _useless(path, full, f"it is NaN in all {int(nan.sum())} messages of {topic} that have it")
            if nan.any():
                present = present & ~nan
        there[full] = present
    groups = _groups(there)
    header = rows.header()
    streams = []
    for full_names, usable in groups or [([], np.ones(count, bool))]:
        keep = slice(None) if usable.all() else usable  # all of them without a copy
        stamps = rows.receive[keep], None if header is None else rows.values[header][keep]
        if header is not None and not rows.present[header][keep].all():
            stamps = stamps[0], None
        streams.append(
            Stream(topic, stamps[0], stamps[1], {full: rows.values[named[full]][keep] for full in full_names})
        )
        left = count - int(usable.sum())
        if left:
            what = ", ".join(f"{n} without {a}" for a, n in rows.empty.items() if any(a in f for f in full_names))
            request.notes.append(
                f"{left} of {count} messages of {topic} have not all of {channel_list(full_names, 8)}"
                + (f" ({what})" if what else " (other joints, empty or NaN)")
                + ": left out"
            )
    return streams


def _groups(there: Mapping[str, NDArray[np.bool_]]) -> list[tuple[list[str], NDArray[np.bool_]]]:
    """Channels that are read by common rows."""
    if not there:
        return []
    common = np.logical_and.reduce(list(there.values()))
    if common.sum() >= _SHARED * min(present.sum() for present in there.values()):
        return [(list(there), common)]
    groups: list[tuple[list[str], NDArray[np.bool_]]] = []
    for name, present in there.items():
        for members, rows in groups:
            if np.array_equal(rows, present):
                members.append(name)
                break
        else:
            groups.append(([name], present))
    return groups


def _useless(path: Path, name: str, what: str) -> LogChannelError:
    return LogChannelError(
        f"{path}: channel {name!r} holds nothing: {what}.",
        where=name,
        found=what,
        advice="The driver does not publish it. Record the topic that has it (currents, torques of the controller); "
        "`haptid channels` lists what a log has.",
    )


def _merged(path: Path, streams: list[Stream], wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """All streams on the rows of the first wanted channel's topic."""
    first = wanted[0]
    timed = first.endswith((HEADER, RECEIVE))
    topic = first.rpartition("@")[0] if timed else None
    base = next((s for s in streams if first in s.values or s.topic == topic), streams[0])
    if topic is not None:  # a channel of the topic that has the most rows, where they are not common
        base = max((s for s in streams if s.topic == topic), key=lambda s: s.receive.size, default=base)
    by_header = first.endswith(HEADER) or (not timed and base.header is not None and _all_headers(streams))
    if by_header:
        _check_headers(path, streams, first)
    stamps = base.header if by_header else base.receive
    assert stamps is not None
    out: dict[str, RawChannel] = dict(base.values)
    keep = np.ones(stamps.size, bool)
    for stream in streams:
        if stream is not base and stream.values:
            own = stream.header if by_header else stream.receive
            assert own is not None
            found, usable, sentence = at_stamps(request.merge, stamps, own, stream)
            out |= found
            keep &= usable
            request.notes.append(sentence)
    if not keep.all():
        out = {name: values[keep] for name, values in out.items()}
    if timed:
        out[first] = stamps[keep]
    return {name: out[name] for name in wanted if name in out}


def _all_headers(streams: list[Stream]) -> bool:
    """Whether all have stamps of their own, that were set."""
    return all(stream.header is not None and bool(stream.header.any()) for stream in streams)


def _check_headers(path: Path, streams: list[Stream], first: str) -> None:
    for stream in streams:
        if stream.header is None or (stream.header.size and not stream.header.any()):
            why = "have no stamp" if stream.header is None else "have the stamp 0"
            raise LogTimeError(
                f"{path}: messages of {stream.topic} {why} in their header, and {first!r} is wanted.",
                where=stream.topic,
                advice='Give `stamp = "receive"`: the times at which the recorder received the messages.',
            )
