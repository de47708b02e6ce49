"""Parquet logs: a column of numbers for each channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet, types

from haptid._internal.arrays import Array
from haptid.log.formats.sniff import (
    Budget,
    RawChannel,
    check_members,
    collect,
    not_numeric,
    opened_file,
    repeated_name,
    require,
)

_KIND = "Parquet"
BATCH_ROWS = 2**16
# Options of opening: bytes are read as they are needed.
SPARING: dict[str, Any] = {"pre_buffer": False, "buffer_size": 2**20}
# Row groups that are cached: those at both ends of a segment of rows, of positions and of torques.
GROUPS_HELD = 4


def names(path: Path) -> list[str]:
    """Names of the columns of numbers."""
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), parquet.ParquetFile(path) as file:
        return [field.name for field in _schema(path, file) if _numeric(field.type)]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted columns that exist in the file, each (n,), read one after the other; a null is NaN.

    Raises:
        LogFileError: a wanted column holds texts, dates or lists, or declares far more rows than its bytes can hold.
    """
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), parquet.ParquetFile(path, **SPARING) as file:
        return collect(wanted, _columns(path, file, wanted))


def rows(path: Path, wanted: Sequence[str], start: int, stop: int) -> list[RawChannel]:
    """Rows start..stop of columns, each (stop - start,); their row groups are cached."""
    with opened_file(path, _KIND), parquet.ParquetFile(path) as file:
        counts = [file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups)]
    edges, parts = np.cumsum([0, *counts]), []
    for k, begin in enumerate(edges[:-1]):
        if begin < stop and edges[k + 1] > start:
            columns = _group(path, path.stat().st_mtime_ns, k, tuple(wanted))
            parts.append([column[max(start - begin, 0) : stop - begin] for column in columns])
    return [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]


@lru_cache(maxsize=GROUPS_HELD)
def _group(path: Path, _written: int, k: int, wanted: tuple[str, ...]) -> list[RawChannel]:
    """Columns of one row group; the file's modification time, ns, is part of the cache key."""
    with opened_file(path, _KIND), parquet.ParquetFile(path, **SPARING) as file:
        table = file.read_row_group(k, columns=list(wanted), use_threads=False)
    kinds = (table.schema.field(name).type for name in wanted)
    columns = [
        table[name].cast(pa.float64()) if types.is_decimal(kind) else table[name]
        for name, kind in zip(wanted, kinds, strict=True)
    ]
    return [column.to_numpy() for column in columns]


def _columns(path: Path, file: parquet.ParquetFile, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    # The size of a single column is not queried: with a damaged footer pyarrow aborts the process there.
    schema, budget, count = _schema(path, file), Budget(path), file.metadata.num_rows
    there = [name for name in dict.fromkeys(wanted) if name in schema.names]
    room: Array | None = None
    for k, name in enumerate(there):
        if schema.names.count(name) > 1:
            raise repeated_name(path, name)
        if not _numeric(schema.field(name).type):
            raise not_numeric(path, name, str(schema.field(name).type))
        budget.take(f"column {name!r}", 8 * count)
        room = np.empty((len(there), count)) if room is None else room
        yield name, _column(file, name, schema.field(name).type, room[k])


def _schema(path: Path, file: parquet.ParquetFile) -> pa.Schema:
    check_members(path, file.metadata.num_columns, "columns")
    return file.schema_arrow


def _numeric(kind: pa.DataType) -> bool:
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _column(file: parquet.ParquetFile, name: str, kind: pa.DataType, room: Array) -> RawChannel:
    """One column, batch by batch, (n,), in its row of `room`; integers stay integers unless one of them is null."""
    column: RawChannel = np.empty(room.size, np.int64) if types.is_integer(kind) else room
    row = 0
    for batch in file.iter_batches(batch_size=BATCH_ROWS, columns=[name], use_threads=False):
        values = batch.column(0).cast(pa.float64()) if types.is_decimal(kind) else batch.column(0)
        if values.null_count and column.dtype != np.float64:
            column = column.astype(np.float64)
        column[row : row + len(values)] = values.to_numpy(zero_copy_only=False)
        row += len(values)
    return column[:row]
