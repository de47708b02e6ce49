"""Messages to channels: ROS by the layout of their bytes, protobuf and JSON as trees of values.

A channel's name in a message is its path, `position[elbow]`: elements of an array are named after the texts of a
sibling array of the same length (`name` of a JointState), structs in an array after their own `name`, others by numbers
from 1. So a joint is found by its name in every message, wherever it stands.

Messages of ROS with the same lengths, counts and names have one layout. They are joined and viewed as one matrix of
bytes, of which a channel is a strided column: decoding takes no time per message.
"""

from __future__ import annotations

import json
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid.errors import MissingDependencyError
from haptid.log.formats.messages.containers import Topic
from haptid.log.formats.messages.definitions import PRIMITIVES, Types, parse
from haptid.log.formats.sniff import MOST_CHANNELS

# Values of one message that are named; elements of an array that are not numbers.
MOST_LEAVES, MOST_ELEMENTS = 4096, 4096
# Layouts that are kept for messages of one length.
MOST_LAYOUTS = 64
# NumPy type of stamps: whole nanoseconds.
STAMP = "stamp"
# Wanted of a topic: its stamps, whatever their name.
HEADER = "@header"


class Stamp(int):
    """A stamp, in ns."""


@dataclass
class Batch:
    """Channels of consecutive messages of one topic.

    Attributes:
        count: messages.
        values: of each channel, (count,); int64 for stamps and 64-bit integers, otherwise float64.
        present: where a message has the channel, (count,).
        empty: arrays without elements, and in how many messages.
        stamps: channels that are stamps, in ns.
        other: messages that could not be decoded.
    """

    count: int
    values: dict[str, NDArray[Any]] = field(default_factory=dict)
    present: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    empty: dict[str, int] = field(default_factory=dict)
    stamps: set[str] = field(default_factory=set)
    other: int = 0

    def put(self, name: str, rows: Any, values: NDArray[Any]) -> None:
        """Values of a channel in some of the messages."""
        exact = values.dtype.kind in "iu" and values.dtype.itemsize == 8
        kept = values.astype(np.int64 if exact else np.float64)
        if name not in self.values:
            self.values[name] = np.zeros(self.count, kept.dtype)
            self.present[name] = np.zeros(self.count, bool)
        elif self.values[name].dtype != kept.dtype:
            self.values[name] = self.values[name].astype(np.float64)
        self.values[name][rows] = kept
        self.present[name][rows] = True


class Decoder(ABC):
    """Decodes the messages of one channel of a container."""

    @abstractmethod
    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        """The wanted channels of some messages, all where None."""


def decoder_of(topic: Topic) -> Decoder:
    """The decoder of a topic.

    Raises:
        ValueError: its encoding is not known, or its definition is missing or wrong.
    """
    if topic.encoding in ("cdr", "ros1"):
        if topic.schema not in ("ros2msg", "ros1msg", ""):
            raise ValueError(f"its type {topic.kind} is defined as {topic.schema!r}; ros2msg and ros1msg are read")
        if not topic.definition:
            raise ValueError(f"the definition of its type {topic.kind} does not travel along and is not a common one")
        return RosDecoder(topic.definition.decode(errors="replace"), topic.kind, topic.encoding == "cdr")
    if topic.encoding == "json":
        return JsonDecoder()
    if topic.encoding == "protobuf":
        return ProtobufDecoder(topic)
    raise ValueError(f"its encoding {topic.encoding!r} is not read; cdr, ros1, protobuf and json are")


@dataclass(frozen=True)
class Layout:
    """Where the channels of a message are in its bytes.

    Attributes:
        fixed: bytes that define the layout: counts, lengths of texts, and names, as indices.
        content: these bytes.
        places: first byte and type of each channel.
        empty: arrays without elements.
    """

    fixed: NDArray[np.intp]
    content: NDArray[np.uint8]
    places: Mapping[str, tuple[int, str]]
    empty: tuple[str, ...]


class RosDecoder(Decoder):
    """ROS messages: CDR of ROS 2 (XCDR version 1), or the packed form of ROS 1."""

    def __init__(self, definition: str, kind: str, cdr: bool) -> None:
        self.types: Types = parse(definition, kind)
        self.cdr = cdr
        self.layouts: dict[int, list[Layout]] = {}

    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        batch = Batch(len(messages))
        sizes = np.fromiter(map(len, messages), np.intp, len(messages))
        for size in np.unique(sizes):
            rows = np.flatnonzero(sizes == size)
            data = b"".join(messages) if rows.size == sizes.size else b"".join([messages[int(k)] for k in rows])
            self._decode(np.frombuffer(data, np.uint8).reshape(rows.size, size), rows, batch, wanted)
        return batch

    def _decode(self, data: NDArray[np.uint8], rows: NDArray[np.intp], batch: Batch, wanted: set[str] | None) -> None:
        """Messages of one length, (messages, bytes)."""
        known = self.layouts.setdefault(data.shape[1], [])
        for layout in tuple(known):
            fits = (data[:, layout.fixed] == layout.content).all(axis=1)
            if not fits.any():
                continue
            if fits.all():
                self._take(layout, data, rows, batch, wanted)
                return
            self._take(layout, data[fits], rows[fits], batch, wanted)
            data, rows = data[~fits], rows[~fits]
        for _ in range(MOST_LAYOUTS):
            if not rows.size:
                return
            fits = np.zeros(rows.size, bool)
            fits[0] = True
            new = self._walked(data[0], batch)
            if new is not None:
                known.insert(0, new)
                del known[MOST_LAYOUTS:]
                fits = (data[:, new.fixed] == new.content).all(axis=1)
                self._take(new, data[fits], rows[fits], batch, wanted)
            data, rows = data[~fits], rows[~fits]
        for k in range(rows.size):  # nearly every message has a layout of its own: nothing is gained by comparing
            new = self._walked(data[k], batch)
            if new is not None:
                self._take(new, data[k : k + 1], rows[k : k + 1], batch, wanted)

    def _walked(self, message: NDArray[np.uint8], batch: Batch) -> Layout | None:
        """The layout of a message; None where it is not of the type."""
        try:
            return Walk(self.types, message.tobytes(), self.cdr).layout()
        except (ValueError, struct.error, IndexError, KeyError):
            batch.other += 1
            return None

    @staticmethod
    def _take(
        layout: Layout, data: NDArray[np.uint8], rows: NDArray[np.intp], batch: Batch, wanted: set[str] | None
    ) -> None:
        whole = slice(None) if rows.size == batch.count else rows
        for name in layout.empty:
            batch.empty[name] = batch.empty.get(name, 0) + rows.size
        for name, (at, kind) in layout.places.items():
            stamp = kind.endswith(STAMP)
            if wanted is None or name in wanted or (stamp and HEADER in wanted):
                batch.put(name, whole, _column(data, at, kind))
                batch.stamps |= {name} if stamp else set()


def _column(data: NDArray[np.uint8], at: int, kind: str) -> NDArray[Any]:
    """A channel of messages of one layout."""
    if kind.endswith(STAMP):
        order = kind[0]
        seconds, rest = _column(data, at, f"{order}i4"), _column(data, at + 4, f"{order}u4")
        return np.asarray(seconds.astype(np.int64) * 10**9 + rest)
    whole = np.ascontiguousarray(data)
    column: NDArray[Any] = np.ndarray((len(whole),), np.dtype(kind), whole, at, (whole.shape[1],))
    return column


class Walk:
    """One message of ROS, walked through its types once to find its layout."""

    def __init__(self, types: Types, data: bytes, cdr: bool) -> None:
        self.types, self.data, self.cdr = types, data, cdr
        self.order, self.origin, self.widest = "<", 0, 8
        if cdr:
            if len(data) < 4 or data[1] not in (0, 1, 6, 7):
                raise ValueError("it does not begin like CDR")
            self.order = "<" if data[1] & 1 else ">"
            self.origin, self.widest = 4, 8 if data[1] < 2 else 4
        self.at = self.origin
        self.fixed: list[tuple[int, int]] = [(0, self.origin)]
        self.tree: dict[str, Any] = {}

    def layout(self) -> Layout:
        """The layout.

        Raises:
            ValueError: the bytes are not those of the type.
        """
        tree = self._struct("")
        left = len(self.data) - self.at
        if left < 0 or left >= (8 if self.cdr else 1):
            raise ValueError(f"{left} bytes are left over")
        places: dict[str, tuple[int, str]] = {}
        empty: list[str] = []
        for name, leaf in flatten(tree):
            if isinstance(leaf, Numbers):
                empty.append(name)
            else:
                places[name] = leaf
        fixed = np.concatenate([np.arange(a, b) for a, b in self.fixed]).astype(np.intp)
        return Layout(fixed, np.frombuffer(self.data, np.uint8)[fixed], places, tuple(empty))

    def _struct(self, kind: str) -> dict[str, Any]:
        fields = self.types[kind]
        if not fields and self.cdr:
            self._skip(1)
        return {field.name: self._field(field.kind, field.length) for field in fields}

    def _field(self, kind: str, length: int | None) -> Any:
        if length is None:
            return self._value(kind)
        if length < 0:
            length = self._count()
        if kind in PRIMITIVES.values():
            size = int(kind[1:])
            if length:
                self._align(size)
            begin = self._skip(size * length)
            return Numbers(length, begin, size, self.order + kind)
        if length > MOST_ELEMENTS:
            raise ValueError(f"an array of {length} elements that are not numbers")
        return [self._value(kind, named=True) for _ in range(length)]

    def _value(self, kind: str, named: bool = False) -> Any:
        if kind == "string":
            return self._string(named)
        if kind == "time":
            self._align(4)
            return self._skip(8), self.order + STAMP
        if kind in PRIMITIVES.values():
            size = int(kind[1:])
            self._align(size)
            return self._skip(size), self.order + kind
        found = self._struct(kind)
        if named and isinstance(text := found.get("name"), _Text):
            self.fixed.append((text.begin, text.begin + len(text)))
        return found

    def _string(self, named: bool) -> str:
        length = self._count()
        begin = self._skip(length)
        if named:
            self.fixed.append((begin, begin + length))
        raw = self.data[begin : begin + length]
        return _Text(raw.rstrip(b"\0") if self.cdr else raw, begin)

    def _count(self) -> int:
        self._align(4)
        begin = self._skip(4)
        self.fixed.append((begin, begin + 4))
        return int(struct.unpack_from(f"{self.order}I", self.data, begin)[0])

    def _align(self, size: int) -> None:
        if self.cdr:
            self.at += -(self.at - self.origin) % min(size, self.widest)

    def _skip(self, count: int) -> int:
        begin = self.at
        self.at += count
        if self.at > len(self.data):
            raise ValueError("a field runs past the end of the message")
        return begin


class _Text(str):
    """A text and its first byte."""

    begin: int

    def __new__(cls, raw: bytes, begin: int) -> _Text:
        text = super().__new__(cls, raw.decode(errors="replace"))
        text.begin = begin
        return text


@dataclass(frozen=True)
class Numbers:
    """An array of numbers in the bytes of a message."""

    count: int
    begin: int
    size: int
    kind: str

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> tuple[int, str]:
        return self.begin + k * self.size, self.kind


_SECONDS, _REST = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")


def flatten(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Channels of a message: name and value; an array without elements is itself the value.

    Args:
        tree: values by name, nested; arrays are sequences or `Numbers`.

    Raises:
        ValueError: more than `MOST_LEAVES`.
    """
    for count, leaf in enumerate(_flatten("", tree)):
        if count >= MOST_LEAVES:
            raise ValueError(f"more than {MOST_LEAVES} values in a message")
        yield leaf


def _flatten(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        labels = {len(v): v for v in reversed([*value.values()]) if _texts(v)}
        for key, inner in value.items():
            path = f"{name}.{key}" if name else str(key)
            if isinstance(inner, list | Numbers):
                yield from _elements(path, inner, labels.get(len(inner)))
            else:
                yield from _flatten(path, inner)
    elif isinstance(value, tuple | int | float):
        yield name, value


def _texts(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) for v in value)


def _elements(path: str, array: list[Any] | Numbers, labels: list[str] | None) -> Iterator[tuple[str, Any]]:
    if len(array) == 0:
        yield path, array if isinstance(array, Numbers) else Numbers(0, 0, 0, "")
    elif len(array) <= MOST_CHANNELS and not _texts(array):
        own = [v.get("name") if isinstance(v, Mapping) else None for v in (array[k] for k in range(len(array)))]
        if labels is None and all(isinstance(v, str) and v for v in own):
            labels = [str(v) for v in own]
        if labels is not None and len(set(labels)) < len(labels):
            labels = None  # a joint named twice: which is meant is not known
        for k in range(len(array)):
            yield from _flatten(f"{path}[{labels[k] if labels else k + 1}]", array[k])


class _TreeDecoder(Decoder):
    """Messages that are decoded into values one after the other."""

    @abstractmethod
    def tree(self, message: bytes) -> Mapping[str, Any]:
        """A message as nested values."""

    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        batch = Batch(len(messages))
        found: dict[str, tuple[list[int], list[Any]]] = {}
        for row, message in enumerate(messages):
            try:
                leaves = list(flatten(stamped(self.tree(message))))
            except (ValueError, TypeError, RecursionError, KeyError, AttributeError):
                batch.other += 1
                continue
            for name, value in leaves:
                if isinstance(value, Numbers):
                    batch.empty[name] = batch.empty.get(name, 0) + 1
                elif wanted is None or name in wanted or (type(value) is Stamp and HEADER in wanted):
                    batch.stamps |= {name} if type(value) is Stamp else set()
                    rows, values = found.setdefault(name, ([], []))
                    rows.append(row)
                    values.append(value)
        for name, (rows, values) in found.items():
            whole = all(type(v) in (int, Stamp) and abs(v) < 2**63 for v in values)
            batch.put(name, rows, np.array(values, np.int64 if whole else np.float64))
        return batch


def stamped(value: Any, depth: int = 0) -> Any:
    """The same values, with {sec, nanosec} as whole nanoseconds.

    Raises:
        ValueError: nested too deep.
    """
    if depth > 32:
        raise ValueError("values are nested more than 32 deep")
    if isinstance(value, Mapping):
        if len(value) == 2:
            seconds = next((value[k] for k in _SECONDS if k in value), None)
            rest = next((value[k] for k in _REST if k in value), None)
            if type(seconds) is int and type(rest) is int:
                return Stamp(seconds * 10**9 + rest)
        return {key: stamped(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, list):
        if len(value) > MOST_ELEMENTS:
            return None
        return [stamped(inner, depth + 1) for inner in value]
    return value


class JsonDecoder(_TreeDecoder):
    """JSON: numbers, and stamps as {sec, nsec}."""

    def tree(self, message: bytes) -> Mapping[str, Any]:
        found = json.loads(message)
        if not isinstance(found, dict):
            raise ValueError("a message is not an object")
        return found


class ProtobufDecoder(_TreeDecoder):
    """Protobuf, by the set of descriptors that travels along."""

    def __init__(self, topic: Topic) -> None:
        try:
            from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
            from google.protobuf.message import DecodeError
        except ImportError as error:
            raise MissingDependencyError(
                f"topic {topic.name} is encoded by protobuf, which needs a package that is not installed.",
                where="protobuf",
                advice='Install it with `pip install "haptid[ros]"`.',
            ) from error
        files = descriptor_pb2.FileDescriptorSet()
        pool = descriptor_pool.DescriptorPool()
        try:
            files.ParseFromString(topic.definition)
            for file in files.file:
                pool.Add(file) if hasattr(pool, "Add") else pool.AddSerializedFile(file.SerializeToString())
            self.kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(topic.kind))
        except (DecodeError, KeyError, TypeError) as error:
            raise ValueError(f"the descriptors of its type {topic.kind} are wrong ({error})") from error
        self.wrong = DecodeError

    def tree(self, message: bytes) -> Mapping[str, Any]:
        try:
            found = self.kind.FromString(message)
        except self.wrong as error:
            raise ValueError(str(error)) from error
        return _values(found, 0)


@lru_cache(maxsize=256)
def _described(descriptor: Any) -> tuple[tuple[str, bool, bool, bool], ...]:
    """Name of each field, and whether it is repeated, a message, or optional."""
    return tuple(
        (f.name, bool(f.is_repeated), f.message_type is not None, bool(f.has_presence)) for f in descriptor.fields
    )


def _values(message: Any, depth: int) -> dict[str, Any]:
    """Fields of a protobuf message; submessages and optional fields only where they are set."""
    if depth > 32:
        raise ValueError("messages are nested more than 32 deep")
    found: dict[str, Any] = {}
    for name, repeated, nested, optional in _described(message.DESCRIPTOR):
        if optional and not message.HasField(name):
            continue
        value = getattr(message, name)
        if repeated and hasattr(value, "items"):
            found[name] = {str(k): _values(v, depth + 1) if nested else v for k, v in value.items()}
        elif repeated:
            found[name] = [_values(v, depth + 1) for v in value] if nested else list(value)
        else:
            found[name] = _values(value, depth + 1) if nested else value
    return found
