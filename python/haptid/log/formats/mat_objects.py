"""Objects in MAT files: tables, timetables, timeseries, and what Simulink logs.

Tables and timetables are columns, `run.q1`, with the times of the rows in whole nanoseconds, `run.Time`. A timeseries
is `q.Time` and `q.Data`; signals of a Simulink data set are named by themselves, `out.logsout.q1.Data`. Of other
objects the arrays in their properties are channels.
"""

from __future__ import annotations

import importlib.util
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from haptid.errors import LogFileError, MissingDependencyError
from haptid.log.formats.sniff import RawChannel, addresses, channel_list, numeric, opened_file

_KIND = "MAT"
_DEEPEST = 12
# Longest cell array whose elements are looked at.
_MOST_CELLS = 200
# Properties that hold what an object of Simulink is for; others describe the model, the blocks and the run.
_HELD = ("Data", "Values", "Storage_", "Elements", "Elements_", "any")


# Part of the names of what is in a function.
_FUNCTION = ".function_handle."


def objects(path: Path) -> dict[str, RawChannel]:
    """Channels of tables, timetables and other objects, each (n,).

    Raises:
        LogFileError: they are of a kind that is not read.
        MissingDependencyError: the package that reads them is not installed.
    """
    if importlib.util.find_spec("matio") is None:
        raise MissingDependencyError(
            f"{path}: it has tables or other objects of MATLAB, which need a package that is not installed.",
            where="mat-io",
            advice='Install it with `pip install "haptid[lab]"`, or save plain arrays (table2array).',
        )
    found: dict[str, RawChannel] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # units and formats of tables, options of pandas: not about the samples
        import matio

        try:
            loaded = matio.load_from_mat(str(path))
        except Exception as error:  # of any class, over objects that it does not know
            raise unread(path) from error
    with opened_file(path, _KIND):
        for name, value in loaded.items():
            if type(value) is np.ndarray and value.dtype.kind != "M" and value.dtype != object:
                continue  # read as a plain array
            for leaf, array in leaves(str(name), value, 0):
                # A function is saved with all variables that it saw: copies of what is in the file.
                if numeric(array.dtype) and _FUNCTION not in leaf:
                    found |= {channel: array[at] for channel, at in addresses(leaf, array.shape).items()}
    return found


def unread(path: Path) -> LogFileError:
    """Error of a sound file with objects that are not read, with what to write in MATLAB."""
    what = "objects of unknown classes"
    with suppress(Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import matio

        kinds = [f"{name} ({kind})" for name, (_, kind) in matio.whosmat(str(path)).items()]
        what = channel_list(kinds, 6)
    return LogFileError(
        f"{path} is sound, but nothing in it is an array of numbers that haptid reads: {what}.",
        where=path,
        found=what,
        advice="In MATLAB, save the samples as arrays: of a timeseries x `t = x.Time; q = squeeze(x.Data);`, of "
        "Simulink's data set first `x = out.logsout.get('q').Values;`, of a timetable `t = seconds(x.Time); q = x.q;`, "
        "of a sparse matrix `q = full(x);`; then `save('run.mat', 't', 'q', 'tau')`.",
    )


def leaves(name: str, value: Any, depth: int) -> Iterator[tuple[str, RawChannel]]:
    """Arrays in a table, a cell or the properties of an object, with their full names."""
    if depth > _DEEPEST:
        return
    properties = getattr(value, "properties", None)
    if hasattr(value, "columns") and hasattr(value, "index"):
        yield from _table(name, value)
    elif isinstance(properties, Mapping):
        kind = str(value.classname)
        if kind == "timeseries":
            yield from _timeseries(name, properties)
            return
        simulink = kind.startswith("Simulink.")
        for key, inner in properties.items():
            if not simulink:
                yield from leaves(f"{name}.{key}", inner, depth + 1)
            elif key in _HELD:
                yield from leaves(name, inner, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.names is not None and value.size == 1:
        for key in value.dtype.names:
            yield from leaves(f"{name}.{key}", value.flat[0][key], depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        if value.size <= _MOST_CELLS:
            for own, inner in zip(_names(value), value.flat, strict=True):
                yield from leaves(f"{name}{own}", inner, depth + 1)
    elif isinstance(value, np.ndarray):
        yield name, _nanoseconds(value) if value.dtype.kind in "mM" else value


def _table(name: str, table: Any) -> Iterator[tuple[str, RawChannel]]:
    if table.index.dtype.kind in "mM":
        yield f"{name}.{table.index.name or 'Time'}", _nanoseconds(table.index.to_numpy())
    for column in table.columns:
        array = table[column].to_numpy()
        if array.dtype == object and array.size and np.ndim(array[0]) == 1:
            array = np.stack(list(array))
        yield f"{name}.{column}", _nanoseconds(array) if array.dtype.kind in "mM" else array


def _timeseries(name: str, properties: Mapping[str, Any]) -> Iterator[tuple[str, RawChannel]]:
    """Times and samples, which releases of MATLAB keep in different properties; samples of 1 x 1 x n are n."""
    about = _properties(properties.get("TimeInfo"))
    stored = _properties(properties.get("Storage_"))
    held = [properties.get("Time"), properties.get("Time_"), about.get("Time_"), stored.get("Time")]
    time = next((array for array in held if isinstance(array, np.ndarray) and array.size), None)
    data = [properties.get("Data"), properties.get("Data_"), stored.get("Data")]
    samples = next((array for array in data if isinstance(array, np.ndarray) and array.size), None)
    if samples is None:
        return
    samples = samples.squeeze()
    if time is None:
        start, step, length = (_number(about.get(key)) for key in ("Start_", "Increment_", "Length"))
        if length in samples.shape:
            time = start + step * np.arange(int(length))
    if time is not None:
        yield f"{name}.Time", time
    yield f"{name}.Data", samples


def _properties(value: Any) -> Mapping[str, Any]:
    """Of an object; none where it is no object."""
    found = getattr(value, "properties", None)
    return found if isinstance(found, Mapping) else {}


def _number(value: Any) -> float:
    return float(value.flat[0]) if isinstance(value, np.ndarray) and value.size == 1 else float("nan")


def _names(cells: np.ndarray) -> list[str]:
    """How the elements of a cell array are called: `.q1` of signals with a name of their own, else `[2]`."""
    own = []
    for cell in cells.flat:
        name = _properties(cell).get("Name", "")
        text = str(name.flat[0]) if isinstance(name, np.ndarray) and name.size == 1 else ""
        own.append(text.strip())
    several = Counter(own)
    return [f".{text}" if text and several[text] == 1 else f"[{k}]" for k, text in enumerate(own, 1)]


def _nanoseconds(times: RawChannel) -> RawChannel:
    return times.astype("M8[ns]" if times.dtype.kind == "M" else "m8[ns]").astype(np.int64)
