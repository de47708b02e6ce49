"""Encodings of text logs: UTF-8, UTF-16 with its mark, and the code pages in which Windows programs save tables."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import IO, TextIO

from haptid.errors import LogFileError
from haptid.log.formats.brackets import HEAD, is_bracketed, unbracketed

UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# Bytes that tell the encoding, and most of a character that may be cut at their end.
_HEAD, _CUT = 2**16, 3
# Bytes above 7-bit codes, and pairs of GB 2312: symbols, full-width and Greek letters and characters, of which most are
# among the 3755 usual ones. In Western texts such bytes stand alone, or in other pairs.
_HIGH, _CHINESE = re.compile(rb"[\x80-\xff]+"), re.compile(rb"(?:[\xa1\xa3\xa6\xb0-\xf7][\xa1-\xfe])+")
_RARE = 0xD8
# Characters of UTF-8 above 7-bit codes; in Western code pages a capital with an accent before a sign.
_UTF_8 = re.compile(rb"[\xc2-\xdf][\x80-\xbf]|[\xe0-\xef][\x80-\xbf]{2}|[\xf0-\xf4][\x80-\xbf]{3}")


def encoding_of(head: bytes) -> str:
    """Encoding of a text with these first bytes: of one that is no UTF-8, Western European, or simplified Chinese."""
    if head[:2] in UTF_16_MARKS:
        return "utf-16"
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        if error.start < len(head) - _CUT or error.reason != "unexpected end of data":
            runs = _HIGH.findall(head)
            if _is_chinese(runs[:-1] or runs):
                return "gbk"
            told = sum(len(_UTF_8.findall(run)) for run in runs)
            if told < sum(len(_UTF_8.sub(b"", run)) for run in runs):
                return "cp1252"  # else UTF-8 with damaged bytes, as of a line that a port cut short
    return "utf-8-sig"


def _is_chinese(runs: list[bytes]) -> bool:
    """Whether runs of bytes above 7-bit codes are characters of GB 2312, most of them usual ones."""
    if not all(_CHINESE.fullmatch(run) for run in runs):
        return False
    first = b"".join(runs)[::2]
    return 2 * sum(byte < _RARE for byte in first) > len(first)


def text_of(raw: bytes) -> str:
    """The text of some bytes."""
    return raw.decode(encoding_of(raw), errors="replace")


def opened_text(path: Path) -> TextIO:
    """The characters of a text, its mark left out and its line ends kept."""
    with path.open("rb") as file:
        encoding = encoding_of(file.read(_HEAD))
    return path.open(encoding=encoding, errors="replace", newline="")


def opened_utf8(path: Path) -> IO[bytes]:
    """The bytes of a text in UTF-8, with its mark if it has one; of UTF-16 the whole is in memory.

    Of a matrix in brackets they are those of its rows, without the brackets, in memory too.

    Raises:
        LogFileError: UTF-16 text has half a character at its end.
    """
    file = path.open("rb")
    head = file.read(HEAD)
    if is_bracketed(head):
        with file:
            return io.BytesIO(unbracketed(head + file.read()))
    if encoding_of(head[:2]) != "utf-16":
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
