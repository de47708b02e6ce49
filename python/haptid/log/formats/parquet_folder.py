"""A folder of Parquet files of equal columns as one log: rows one after the other, by the numbers in files' names."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from haptid.errors import LogFileError
from haptid.log.formats import parquet
from haptid.log.formats.folders import log_size, parquet_files
from haptid.log.formats.sniff import RawChannel


def names(folder: Path) -> list[str]:
    """Channels of the files.

    Raises:
        LogFileError: one has other channels than the first.
    """
    files = parquet_files(folder)
    first = parquet.names(files[0])
    for file in files[1:]:
        other = parquet.names(file)
        if set(other) != set(first):
            lost = sorted(set(first) ^ set(other))
            raise LogFileError(
                f"{file} has other channels than {files[0].name}: they differ in {', '.join(lost[:4])}.",
                where=file,
                found=tuple(other),
                limit=tuple(first),
                advice="Keep files of one recording in the folder, or name one of them.",
            )
    return first


def units(folder: Path) -> dict[str, str]:
    """Units that the first file states."""
    return parquet.units(parquet_files(folder)[0])


def columns(folder: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels, each (n,), of all files.

    Raises:
        LogFileError: a file cannot be read, or has other channels than the first.
    """
    known = set(names(folder))
    there = [name for name in wanted if name in known]
    parts = [parquet.columns(file, there) for file in parquet_files(folder)]
    return {name: np.concatenate([part.pop(name) for part in parts]) for name in there}


def rows(folder: Path, wanted: Sequence[str], start: int, stop: int) -> list[RawChannel]:
    """Rows start..stop of channels, each (stop - start,); only the files that hold them are opened."""
    files, edges = _edges(folder, log_size(folder))
    parts = []
    for k in range(bisect_right(edges, start) - 1, len(files)):
        if edges[k] >= stop:
            break
        low, high = max(start - edges[k], 0), min(stop, edges[k + 1]) - edges[k]
        if low < high:
            parts.append(parquet.rows(files[k], wanted, low, high))
    return [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]


@lru_cache(maxsize=8)
def _edges(folder: Path, _size: int) -> tuple[list[Path], list[int]]:
    """The files, and the first row of each, with the count of all at the end."""
    files = parquet_files(folder)
    return files, [0, *np.cumsum([parquet.count(file) for file in files]).tolist()]
