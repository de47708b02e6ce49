"""A container of messages, read as a stream of (channel, receive stamp, bytes).

The containers are read here rather than through their libraries because a log is often cut short, and because only the
bytes of the wanted topics are looked at: a chunk without any is skipped, and no length in a file is believed before it
is compared with what is there. Memory is that of one chunk.
"""

from __future__ import annotations

import bz2
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TypeAlias

from haptid._internal.bounded_files import amount_text
from haptid._internal.late import dataclass
from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.formats.sniff import corrupt, opened_file

# Messages of a channel in a row: the channel, their receive stamps in ns, their bytes.
Messages: TypeAlias = tuple[int, list[int], list[bytes]]
# Bytes of a chunk before and after unpacking, and of a schema; recorders make chunks of about 1 MB.
MOST_CHUNK, MOST_SCHEMA = 2**30, 2**22


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


def too_large(path: Path, what: str, size: int) -> LogFileError:
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
        raise too_large(path, what, size)
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
