"""ROS 1 bags: records of connections and messages, compressed chunk by chunk.

Source: ROS bag format 2.0 (wiki.ros.org/Bags/Format/2.0).
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from typing import IO

from haptid.log.formats.messages.container import Container, Messages, Topic
from haptid.log.formats.sniff import corrupt

MAGIC = b"#ROSBAG V2.0\n"


class Bag(Container):
    """ROS 1 bag, format 2.0. Without an index (a recording that was not closed) all whole chunks are read."""

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise corrupt(self.path, "ROS bag", "it is not of format 2.0")
            index, end = self._index(file, size)
            at = len(MAGIC)
            while at < (end or size):
                found = self._record(file, at, size)
                if found is None:
                    self._note(f"{self.path.name} is cut short at byte {at} of {size}: all whole chunks are used")
                    return
                fields, begin, length = found
                op = fields.get(b"op", b"\0")[:1]
                if op == b"\x05":
                    keep = self._of(wanted)
                    if index is None or keep is None or not index.get(at, keep).isdisjoint(keep):
                        yield from self._chunk(file, at, fields, begin, length, wanted)
                elif op == b"\x07":
                    file.seek(begin)
                    self._connection(fields, file.read(length))
                elif op == b"\x02":
                    file.seek(begin)
                    channel, stamp = _stamp(fields)
                    keep = self._of(wanted)
                    if keep is None or channel in keep:
                        yield channel, [stamp], [file.read(length)]
                at = begin + length
        if end is None:
            self._note(f"{self.path.name} has no index (the recording was not closed): all whole chunks are used")

    def _record(self, file: IO[bytes], at: int, size: int) -> tuple[dict[bytes, bytes], int, int] | None:
        """Header fields, first byte and length of a record's data; None where the file ends before its end."""
        file.seek(at)
        raw = file.read(4)
        if len(raw) < 4:
            return None
        (length,) = struct.unpack("<I", raw)
        if at + 8 + length > size:
            return None
        header = file.read(length)
        (stored,) = struct.unpack("<I", file.read(4))
        begin = at + 8 + length
        return None if begin + stored > size else (_fields(header), begin, stored)

    def _index(self, file: IO[bytes], size: int) -> tuple[dict[int, set[int]] | None, int | None]:
        """Connections of each chunk by its first byte, and where the chunks end; None, None without an index."""
        found = self._record(file, len(MAGIC), size)
        start = struct.unpack("<Q", found[0].get(b"index_pos", b"").ljust(8, b"\0")[:8])[0] if found else 0
        if not len(MAGIC) < start < size:
            return None, None
        index: dict[int, set[int]] = {}
        at = start
        while at < size:
            found = self._record(file, at, size)
            if found is None:
                return None, None
            fields, begin, length = found
            file.seek(begin)
            if fields.get(b"op") == b"\x07":
                self._connection(fields, file.read(length))
            elif fields.get(b"op") == b"\x06":
                data = file.read(length)
                (chunk,) = struct.unpack("<Q", fields[b"chunk_pos"])
                index[chunk] = {struct.unpack_from("<I", data, k)[0] for k in range(0, len(data) - 7, 8)}
            at = begin + length
        return index, start

    def _connection(self, fields: dict[bytes, bytes], data: bytes) -> None:
        about = _fields(data)
        (channel,) = struct.unpack("<I", fields[b"conn"])
        kind = about.get(b"type", b"").decode(errors="replace")
        topic = fields.get(b"topic", b"").decode(errors="replace")
        self._topic(channel, Topic(topic, kind, "ros1", about.get(b"message_definition", b""), "ros1msg"))

    def _chunk(
        self,
        file: IO[bytes],
        at: int,
        fields: dict[bytes, bytes],
        begin: int,
        length: int,
        wanted: Collection[str] | None,
    ) -> Iterator[Messages]:
        file.seek(begin)
        compression = fields.get(b"compression", b"none").decode(errors="replace")
        (size,) = struct.unpack("<I", fields[b"size"])
        records = self._unpacked(at, file.read(length), compression, size)
        if records is None:
            self._note(f"the chunk at byte {at} of {self.path.name} is damaged: its messages are left out")
            return
        keep, k, size = self._of(wanted), 0, len(records)
        found: dict[int, tuple[list[int], list[bytes]]] = {}
        form: _Form | None = None
        while k + 4 <= size:
            (header,) = struct.unpack_from("<I", records, k)
            start = k + 8 + header
            if start > size:
                break
            (stored,) = struct.unpack_from("<I", records, start - 4)
            if start + stored > size:
                break
            about = records[k + 4 : k + 4 + header]
            k = start + stored
            if form is not None and len(about) == form.size and form.matches(about):
                channel, stamp = form.read(about)
            else:
                fields_of = _fields(about)
                if fields_of.get(b"op") == b"\x07":
                    self._connection(fields_of, records[start:k])
                    keep = self._of(wanted)
                if fields_of.get(b"op") != b"\x02":
                    continue
                channel, stamp = _stamp(fields_of)
                form = _Form(about)
            if keep is None or channel in keep:
                stamps, data = found.setdefault(channel, ([], []))
                stamps.append(stamp)
                data.append(records[start:k])
        yield from ((channel, stamps, data) for channel, (stamps, data) in found.items())


class _Form:
    """Header of a message of a bag, by which those like it are read without taking them apart."""

    def __init__(self, header: bytes) -> None:
        self.size = len(header)
        self.conn, self.time = header.index(b"conn=") + 5, header.index(b"time=") + 5
        self.known = self._rest(header)

    def _rest(self, header: bytes) -> tuple[bytes, bytes, bytes]:
        """The bytes that are neither connection nor time."""
        (a, m), (b, n) = sorted([(self.conn, 4), (self.time, 8)])
        return header[:a], header[a + m : b], header[b + n :]

    def matches(self, header: bytes) -> bool:
        return self._rest(header) == self.known

    def read(self, header: bytes) -> tuple[int, int]:
        (channel,) = struct.unpack_from("<I", header, self.conn)
        seconds, nanoseconds = struct.unpack_from("<II", header, self.time)
        return channel, seconds * 10**9 + nanoseconds


def _stamp(fields: dict[bytes, bytes]) -> tuple[int, int]:
    """Connection and receive stamp, ns, of a message of a bag."""
    (channel,) = struct.unpack("<I", fields[b"conn"])
    seconds, nanoseconds = struct.unpack("<II", fields[b"time"])
    return channel, seconds * 10**9 + nanoseconds


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Fields `name=value` of a bag's header, each behind its length."""
    found: dict[bytes, bytes] = {}
    at = 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        found[name] = value
        at += 4 + length
    return found
