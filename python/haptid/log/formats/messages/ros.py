"""Messages of ROS by the layout of their bytes.

Messages with the same lengths, counts and names have one layout. They are joined and viewed as one matrix of bytes, of
which a channel is a strided column: decoding takes no time per message.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.late import dataclass
from haptid.log.formats.messages.batch import HEADER, MOST_ELEMENTS, Batch, Decoder, Numbers, Samples, flatten
from haptid.log.formats.messages.definitions import PRIMITIVES, Types, parse

# Layouts that are kept for messages of one length.
MOST_LAYOUTS = 64
# NumPy type of stamps: whole nanoseconds.
STAMP = "stamp"


@dataclass(frozen=True)
class Layout:
    """Where the channels of a message are in its bytes.

    Attributes:
        fixed: bytes that define the layout: counts, lengths of texts, and names, as indices.
        content: these bytes.
        places: first byte and type of each channel.
        empty: arrays without elements.
        samples: places of the samples of channels that have several.
    """

    fixed: NDArray[np.intp]
    content: NDArray[np.uint8]
    places: Mapping[str, tuple[int, str]]
    empty: tuple[str, ...]
    samples: Mapping[str, Samples]


class RosDecoder(Decoder):
    """ROS messages: CDR of ROS 2 (XCDR version 1), or the packed form of ROS 1."""

    def __init__(self, definition: str, kind: str, cdr: bool) -> None:
        super().__init__()
        self.types: Types = parse(definition, kind)
        self.cdr = cdr
        self.layouts: dict[int, list[Layout]] = {}

    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        batch = Batch(len(messages))
        sizes = np.fromiter(map(len, messages), np.intp, len(messages))
        for size in np.unique(sizes)[::-1]:  # long messages show which arrays hold samples
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
            return Walk(self.types, message.tobytes(), self.cdr).layout(self.sampled)
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
        for name, samples in layout.samples.items():
            if wanted is None or name in wanted:
                places = [samples.values[k] for k in range(len(samples.values))]
                columns = np.column_stack([_column(data, *place) for place in places])
                batch.samples.setdefault(name, {}).update(zip(rows.tolist(), columns, strict=True))


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

    def layout(self, sampled: set[str] | None = None) -> Layout:
        """The layout; `sampled` as of `flatten`.

        Raises:
            ValueError: the bytes are not those of the type.
        """
        tree = self._struct("")
        left = len(self.data) - self.at
        if left < 0 or left >= (8 if self.cdr else 1):
            raise ValueError(f"{left} bytes are left over")
        places: dict[str, tuple[int, str]] = {}
        empty: list[str] = []
        samples: dict[str, Samples] = {}
        for name, leaf in flatten(tree, sampled):
            if isinstance(leaf, Samples):
                samples[name] = leaf
            elif isinstance(leaf, Numbers):
                empty.append(name)
            else:
                places[name] = leaf
        fixed = np.concatenate([np.arange(a, b) for a, b in self.fixed]).astype(np.intp)
        return Layout(fixed, np.frombuffer(self.data, np.uint8)[fixed], places, tuple(empty), samples)

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
