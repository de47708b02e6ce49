"""Matrices as programs print them, `[[1, 2], [3, 4]]`, `A = [1, 2; 3, 4];`, `(1, 2)` in each line, as rows of text."""

from __future__ import annotations

import re

# Bytes that tell such a text.
HEAD = 2**12
_NUMBER = rb"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?i:nan|inf))"
_NAME = rb"(?:[A-Za-z_]\w*\s*=\s*)?(?:(?:np\.|numpy\.|torch\.)?(?:array|asarray|matrix|tensor)\s*\()?"
# Rows of MATLAB end with a semicolon, and go on in the next line behind three points.
_CONTINUED = re.compile(rb"\.{3}[^\n]*\n")
# The opening brackets, and the first two numbers of the first row.
_OPENS = re.compile(
    rb"\s*" + _NAME + rb"(?P<brackets>[\[({]\s*[\[({]?)\s*"
    + _NUMBER + rb"\s*(?P<comma>,?)\s*(?:" + _CONTINUED.pattern + rb"\s*)?" + _NUMBER
)  # fmt: skip
# Comments of MATLAB and Python.
_COMMENT = re.compile(rb"[%#][^\n]*")
_PREFIX, _DTYPE = re.compile(rb"\s*" + _NAME), re.compile(rb",?\s*dtype\s*=[^)\n]*")
_CLOSES, _OPENING = re.compile(rb"[\])}]\s*[,;]?\s*"), re.compile(rb"[\[({]")


def is_bracketed(head: bytes) -> bool:
    """Whether a text with these first bytes is a matrix in brackets, with commas or with brackets around each row.

    One of blanks and semicolons, `A = [ 1 2;`, is read as a table as it is.
    """
    found = _OPENS.match(_COMMENT.sub(b"", head.removeprefix(b"\xef\xbb\xbf")))
    return found is not None and bool(found["comma"] or len(_OPENING.findall(found["brackets"])) > 1)


def unbracketed(raw: bytes) -> bytes:
    """A line for each row, without brackets and the name before them."""
    text = _COMMENT.sub(b"", raw.removeprefix(b"\xef\xbb\xbf"))
    text = _DTYPE.sub(b"", _PREFIX.sub(b"", text, count=1))
    ends = [own.start() for own in _CLOSES.finditer(text)]
    if any(text[end - 1 : end] not in b"])}" for end in ends[1:]):  # more than one row has a bracket of its own
        text = b" ".join(text.split())  # a long row is printed on several lines
        text = _CLOSES.sub(b"\n", text)
    else:
        text = _CLOSES.sub(b"\n", _CONTINUED.sub(b" ", text).replace(b";", b"\n"))
    rows = (line.strip() for line in _OPENING.sub(b"", text).splitlines())
    return b"".join(row + b"\n" for row in rows if row)
