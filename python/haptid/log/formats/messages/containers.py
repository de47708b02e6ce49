"""Containers of messages: MCAP, ROS 1 bags and ROS 2 databases, read as a stream of (channel, receive stamp, bytes).

The containers are read here rather than through their libraries because a log is often cut short, and because only the
bytes of the wanted topics are looked at: a chunk without any is skipped, and no length in a file is believed before it
is compared with what is there. Memory is that of one chunk.

Sources: MCAP specification (mcap.dev/spec); ROS bag format 2.0 (wiki.ros.org/Bags/Format/2.0); rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import bz2
import sqlite3
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeAlias

from haptid._internal.bounded_files import amount_text
from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.formats.folders import bag_files
from haptid.log.formats.messages.definitions import COMMON
from haptid.log.formats.sniff import corrupt, empty, opened_file

# Messages of a channel in a row: the channel, their receive stamps in ns, their bytes.
Messages: TypeAlias = tuple[int, list[int], list[bytes]]
# Messages that are taken from a database at once.
_ROWS = 1000
# Bytes of a chunk before and after unpacking, and of a schema; recorders make chunks of about 1 MB.
MOST_CHUNK, MOST_SCHEMA = 2**30, 2**22
MCAP_MAGIC, BAG_MAGIC = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"


@dataclass(frozen=True)
class Topic:
    """A channel of a container.

    Attributes:
        name: of the topic; several channels may have one.
        kind: type of its messages.
        encoding: of their bytes: cdr, ros1, protobuf, json or another.
        definition: of the type, as it travels along; empty where it does not.
        schema: kind of this definition: ros2msg, ros1msg, protobuf, jsonschema or another.
    """

    name: str
    kind: str
    encoding: str
    definition: bytes
    schema: str


class Container(ABC):
    """A file of messages.

    Attributes:
        path: of the file.
        topics: by channel; complete once `messages` has been read to its end.
        counts: messages of each channel that were read.
        notes: what was lost, one sentence each.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.topics: dict[int, Topic] = {}
        self.counts: dict[int, int] = {}
        self.notes: list[str] = []

    @abstractmethod
    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        """The messages of the wanted topics chunk by chunk, of all topics where None; in order within a channel."""

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)

    def _topic(self, channel: int, topic: Topic) -> None:
        if len(topic.definition) > MOST_SCHEMA:
            raise LogFileError(
                f"{self.path}: the schema of {topic.name} has {len(topic.definition)} bytes; at most {MOST_SCHEMA} are "
                "accepted.",
                where=topic.name,
                found=len(topic.definition),
                limit=MOST_SCHEMA,
                advice="Leave the topic out of the recording.",
            )
        self.topics[channel] = topic

    def _unpacked(self, at: int, data: bytes, compression: str, size: int, crc: int = 0) -> bytes | None:
        """The chunk at byte `at`; None where it is damaged.

        Raises:
            LogFileError: it declares far more than is stored of it.
        """
        try:
            with opened_file(self.path, "chunk"):
                found = unpacked(self.path, f"the chunk at byte {at}", data, compression, size)
        except LogFileError as error:
            if error.limit != "chunk":
                raise
            return None
        return found if not crc or zlib.crc32(found) == crc else None

    def _of(self, wanted: Collection[str] | None) -> set[int] | None:
        """Channels of the wanted topics that are known so far."""
        return None if wanted is None else {c for c, topic in self.topics.items() if topic.name in wanted}


def containers(path: Path) -> list[Container]:
    """The containers of a file, or of a bag's folder in their order."""
    if not path.is_dir():
        return [_container(path)]
    files = bag_files(path)
    if not files:
        raise empty(path, "no .mcap, .db3 or .bag files")
    return [_container(file) for file in files]


def _container(path: Path) -> Container:
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(MCAP_MAGIC[:5]):
        return Mcap(path)
    if head.startswith(BAG_MAGIC[:8]):
        return Bag(path)
    if head.startswith(b"SQLite format 3"):
        return Database(path)
    what = "it does not begin like MCAP, a ROS bag or SQLite"
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        what = "the file as a whole is compressed; `zstd -d` unpacks it"
    raise corrupt(path, path.suffix.lstrip("."), what)


def _too_large(path: Path, what: str, size: int) -> LogFileError:
    """Error of a chunk or record that no recorder writes."""
    return LogFileError(
        f"{path}: {what} declares {amount_text(size)}, and at most {amount_text(MOST_CHUNK)} are read.",
        where=what,
        found=size,
        limit=MOST_CHUNK,
        advice="Copy or export the file again.",
    )


def unpacked(path: Path, what: str, data: bytes, compression: str, size: int) -> bytes:
    """A compressed chunk.

    Args:
        path, what: of the file and of the chunk, for errors.
        data: its bytes.
        compression: zstd, lz4, bz2, or none.
        size: declared, once unpacked.

    Raises:
        LogFileError: it declares far more than is stored, or another size than it has.
    """
    if size > MOST_CHUNK:
        raise _too_large(path, what, size)
    if compression in ("", "none"):
        found = data
    elif compression == "bz2":
        found = bz2.BZ2Decompressor().decompress(data, size + 1)
    else:
        found = _decompressed(path, what, data, compression, size)
    if len(found) != size:
        raise corrupt(path, "chunk", f"{what} unpacks to {len(found)} bytes and declares {size}")
    return found


def _decompressed(path: Path, what: str, data: bytes, compression: str, size: int) -> bytes:
    try:
        if compression == "zstd":
            import zstandard

            codec = zstandard.ZstdDecompressor()
            if zstandard.frame_content_size(data) == size:
                return codec.decompress(data, max_output_size=size)
            return codec.stream_reader(data).read(size + 1)
        if compression == "lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: {what} is compressed by {compression}, which needs a package that is not installed.",
            where=error.name,
            advice='Install it with `pip install "haptid[ros]"`.',
        ) from error
    raise corrupt(path, "chunk", f"{what} is compressed by {compression!r}, which is not known")


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
            at = len(MCAP_MAGIC)
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
            raise _too_large(self.path, f"the record at byte {at}", length)
        file.seek(at + 9)
        return file.read(length)

    def _summary(
        self, file: IO[bytes], size: int, schemas: dict[int, tuple[str, str, bytes]]
    ) -> dict[int, set[int]] | None:
        """Channels of each chunk, by its first byte; None where the file has no summary."""
        tail = 9 + 20 + len(MCAP_MAGIC)
        if size < tail + len(MCAP_MAGIC):
            return None
        file.seek(size - tail)
        footer = file.read(tail)
        start = struct.unpack_from("<Q", footer, 9)[0]
        if footer[0] != 0x02 or not footer.endswith(MCAP_MAGIC) or not 0 < start < size - tail:
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


class Bag(Container):
    """ROS 1 bag, format 2.0. Without an index (a recording that was not closed) all whole chunks are read."""

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        size = self.path.stat().st_size
        with self.path.open("rb") as file:
            if file.read(len(BAG_MAGIC)) != BAG_MAGIC:
                raise corrupt(self.path, "ROS bag", "it is not of format 2.0")
            index, end = self._index(file, size)
            at = len(BAG_MAGIC)
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
        found = self._record(file, len(BAG_MAGIC), size)
        start = struct.unpack("<Q", found[0].get(b"index_pos", b"").ljust(8, b"\0")[:8])[0] if found else 0
        if not len(BAG_MAGIC) < start < size:
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


class Database(Container):
    """ROS 2 database (db3). Definitions of common types are known where it has none (before ROS 2 Iron)."""

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        with opened_file(self.path, "ROS 2 database"):
            uri = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
            base = sqlite3.connect(uri, uri=True)
        try:
            with opened_file(self.path, "ROS 2 database"):
                base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_CHUNK)
                base.execute("PRAGMA trusted_schema = OFF")
                self._topics(base)
            keep = self._of(wanted)
            marks = "" if keep is None else f"WHERE topic_id IN ({','.join(map(str, keep))})"
            rows = base.execute(f"SELECT topic_id, timestamp, data FROM messages {marks} ORDER BY rowid")
            count = 0
            try:
                while some := rows.fetchmany(_ROWS):
                    count += len(some)
                    for channel in self.topics:
                        own = [(t, d) for c, t, d in some if c == channel and type(t) is int and type(d) is bytes]
                        if own:
                            yield channel, [t for t, _ in own], [d for _, d in own]
            except sqlite3.DatabaseError as error:
                if not count:
                    raise corrupt(self.path, "ROS 2 database", str(error)) from error
                self._note(f"{self.path.name} is damaged or cut short: the {count} messages before are used")
        finally:
            base.close()

    def _topics(self, base: sqlite3.Connection) -> None:
        tables = {name for name, kind in base.execute("SELECT name, type FROM sqlite_master") if kind == "table"}
        if not {"topics", "messages"} <= tables:
            raise corrupt(self.path, "ROS 2 database", "it has no tables `topics` and `messages`")
        told: dict[str, str] = {}
        if "message_definitions" in tables:
            told = dict(base.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
        for channel, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
            definition = told.get(kind) or COMMON.get(str(kind).replace("/msg/", "/"), "")
            self._topic(int(channel), Topic(str(name), str(kind), str(encoding), definition.encode(), "ros2msg"))


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
