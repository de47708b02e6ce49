"""JSON logs: one record a line, an array of records, an object of arrays, or an array of trials with own arrays.

Channels of records are addressed as those of messages: `joint.position`, `position[elbow]` where the record has as many
`name`s (or `names`, `joint_names`), `joints[elbow].angle` where each struct has a `name`, else `position[1]`. Arrays of
trials follow one another: with times from each trial's start they are segments of one log.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from haptid.log.formats.encoding import opened_text
from haptid.log.formats.sniff import (
    RawChannel,
    addresses,
    check_members,
    collect,
    corrupt,
    not_numeric,
    opened_file,
    require,
)

_KIND = "JSON"
# Records whose structure gives the names of channels, and keys that name the elements of arrays beside them.
_TOLD, _NAMES = 100, ("name", "names", "joint_names")
_DEEPEST = 12
# An array of records is one of trials if two of their arrays are longer than this, and than there are records.
_LONG = 64
# Names of a record's time: a record that has one is a sample, whatever else it holds.
_TIMES = frozenset({"t", "time", "timestamp", "stamp", "secs", "seconds"})
# Steps to a value in a record: a key, a number of an element, the struct of a name, or the place of a name in an array.
_Step = tuple[str, Any]


def names(path: Path) -> list[str]:
    """Names of the channels: those of the first records, or of the arrays of an object."""
    with opened_file(path, _KIND):
        found = _columns_of(path)
        if found is not None:
            return list(found)
        return list(_paths(islice(_records(path), _TOLD)))


def columns(path: Path, wanted: Sequence[str]) -> dict[str, RawChannel]:
    """The wanted channels that the file has, each (n,); NaN where a record lacks one.

    Raises:
        LogFileError: a wanted channel holds something else than numbers.
    """
    with opened_file(path, _KIND):
        found = _columns_of(path)
        if found is not None:
            return collect(wanted, ((name, found[name]) for name in dict.fromkeys(wanted) if name in found))
        paths = _paths(islice(_records(path), _TOLD))
        there = {name: paths[name] for name in dict.fromkeys(wanted) if name in paths}
        values: dict[str, list[Any]] = {name: [] for name in there}
        lists = [(values[name], steps) for name, steps in there.items()]
        for record in _records(path):
            for column, steps in lists:
                column.append(_at(record, steps))
        return collect(wanted, ((name, _array(path, name, column)) for name, column in values.items()))


def _array(path: Path, name: str, values: list[Any]) -> RawChannel:
    """Values as integers where all are, so that stamps keep their digits, else as floats."""
    if all(type(value) is int and abs(value) < 2**63 for value in values):
        return np.array(values, dtype=np.int64)
    other = next((v for v in values if v is not None and (isinstance(v, bool) or not isinstance(v, int | float))), None)
    if other is not None:
        raise not_numeric(path, name, f"{json.dumps(other)[:40]} among numbers")
    return np.array([np.nan if value is None else value for value in values], dtype=float)


def _records(path: Path) -> Iterator[Any]:
    """Records of lines, or of an array."""
    require(path, _KIND, "text", "UTF-16 text")
    with opened_text(path) as file:
        if _by_lines(path):
            for number, line in enumerate(file, 1):
                if not line.strip():
                    continue
                try:
                    yield json.loads(line)
                except ValueError as error:
                    if next((rest for rest in file if rest.strip()), None) is None:
                        return  # the last line of a recorder that was stopped
                    raise corrupt(path, _KIND, f"line {number}: {error}") from None
        else:
            whole = json.load(file)
            yield from whole if isinstance(whole, list) else ()


def _by_lines(path: Path) -> bool:
    """Whether the first line is a record by itself, and not the whole file."""
    with opened_text(path) as file:
        first = next((line for line in file if line.strip()), "")
        try:
            return isinstance(json.loads(first), dict) and (
                path.suffix != ".json" or any(line.strip() for line in file)
            )
        except ValueError:
            return False


def _columns_of(path: Path) -> dict[str, RawChannel] | None:
    """Channels of an object of arrays, or of an array of arrays; None for records."""
    require(path, _KIND, "text", "UTF-16 text")
    if _by_lines(path):
        return None
    with opened_text(path) as file:
        whole = json.load(file)
    if isinstance(whole, list) and (not whole or isinstance(whole[0], dict)) and not _are_trials(whole):
        return None
    found: dict[str, RawChannel] = {}
    _gather(path, "column" if isinstance(whole, list) and not _are_trials(whole) else "", whole, found, 0)
    check_members(path, len(found), "arrays")
    return found


def _gather(path: Path, name: str, value: Any, found: dict[str, RawChannel], depth: int) -> None:
    """Add the channels of a value: of an object's arrays, and of arrays of records in it."""
    if isinstance(value, dict) and depth < _DEEPEST:
        for key, inner in value.items():
            _gather(path, f"{name}.{key}" if name else key, inner, found, depth + 1)
    elif _are_trials(value) and depth < _DEEPEST:
        trials: list[dict[str, RawChannel]] = []
        for trial in value:
            trials.append({})
            _gather(path, name, trial, trials[-1], depth + 1)
        for channel in trials[0]:
            if all(channel in trial for trial in trials):
                found[channel] = np.concatenate([trial[channel] for trial in trials])
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        for inner, steps in _paths(value[:_TOLD]).items():
            found[f"{name}.{inner}"] = _array(path, f"{name}.{inner}", [_at(record, steps) for record in value])
    elif isinstance(value, list) and value:
        try:
            array = (
                np.array([[np.nan if x is None else x for x in row] for row in value])
                if isinstance(value[0], list)
                else np.array([np.nan if x is None else x for x in value])
            )
        except (ValueError, TypeError):  # rows of unequal length, or arrays of arrays
            return
        if array.dtype.kind in "iuf":
            found |= {channel: array[at] for channel, at in addresses(name, array.shape).items()}


def _are_trials(value: Any) -> bool:
    """Whether a value is an array of few records with long arrays of samples, and not of samples."""
    if not (isinstance(value, list) and value and all(isinstance(trial, dict) for trial in value)):
        return False
    if any(key.lower() in _TIMES and isinstance(inner, int | float) for key, inner in value[0].items()):
        return False
    return max(map(_longest, value)) > max(_LONG, len(value))


def _longest(trial: Mapping[str, Any]) -> int:
    """Length of a record's longest arrays, of which it has two, or of its longest array of records."""
    lists = [inner for inner in _leaves(trial) if isinstance(inner, list) and inner]
    sizes = sorted((len(inner) for inner in lists if not isinstance(inner[0], dict)), reverse=True)
    own = max((len(inner) for inner in lists if isinstance(inner[0], dict)), default=0)
    return max(own, sizes[0] if sizes[1:] and sizes[0] == sizes[1] else 0)


def _leaves(value: Any, depth: int = 0) -> Iterator[Any]:
    if isinstance(value, dict) and depth < _DEEPEST:
        for inner in value.values():
            yield from _leaves(inner, depth + 1)
    else:
        yield value


def _paths(records: Iterator[Any] | Sequence[Any]) -> dict[str, tuple[_Step, ...]]:
    """Steps to every channel of some records, by name."""
    found: dict[str, tuple[_Step, ...]] = {}
    for record in records:
        _walk("", record, (), found)
    return found


def _walk(name: str, value: Any, steps: tuple[_Step, ...], found: dict[str, tuple[_Step, ...]]) -> None:
    if len(steps) > _DEEPEST:
        return
    if isinstance(value, dict):
        for key, inner in value.items():
            inside = f"{name}.{key}" if name else key
            labels = _labels(value, key, inner)
            if labels is not None:
                other, texts = labels
                for text, x in zip(texts, inner, strict=True):
                    _walk(f"{inside}[{text}]", x, (*steps, ("of", (key, other, text))), found)
            else:
                _walk(inside, inner, (*steps, ("key", key)), found)
    elif isinstance(value, list):
        named = bool(value) and all(isinstance(x, dict) and isinstance(x.get("name"), str) for x in value)
        for k, x in enumerate(value):
            step = ("struct", x["name"]) if named else ("element", k)
            _walk(f"{name}[{x['name'] if named else k + 1}]", x, (*steps, step), found)
    elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        found.setdefault(name, steps)


def _labels(record: Mapping[str, Any], key: str, value: Any) -> tuple[str, list[str]] | None:
    """The key of the names of an array's elements, and these; None where it has none."""
    if key in _NAMES or not isinstance(value, list) or not value:
        return None
    for other in _NAMES:
        texts = record.get(other)
        if isinstance(texts, list) and len(texts) == len(value) and all(isinstance(x, str) for x in texts):
            return other, texts
    return None


def _at(record: Any, steps: tuple[_Step, ...]) -> Any:
    """The value at the end of steps; None where the record lacks it."""
    value = record
    try:
        for kind, where in steps:
            if kind == "struct":
                value = next(x for x in value if x["name"] == where)
            elif kind == "of":
                key, other, text = where
                value = value[key][value[other].index(text)]
            else:
                value = value[where]
    except (KeyError, IndexError, TypeError, ValueError, StopIteration):
        return None
    return value
