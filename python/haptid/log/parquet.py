"""Parquet logs: one column of numbers for each channel."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet, types

from haptid.errors import NotNumericError, RepeatedNameError
from haptid.log.content import Column, guard, opened, require

KIND = "Parquet"


def names(path: Path) -> list[str]:
    """Names of the columns of numbers."""
    require(path, KIND, "Parquet")
    with opened(path, KIND), parquet.ParquetFile(path) as file:
        return [field.name for field in file.schema_arrow if _numeric(field.type)]


def columns(path: Path, wanted: Sequence[str]) -> dict[str, Column]:
    """Those wanted columns that the file has, each (n,), read one after the other; a null is NaN.

    Raises:
        NotNumericError: a wanted column holds texts, dates or lists.
        OversizedLogError: a column declares far more rows than its bytes can be taken to hold.
    """
    require(path, KIND, "Parquet")
    out: dict[str, Column] = {}
    with opened(path, KIND), parquet.ParquetFile(path) as file:
        schema, stored = file.schema_arrow, _stored(file.metadata)
        for name in wanted:
            if name not in schema.names or name in out:
                continue
            if schema.names.count(name) > 1:
                raise RepeatedNameError(path, name)
            if not _numeric(schema.field(name).type):
                raise NotNumericError(path, name, str(schema.field(name).type))
            guard(path, f"column {name!r}", 8 * file.metadata.num_rows, stored.get(name, 0))
            out[name] = _column(file, name)
    return out


def _numeric(kind: pa.DataType) -> bool:
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _stored(metadata: parquet.FileMetaData) -> dict[str, int]:
    """Compressed bytes of each column over all row groups."""
    stored: dict[str, int] = {}
    for group in range(metadata.num_row_groups):
        for k in range(metadata.num_columns):
            chunk = metadata.row_group(group).column(k)
            stored[chunk.path_in_schema] = stored.get(chunk.path_in_schema, 0) + chunk.total_compressed_size
    return stored


def _column(file: parquet.ParquetFile, name: str) -> Column:
    chunked = file.read(columns=[name], use_threads=False).column(0)
    if types.is_decimal(chunked.type) or (chunked.null_count and types.is_integer(chunked.type)):
        chunked = chunked.cast(pa.float64())
    return np.asarray(chunked.to_numpy())
