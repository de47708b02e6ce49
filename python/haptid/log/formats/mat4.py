"""MAT files of level 4: real matrices of numbers one after the other, as "To File" and real-time targets write."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from haptid.log.formats.mat4_header import HEADER_BYTES, mat4_header
from haptid.log.formats.sniff import MOST_CHANNELS, RawChannel, addresses, check_members, corrupt, opened_file

_KIND = "MAT 4"
# Codes of letters that a level of one byte has.
_LAST_LETTER = 255


class _Matrix(NamedTuple):
    """A matrix in the file: name, type and shape of its numbers, the byte of the first one, and whether it is letters.

    A text has the codes of its letters, one row for each line.
    """

    name: str
    dtype: np.dtype[np.generic]
    shape: tuple[int, int]
    at: int
    text: bool


def names(path: Path) -> list[str]:
    """Names of the channels of all real matrices."""
    with opened_file(path, _KIND):
        numbers = (matrix for matrix in _matrices(path) if not matrix.text)
        return [channel for matrix in numbers for channel in addresses(matrix.name, matrix.shape)]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that exist in the file, each (n,)."""
    found: dict[str, RawChannel] = {}
    with opened_file(path, _KIND):
        for matrix in _matrices(path):
            own = {channel: at for channel, at in addresses(matrix.name, matrix.shape).items() if channel in wanted}
            if own and not matrix.text:
                values = _values(path, matrix)
                found |= {channel: np.ascontiguousarray(values[at]) for channel, at in own.items()}
    return {name: found[name] for name in wanted if name in found}


def beside(path: Path) -> dict[str, RawChannel]:
    """Lists of texts, one in each row of letters, and single numbers beside the samples, each (n,)."""
    found: dict[str, RawChannel] = {}
    with opened_file(path, _KIND):
        for matrix in _matrices(path):
            rows, columns = matrix.shape
            if matrix.text and rows <= MOST_CHANNELS and 0 < columns <= MOST_CHANNELS:
                letters = np.clip(_values(path, matrix), 0, _LAST_LETTER).astype(np.uint32)
                found[matrix.name] = np.array(["".join(map(chr, row)).rstrip(" \0") for row in letters], np.str_)
            elif not matrix.text and matrix.shape == (1, 1):
                found[matrix.name] = _values(path, matrix).ravel()
    return found


def _values(path: Path, matrix: _Matrix) -> RawChannel:
    """Numbers of a matrix, or codes of its letters, of its shape."""
    count = matrix.shape[0] * matrix.shape[1]
    values = np.fromfile(path, matrix.dtype, count, offset=matrix.at).reshape(matrix.shape, order="F")
    return values.astype(matrix.dtype.newbyteorder("="))


def _matrices(path: Path) -> Iterator[_Matrix]:
    """Real matrices of numbers, and those of letters, in their order.

    Raises:
        LogFileError: one runs past the end of the file, or a header is none.
    """
    at, seen, size = 0, 0, path.stat().st_size
    with path.open("rb") as file:
        while at < size:
            file.seek(at)
            found = mat4_header(file.read(HEADER_BYTES))
            if found is None:
                raise corrupt(path, _KIND, f"no matrix begins at byte {at}")
            begin = at + HEADER_BYTES + found.name_bytes
            if begin + found.bytes > size:
                raise corrupt(path, _KIND, f"the matrix at byte {at} runs past the end of the file")
            name = file.read(found.name_bytes).rstrip(b"\0").decode("latin-1")
            if found.real or found.text:
                yield _Matrix(name, found.dtype, (found.rows, found.columns), begin, found.text)
            at, seen = begin + found.bytes, seen + 1
            check_members(path, seen, "matrices")
