"""LeRobot data sets, versions 2 and 3: tables of frames with list columns, episodes one after the other.

Elements are named as the description of the data set names them, `observation.state[elbow.pos]`, or by number from 1.
The channel `time` counts frames at the data set's rate, with a pause between episodes, so that each is a segment of its
own; the stored `timestamp` begins again in every episode and is in single precision.

Source: LeRobot data set format 3.0 and 2.1 (huggingface.co/docs/lerobot/lerobot-dataset-v3).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.late import dataclass
from haptid._internal.numerals import whole_number
from haptid.errors import LogFileError
from haptid.log.formats import parquet
from haptid.log.formats.folders import data_set_files
from haptid.log.formats.sniff import RawChannel, corrupt, empty, opened_file
from haptid.log.request import Request

_KIND = "LeRobot"
TIME = "time"
_EPISODE, _FRAME = "episode_index", "frame_index"
# Pause between episodes, s, and in frames: longer than any gap that is bridged.
_PAUSE, _PAUSE_FRAMES = 1.0, 20
_MOST_INFO = 2**24


@dataclass(frozen=True)
class Description:
    """What `meta/info.json` says.

    Attributes:
        fps: frames per second.
        elements: names of the elements of a feature, where it has any.
        tables: files of frames, in order.
    """

    fps: float
    elements: dict[str, tuple[str, ...]]
    tables: tuple[Path, ...]

    def plain(self, name: str) -> str:
        """Name of a channel in the tables, where elements are numbered."""
        feature, bracket, element = name.removesuffix("]").partition("[")
        if bracket and element in self.elements.get(feature, ()):
            return f"{feature}[{self.elements[feature].index(element) + 1}]"
        return name


def describe(folder: Path) -> Description:
    """The description of a data set.

    Raises:
        LogFileError: it is not JSON, has no rate, or there are no tables.
    """
    info, *tables = data_set_files(folder)
    if not tables:
        raise empty(folder, "no data/*/*.parquet")
    if info.stat().st_size > _MOST_INFO:
        raise corrupt(folder, _KIND, f"meta/info.json has {info.stat().st_size} bytes")
    with opened_file(folder, _KIND):
        fps, features = _stated(json.loads(info.read_text(encoding="utf-8")))
        elements = {str(key): found for key, value in features.items() if (found := _elements(value))}
    return Description(fps, elements, tuple(tables))


def _stated(info: Any) -> tuple[float, dict[str, Any]]:
    """Frames per second, and the features by name, that an `info.json` states.

    Raises:
        ValueError: it has another structure, or no rate that a recording has.
    """
    if not isinstance(info, dict):
        raise ValueError("meta/info.json is no object")
    fps, features = info.get("fps"), info.get("features") or {}
    if not isinstance(fps, int | float | str) or not 0 < float(fps) < 1e6:
        raise ValueError(f"fps is {json.dumps(fps)[:40]}")
    if not isinstance(features, dict):
        raise ValueError("the features are no object")
    return float(fps), features


def _elements(feature: Any) -> tuple[str, ...]:
    """Names of a feature's elements: a list, or a dictionary with one; none where they are not those of its shape."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return ()
    fits = feature.get("shape") == [len(names)] and len(set(names)) == len(names)
    return tuple(names) if fits else ()


def names(folder: Path) -> list[str]:
    """Names of the channels, elements by their names."""
    about = describe(folder)
    found = [TIME]
    for name in parquet.names(about.tables[0]):
        feature, bracket, number = name.removesuffix("]").rpartition("[")
        inner = about.elements.get(feature, ())
        element = whole_number(number) if bracket else None
        found.append(f"{feature}[{inner[element - 1]}]" if element and element <= len(inner) else name)
    return found


def columns(folder: Path, wanted: Sequence[str], request: Request) -> dict[str, RawChannel]:
    """The wanted channels of the wanted episodes, each (n,).

    Raises:
        LogFileError: a table cannot be read, or a wanted episode is not there.
    """
    about = describe(folder)
    plain = {name: about.plain(name) for name in wanted if name != TIME}
    parts: dict[str, list[RawChannel]] = {name: [] for name in plain}
    episodes, frames, seen = [], [], set[int]()
    for table, own, kept in _tables(about, [*plain.values()], request, seen):
        for name, inner in plain.items():
            if inner in table:
                parts[name].append(table[inner][kept])
        episodes.append(own[kept])
        frames.append(table[_FRAME][kept] if _FRAME in table else np.arange(own.size)[kept])
    absent = [] if request.episodes is None else sorted(set(request.episodes) - seen)
    if absent:
        raise LogFileError(
            f"{folder} has no episode {absent[0]}; it has {len(seen)} from {min(seen)} to {max(seen)}.",
            where="episodes",
            found=tuple(absent),
            limit=(min(seen), max(seen)),
            advice="Episodes are counted from 0.",
        )
    whole = [name for name, pieces in parts.items() if len(pieces) == len(episodes)]
    out = {name: np.concatenate(parts[name]) for name in whole}
    every, counted = np.concatenate(episodes), np.concatenate(frames)
    request.notes.append(f"{np.unique(every).size} episodes of {every.size} frames at {about.fps:g} Hz")
    if TIME in wanted:
        out[TIME] = _times(every, counted, about.fps)
    return {name: out[name] for name in wanted if name in out}


def _tables(
    about: Description, inner: Sequence[str], request: Request, seen: set[int]
) -> Iterator[tuple[dict[str, RawChannel], RawChannel, RawChannel]]:
    """The tables that have wanted rows, episode of each row, and which are wanted."""
    for path in about.tables:
        (own,) = parquet.columns(path, [_EPISODE]).values() or (np.zeros(0, np.int64),)
        seen.update(np.unique(own).tolist())
        kept = np.ones(own.size, bool) if request.episodes is None else np.isin(own, request.episodes)
        if kept.any():
            yield parquet.columns(path, [*dict.fromkeys([*inner, _FRAME])]), own, kept


def _times(episodes: RawChannel, frames: RawChannel, fps: float) -> RawChannel:
    """Times of the frames, s; episodes follow one another with a pause."""
    first = np.flatnonzero(np.diff(episodes, prepend=episodes[0] - 1))
    length = np.diff(np.append(first, episodes.size))
    pause = max(_PAUSE_FRAMES, int(np.ceil(_PAUSE * fps)))
    last = frames[first + length - 1] - frames[first]
    begin = np.concatenate([[0], np.cumsum(last + pause)[:-1]])
    return np.asarray((np.repeat(begin - frames[first], length) + frames) / fps)
