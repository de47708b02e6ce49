"""Channels with stamps of their own on the rows of another one: topics of a log, and tables that several sources wrote.

Programs that save several topics as one table (PlotJuggler, an outer join) write a row for every message, in which the
cells of all other topics are empty; so do recorders of a bus, with a row for every answer of a drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.late import dataclass
from haptid.log.formats.sniff import RawChannel, channel_list
from haptid.log.request import Merge

# Longest gap over which another topic is merged, in its own usual steps.
_LARGEST_GAP = 4.0
# Times beyond this are no nanoseconds in 64 bits, s.
LATEST = 9e9
# Share of a step by which times of two sources differ at most that are the same.
SAME_TIMES = 1e-3
# Least share of a table's rows without a channel, between its first and last value: fewer empty cells are a defect.
SPARSE = 0.02


@dataclass
class Stream:
    """Channels with common rows.

    Attributes:
        topic: name.
        receive, header: stamps, ns; header None where the messages have none.
        values: of each channel, by its full name.
    """

    topic: str
    receive: NDArray[np.int64]
    header: NDArray[np.int64] | None
    values: dict[str, NDArray[Any]]


def common_rows(
    columns: Mapping[str, RawChannel], time: str, scale: float, first: Sequence[str], merge: Merge, notes: list[str]
) -> dict[str, RawChannel]:
    """Columns of a table on the rows of its positions, where other sources have rows of their own.

    Rows without a position are left out, and the other channels are merged by time. A table of few empty cells is
    returned as it is: a cell that is missing among its neighbours is a defect, for which another check is there.

    Args:
        columns: of the table, (rows,) each.
        time: name of the times among them.
        scale: s in one unit of the times.
        first: names of the positions, of which the first has the rows.
        merge: how the others come to these rows.
        notes: appended to.
    """
    there = {name: ~np.isnan(column) for name, column in columns.items() if column.dtype.kind == "f"}
    # A defect, for which another check is there: the unit is put on the limit, and times are made s where all are below
    # it, since a product with what a flipped bit made may overflow.
    if not (np.abs(columns[time]) < LATEST / scale).all():
        return dict(columns)
    streams: list[tuple[NDArray[np.bool_], list[str]]] = []
    for name in (*first, *(name for name in columns if name not in first and name != time)):
        present = there.get(name, np.ones(columns[name].size, bool))
        if not present.any() or not _sparse(present):
            return dict(columns)
        same = next((names for rows, names in streams if np.array_equal(rows, present)), None)
        if same is None:
            streams.append((present, [name]))
        else:
            same.append(name)
    base, base_names = streams[0]
    if (base.all() and len(streams) == 1) or not base.any():
        return dict(columns)
    stamps = np.rint((columns[time] - columns[time][base][0]) * scale * 1e9).astype(np.int64)
    out = {name: columns[name][base] for name in (time, *base_names)}
    keep = np.ones(int(base.sum()), bool)
    if not base.all():
        notes.append(
            f"{int(base.sum())} of {base.size} rows have {channel_list(base_names, 8)}: the others are left out"
        )
    for own, names in streams[1:]:
        stream = Stream("", stamps[own], None, {name: columns[name][own] for name in names})
        found, usable, sentence = at_stamps(merge, stamps[base], stream.receive, stream)
        out |= found
        keep &= usable
        notes.append(sentence)
    if not keep.any():
        return dict(columns)
    return {name: out[name][keep] for name in columns}


def _sparse(present: NDArray[np.bool_]) -> bool:
    """Whether the empty cells of a channel are those of rows of other sources, or before and after all of its own."""
    inner = present[int(np.argmax(present)) : present.size - int(np.argmax(present[::-1]))]
    return bool(inner.all() or np.count_nonzero(~inner) >= SPARSE * inner.size)


def at_stamps(
    merge: Merge, stamps: NDArray[np.int64], own: NDArray[np.int64], stream: Stream
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_], str]:
    """Channels of another stream at given stamps, where they are known, and a sentence."""
    method = merge.method
    if own.size and np.any(np.diff(own) < 0):
        order = np.argsort(own, kind="stable")
        own = own[order]
        stream.values = {name: values[order] for name, values in stream.values.items()}
    steps = np.diff(own)
    usual = float(np.median(steps)) if steps.size else 0.0
    limit = _LARGEST_GAP * usual if merge.largest_gap is None else 1e9 * merge.largest_gap
    after = np.searchsorted(own, stamps, "left" if method == "linear" else "right")
    before = np.clip(after - 1, 0, max(own.size - 1, 0))
    after = np.clip(after, 0, max(own.size - 1, 0))
    behind, ahead = (stamps - own[before]).astype(np.float64), (own[after] - stamps).astype(np.float64)
    if method == "hold":
        found = {name: values[before] for name, values in stream.values.items()}
        usable, age = (behind >= 0) & (behind <= limit), behind
    elif method == "nearest":
        closer = np.where(np.abs(behind) <= np.abs(ahead), before, after)
        found = {name: values[closer] for name, values in stream.values.items()}
        age = np.abs((stamps - own[closer]).astype(np.float64))
        usable = age <= limit
    else:
        span = behind + ahead
        exact = ahead == 0
        weight = np.where(exact, 1.0, behind / np.where(span > 0, span, 1.0))
        found = {
            name: values[before] + weight * (values[after] - values[before]) for name, values in stream.values.items()
        }
        usable, age = exact | ((behind >= 0) & (ahead >= 0) & (span <= limit)), np.where(exact, 0.0, behind)
    lost = int(np.count_nonzero(~usable))
    typical = float(np.median(age[usable])) if usable.any() else float("nan")
    sentence = (
        f"{channel_list(list(stream.values), 8)} merged by time ({method}): {own.size} samples on {stamps.size} rows, "
        f"usual step {1e-6 * usual:.4g} ms, median age {1e-6 * typical:.3g} ms"
    )
    if lost:
        sentence += f"; {lost} rows without a value within {1e-6 * limit:.4g} ms are left out"
    return found, usable, sentence
