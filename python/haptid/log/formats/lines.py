"""Lines of a text as blocks of bytes: up to a byte, with single blanks, and whole lines together."""

from __future__ import annotations

import io
import re
from abc import abstractmethod
from collections.abc import Collection, Iterator
from typing import IO, Any

# Longer than any row.
BLOCK_BYTES = 2**19
_RUNS, _EDGES = re.compile(rb"[ \t]+"), re.compile(rb"^ | (?=\r?$)", re.MULTILINE)
# Marks of a matrix that is written as MATLAB has it, `[ 0 1;`, around its rows.
_MARKS = re.compile(rb"^ ?\[|[;\]]+(?= ?\r?$)", re.MULTILINE)
# Name of such a matrix, before its first row: a further one with a name is another matrix.
MATRIX_NAME = r"\s*[A-Za-z][\w.]*\s*=\s*(?=\[)"
_NAME = re.compile(MATRIX_NAME.encode())


class Part(io.RawIOBase):
    """A file up to a byte."""

    def __init__(self, file: IO[bytes], stop: int) -> None:
        self.file, self.left = file, stop - file.tell()

    def readable(self) -> bool:
        return True

    def readinto(self, out: Any) -> int:
        block = self.file.read(min(len(out), self.left))
        out[: len(block)] = block
        self.left -= len(block)
        return len(block)


class _Changed(io.RawIOBase):
    """A file whose blocks of whole lines are changed as they are read."""

    def __init__(self, file: IO[bytes]) -> None:
        self.file, self.rest = file, b""

    @abstractmethod
    def change(self, block: bytes) -> bytes:
        """A block of whole lines as it is to be read."""

    def readable(self) -> bool:
        return True

    def readinto(self, out: Any) -> int:
        while not self.rest:
            block = self.file.read(BLOCK_BYTES)
            if not block:
                return 0
            self.rest = self.change(block + self.file.readline())
        count = min(len(out), len(self.rest))
        out[:count], self.rest = self.rest[:count], self.rest[count:]
        return count


class Collapsed(_Changed):
    """A file whose runs of blanks and tabs are single blanks, without those at the ends of its lines, nor brackets."""

    begun = False

    def change(self, block: bytes) -> bytes:
        if not self.begun and (name := _NAME.match(block)):
            block = block[name.end() :]
        self.begun = True
        marks = any(mark in block for mark in (b"[", b"]", b";"))
        runs = any(mark in block for mark in (b"  ", b"\t", b" \n", b" \r", b"\n ")) or block[:1] == b" "
        single = _RUNS.sub(b" ", block) if runs or marks else block
        return _EDGES.sub(b"", _MARKS.sub(b"", single) if marks else single)


class Without(_Changed):
    """A file without the lines that are one of some, and how many were left out."""

    def __init__(self, file: IO[bytes], lines: Collection[bytes]) -> None:
        super().__init__(file)
        self.count = 0
        self.lines = re.compile(rb"^(?:" + b"|".join(map(re.escape, lines)) + rb")[ \t]*\r?(?:\n|\Z)", re.MULTILINE)

    def change(self, block: bytes) -> bytes:
        kept, found = self.lines.subn(b"", block)
        self.count += found
        return kept


def blocks(source: IO[bytes]) -> Iterator[bytes]:
    """Whole lines, a block at a time. A streaming reader of pyarrow would read ahead, and after an error for ever.

    Raises:
        ValueError: a line is longer than a block.
    """
    while block := source.read(BLOCK_BYTES):
        rest = source.readline()
        if len(rest) > BLOCK_BYTES:
            raise ValueError("a line is too long")
        if not block.isspace() or rest.strip():
            yield block + rest
