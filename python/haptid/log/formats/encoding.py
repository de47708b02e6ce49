"""Encodings of text logs: UTF-8, and UTF-16 with its mark, as Windows tools and PowerShell's `>` write."""

from __future__ import annotations

import io
from pathlib import Path
from typing import IO, TextIO

from haptid.errors import LogFileError

UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")


def encoding_of(head: bytes) -> str:
    """Encoding of a text with these first bytes."""
    return "utf-16" if head[:2] in UTF_16_MARKS else "utf-8-sig"


def opened_text(path: Path) -> TextIO:
    """The characters of a text, its mark left out and its line ends kept."""
    with path.open("rb") as file:
        encoding = encoding_of(file.read(2))
    return path.open(encoding=encoding, errors="replace", newline="")


def opened_utf8(path: Path) -> IO[bytes]:
    """The bytes of a text in UTF-8, with its mark if it has one; of UTF-16 the whole is in memory.

    Raises:
        LogFileError: UTF-16 text has half a character at its end.
    """
    file = path.open("rb")
    if encoding_of(file.read(2)) != "utf-16":
        file.seek(0)
        return file
    with file:
        file.seek(0)
        raw = file.read()
    if len(raw) % 2:
        raise LogFileError(
            f"{path} is damaged or cut short: it is UTF-16 text of {len(raw)} bytes, an odd number.",
            where=path,
            found=len(raw),
            advice="Copy or export it again.",
        )
    return io.BytesIO(raw.decode("utf-16", errors="replace").encode())
