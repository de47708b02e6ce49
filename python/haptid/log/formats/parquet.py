"""Parquet logs: columns of numbers and stamps, fields of structs, elements of lists."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet, types

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.log.formats.arrow import numbers
from haptid.log.formats.sniff import (
    MOST_CHANNELS,
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
# Rows that tell the length of a list.
_TOLD = 1000
# Options of opening: bytes are read as they are needed.
SPARING: dict[str, Any] = {"pre_buffer": False, "buffer_size": 2**20}
# Row groups that are cached: those at both ends of a segment of rows, of positions and of torques.
GROUPS_HELD = 4


# Logs up to this are read as a whole, bytes: Arrow allocates what a page of a file declares, up to 2 GiB.
_SMALL = 2**26


def _opened(path: Path) -> parquet.ParquetFile:
    """A file whose columns will be read."""
    if path.stat().st_size <= _SMALL:
        return parquet.ParquetFile(pa.BufferReader(path.read_bytes()))
    return parquet.ParquetFile(path, **SPARING)


def names(path: Path) -> list[str]:
    """Names of the columns of numbers, fields of structs with points, elements of lists with numbers from 1."""
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), _opened(path) as file:
        _schema(path, file)
        return list(_channels(file))


def units(path: Path) -> dict[str, str]:
    """Units in the metadata of columns, as the virtual bench and others write them: key `unit` or `units`."""
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), parquet.ParquetFile(path) as file:
        stated = {field.name: field.metadata or {} for field in file.schema_arrow}
    made = {name: of.get(b"unit", of.get(b"units", b"")).decode(errors="replace") for name, of in stated.items()}
    return {name: unit for name, unit in made.items() if unit}


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted columns that exist in the file, each (n,), read one after the other; a null is NaN.

    Stamps are whole nanoseconds. A list that is shorter than the first one is NaN in the elements that it lacks.

    Raises:
        LogFileError: a wanted column holds texts, or declares far more rows than its bytes can hold.
    """
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), _opened(path) as file:
        return collect(wanted, _columns(path, file, wanted))


def count(path: Path) -> int:
    """Rows of a file."""
    require(path, _KIND, "Parquet")
    with opened_file(path, _KIND), parquet.ParquetFile(path) as file:
        return int(file.metadata.num_rows)


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
    with opened_file(path, _KIND), _opened(path) as file:
        channels, count = _channels(file), file.metadata.row_group(k).num_rows
        found: dict[str, RawChannel] = {}
        for names in _by_column(wanted, channels).values():
            rooms = [np.empty(count) for _ in names]
            found.update(zip(names, _read(file, [channels[name] for name in names], rooms, [k]), strict=True))
    return [found[name] for name in wanted]


def _by_column(wanted: Iterable[str], channels: Mapping[str, _Place]) -> dict[str, list[str]]:
    """The wanted channels of each column."""
    columns: dict[str, list[str]] = {}
    for name in dict.fromkeys(wanted):
        columns.setdefault(channels[name].column, []).append(name)
    return columns


@dataclass(frozen=True)
class _Place:
    """A channel: its column, the fields of structs that lead to it, its element in a list, and its type."""

    column: str
    fields: tuple[str, ...]
    element: int | None
    kind: pa.DataType


def _channels(file: parquet.ParquetFile) -> dict[str, _Place]:
    """Every channel; the lengths of lists are those of the first row that has one."""
    found: dict[str, _Place] = {}
    for field in file.schema_arrow:
        for fields, kind in _fields(field.type, ()):
            name = ".".join((field.name, *fields))
            if _numeric(kind):
                found.setdefault(name, _Place(field.name, fields, None, kind))
            elif _is_list(kind) and _numeric(kind.value_type):
                for k in range(_length(file, field.name, fields, kind)):
                    found.setdefault(f"{name}[{k + 1}]", _Place(field.name, fields, k, kind.value_type))
    return found


def _fields(kind: pa.DataType, outer: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], pa.DataType]]:
    if types.is_struct(kind) and len(outer) < 8:
        for k in range(kind.num_fields):
            yield from _fields(kind.field(k).type, (*outer, kind.field(k).name))
    else:
        yield outer, kind


def _is_list(kind: pa.DataType) -> bool:
    return bool(types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind))


def _length(file: parquet.ParquetFile, column: str, fields: tuple[str, ...], kind: pa.DataType) -> int:
    """Elements of a list column; 0 where they are too many for channels."""
    if types.is_fixed_size_list(kind):
        length = int(kind.list_size)
    else:
        from pyarrow import compute  # slow to import, and few logs have lists or structs

        length = 0
        for batch in file.iter_batches(batch_size=_TOLD, columns=[column], use_threads=False):
            lengths = compute.drop_null(compute.list_value_length(_inner(batch.column(0), fields)))
            length = lengths[0].as_py() if len(lengths) else 0
            break
    return length if 0 < length <= MOST_CHANNELS else 0


def _inner(values: pa.Array, fields: tuple[str, ...]) -> pa.Array:
    for field in fields:
        from pyarrow import compute  # as above

        values = compute.struct_field(values, field)
    return values


def _taken(values: pa.Array, place: _Place) -> pa.Array:
    """A channel of a column's values."""
    values = _inner(values, place.fields)
    if place.element is not None:
        from pyarrow import compute  # as above

        lengths = compute.list_value_length(values)
        short = compute.less_equal(lengths, place.element)
        if compute.any(short).as_py():
            values = pa.array(
                [None if s else v for v, s in zip(values.to_pylist(), short.to_pylist(), strict=True)], values.type
            )
        values = compute.list_element(values, place.element)
    if types.is_timestamp(place.kind):
        return values.cast(pa.timestamp("ns", place.kind.tz)).cast(pa.int64())
    return values.cast(pa.float64()) if types.is_decimal(place.kind) else values


def _columns(path: Path, file: parquet.ParquetFile, wanted: Sequence[str]) -> Iterator[tuple[str, RawChannel]]:
    # The size of a single column is not queried: with a damaged footer pyarrow aborts the process there.
    schema, budget, count = _schema(path, file), Budget(path), file.metadata.num_rows
    channels = _channels(file)
    there = [name for name in dict.fromkeys(wanted) if name in channels]
    for name in wanted:
        if name in schema.names and name not in channels:
            raise not_numeric(path, name, str(schema.field(schema.names.index(name)).type))
    for name in there:
        place = channels[name]
        if schema.names.count(place.column) > 1:
            raise repeated_name(path, place.column)
        budget.take(f"column {name!r}", 8 * count)
    room = np.empty((len(there), count)) if there else np.empty((0, 0))
    for inner in _by_column(there, channels).values():
        rooms = [room[there.index(name)] for name in inner]
        yield from zip(inner, _read(file, [channels[name] for name in inner], rooms), strict=True)


def _schema(path: Path, file: parquet.ParquetFile) -> pa.Schema:
    check_members(path, file.metadata.num_columns, "columns")
    return file.schema_arrow


def _numeric(kind: pa.DataType) -> bool:
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_timestamp(kind))


def _read(
    file: parquet.ParquetFile, places: Sequence[_Place], rooms: Sequence[Array], groups: list[int] | None = None
) -> list[RawChannel]:
    """Channels of one column, (n,) each, in their rooms; integers stay integers unless one of them is null.

    Batches of all row groups, or of some, are copied one by one: Arrow's own copy of a whole group takes as much again.
    """
    whole = [types.is_integer(place.kind) or types.is_timestamp(place.kind) for place in places]
    out: list[RawChannel] = [np.empty(r.size, np.int64) if w else r for r, w in zip(rooms, whole, strict=True)]
    row = 0
    settings = {"batch_size": BATCH_ROWS, "columns": [places[0].column], "use_threads": False, "row_groups": groups}
    for batch in file.iter_batches(**settings):
        for k, place in enumerate(places):
            values = _taken(batch.column(0), place)
            if values.null_count and out[k].dtype != np.float64:
                out[k] = out[k].astype(np.float64)
            out[k][row : row + len(values)] = numbers(values)
        row += batch.num_rows
    return [column[:row] for column in out]
