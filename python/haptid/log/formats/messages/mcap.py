"""MCAP: chunks of messages with their channels and schemas, also of a recording that was cut short.

Source: MCAP specification (mcap.dev/spec).
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from typing import IO

from haptid.log.formats.messages.container import MOST_CHUNK, Container, Messages, Topic, too_large

MAGIC = b"\x89MCAP0\r\n"


class Mcap(Container):
    """MCAP. Without a summary (a file that was cut short) all whole chunks are read."""

    _CHUNK_HEAD = struct.Struct("<QQQII")
    _MESSAGE = struct.Struct("<HIQQ")
    _INNER = struct.Struct("<BQHIQQ")

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        size = self.path.stat().st_size
        schemas: dict[int, tuple[str, str, bytes]] = {}
        with self.path.open("rb") as file:
            index = self._summary(file, size, schemas)
            at = len(MAGIC)
            while at + 9 <= size:
                file.seek(at)
                op, length = struct.unpack("<BQ", file.read(9))
                if op == 0x0F or op == 0x02:
                    return
                if at + 9 + length > size:
                    break
                body = at + 9
                if op == 0x06:
                    keep = self._of(wanted)
                    if index is None or keep is None or not index.get(at, keep).isdisjoint(keep):
                        yield from self._chunk(file, at, length, schemas, wanted)
                elif op in (0x03, 0x04):
                    self._record(op, memoryview(self._read(file, at, length)), schemas)
                elif op == 0x05:
                    data = memoryview(self._read(file, at, length))
                    channel, _, stamp, _ = self._MESSAGE.unpack_from(data)
                    keep = self._of(wanted)
                    if keep is None or channel in keep:
                        yield channel, [stamp], [bytes(data[self._MESSAGE.size :])]
                at = body + length
        self._note(f"{self.path.name} is cut short at byte {at} of {size}: all whole chunks before it are used")

    def _read(self, file: IO[bytes], at: int, length: int) -> bytes:
        """The content of a record at `at`, which lies in the file."""
        if length > MOST_CHUNK:
            raise too_large(self.path, f"the record at byte {at}", length)
        file.seek(at + 9)
        return file.read(length)

    def _summary(
        self, file: IO[bytes], size: int, schemas: dict[int, tuple[str, str, bytes]]
    ) -> dict[int, set[int]] | None:
        """Channels of each chunk, by its first byte; None where the file has no summary."""
        tail = 9 + 20 + len(MAGIC)
        if size < tail + len(MAGIC):
            return None
        file.seek(size - tail)
        footer = file.read(tail)
        start = struct.unpack_from("<Q", footer, 9)[0]
        if footer[0] != 0x02 or not footer.endswith(MAGIC) or not 0 < start < size - tail:
            return None
        if size - start > MOST_CHUNK:
            return None
        file.seek(start)
        data, at = memoryview(file.read(size - tail - start)), 0
        index: dict[int, set[int]] = {}
        while at + 9 <= len(data):
            op, length = struct.unpack_from("<BQ", data, at)
            body = data[at + 9 : at + 9 + length]
            if len(body) < length:
                return None
            if op in (0x03, 0x04):
                self._record(op, body, schemas)
            elif op == 0x08:
                _, _, chunk, _, stored = struct.unpack_from("<QQQQI", body)
                index[chunk] = {struct.unpack_from("<H", body, 36 + k)[0] for k in range(0, stored, 10)}
            at += 9 + length
        used = set().union(*index.values())
        return index if index and used <= self.topics.keys() else None

    def _record(self, op: int, body: memoryview, schemas: dict[int, tuple[str, str, bytes]]) -> None:
        """A schema or a channel."""
        if op == 0x03:
            key, at = struct.unpack_from("<H", body)[0], 2
            name, at = _text(body, at)
            encoding, at = _text(body, at)
            schemas[key] = (name, encoding, _bytes(body, at)[0])
            return
        channel, key = struct.unpack_from("<HH", body)
        topic, at = _text(body, 4)
        encoding, at = _text(body, at)
        name, schema, definition = schemas.get(key, ("", "", b""))
        self._topic(channel, Topic(topic, name, encoding, definition, schema))

    def _chunk(
        self,
        file: IO[bytes],
        at: int,
        length: int,
        schemas: dict[int, tuple[str, str, bytes]],
        wanted: Collection[str] | None,
    ) -> Iterator[Messages]:
        data = memoryview(self._read(file, at, length))
        _, _, size, crc, _ = self._CHUNK_HEAD.unpack_from(data)
        compression, begin = _text(data, self._CHUNK_HEAD.size - 4)
        (stored,) = struct.unpack_from("<Q", data, begin)
        packed = data[begin + 8 : begin + 8 + stored]
        records = self._unpacked(at, bytes(packed), compression, size, crc) if len(packed) == stored else None
        if records is None:
            self._note(f"the chunk at byte {at} of {self.path.name} is damaged: its messages are left out")
            return
        yield from self._walk(records, schemas, wanted)

    def _walk(
        self, records: bytes, schemas: dict[int, tuple[str, str, bytes]], wanted: Collection[str] | None
    ) -> Iterator[Messages]:
        """The messages of an unpacked chunk."""
        at, end = 0, len(records)
        keep, known = self._of(wanted), len(self.topics)
        unpack, head = self._INNER.unpack_from, self._INNER.size
        found: dict[int, tuple[list[int], list[bytes]]] = {}
        while at + 9 <= end:
            if records[at] == 0x05 and at + head <= end:
                _, length, channel, _, stamp, _ = unpack(records, at)
                stop = at + 9 + length
                if stop > end or length < 22:
                    break
                if keep is None or channel in keep:
                    if channel not in found:
                        found[channel] = ([], [])
                    stamps, data = found[channel]
                    stamps.append(stamp)
                    data.append(records[at + head : stop])
                at = stop
                continue
            op, length = struct.unpack_from("<BQ", records, at)
            stop = at + 9 + length
            if stop > end:
                break
            if op in (0x03, 0x04):
                self._record(op, memoryview(records)[at + 9 : stop], schemas)
                if len(self.topics) != known:
                    keep, known = self._of(wanted), len(self.topics)
            at = stop
        yield from ((channel, stamps, data) for channel, (stamps, data) in found.items())
        if at < end:
            self._note(f"a chunk of {self.path.name} ends within a record: the rest of it is left out")


def _bytes(data: memoryview, at: int) -> tuple[bytes, int]:
    """Bytes behind their 32-bit length, and where they end."""
    (length,) = struct.unpack_from("<I", data, at)
    stop = at + 4 + length
    if stop > len(data):
        raise ValueError("a text runs past the end of its record")
    return bytes(data[at + 4 : stop]), stop


def _text(data: memoryview, at: int) -> tuple[str, int]:
    found, stop = _bytes(data, at)
    return found.decode(errors="replace"), stop
