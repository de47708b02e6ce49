"""Channels of messages: values of each by their paths in a message, and the protocol of a decoder.

A channel's name in a message is its path, `position[elbow]`: elements of an array are named after the texts of a
sibling array of the same length (`name` of a JointState), structs in an array after their own `name`, others by numbers
from 1. So a joint is found by its name in every message, wherever it stands.

Long arrays of one length beside each other, and long arrays of structs, are consecutive samples: `position` is then one
channel, of which a message has many.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid._internal.late import dataclass
from haptid.log.formats.sniff import MOST_CHANNELS

# Values of one message that are named; elements of an array that are not numbers.
MOST_LEAVES, MOST_ELEMENTS = 4096, 4096
# Elements from which on an array holds samples and not joints.
_LEAST_SAMPLES = 64
# Names of the joints of a `trajectory_msgs/JointTrajectory`.
_JOINTS = "joint_names"
# Wanted of a topic: its stamps, whatever their name.
HEADER = "@header"


class Stamp(int):
    """A stamp, in ns."""


@dataclass
class Batch:
    """Channels of consecutive messages of one topic.

    Attributes:
        count: messages.
        values: of each channel, (count,); int64 for stamps and 64-bit integers, otherwise float64.
        present: where a message has the channel, (count,).
        empty: arrays without elements, and in how many messages.
        stamps: channels that are stamps, in ns.
        other: messages that could not be decoded.
        samples: channels of which a message has several samples, (samples,) of each message by its number.
    """

    count: int
    values: dict[str, NDArray[Any]] = field(default_factory=dict)
    present: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    empty: dict[str, int] = field(default_factory=dict)
    stamps: set[str] = field(default_factory=set)
    other: int = 0
    samples: dict[str, dict[int, NDArray[Any]]] = field(default_factory=dict)

    def put(self, name: str, rows: Any, values: NDArray[Any]) -> None:
        """Values of a channel in some of the messages."""
        exact = values.dtype.kind in "iu" and values.dtype.itemsize == 8
        kept = values.astype(np.int64 if exact else np.float64)
        if name not in self.values:
            self.values[name] = np.zeros(self.count, kept.dtype)
            self.present[name] = np.zeros(self.count, bool)
        elif self.values[name].dtype != kept.dtype:
            self.values[name] = self.values[name].astype(np.float64)
        self.values[name][rows] = kept
        self.present[name][rows] = True

    def by_samples(self) -> tuple[Batch, NDArray[np.intp]]:
        """The same with a row for every sample, and the rows of each message, (count,); other channels are repeated."""
        rows = np.ones(self.count, np.intp)
        for own in self.samples.values():
            for k, column in own.items():
                rows[k] = max(rows[k], column.size)
        if not self.samples:
            return self, rows
        values = {name: np.repeat(whole, rows) for name, whole in self.values.items()}
        present = {name: np.repeat(whole, rows) for name, whole in self.present.items()}
        made = replace(self, count=int(rows.sum()), values=values, present=present, samples={})
        begin = np.cumsum(rows) - rows
        for name, own in self.samples.items():
            at = np.concatenate([begin[k] + np.arange(column.size) for k, column in own.items()])
            made.put(name, at, np.concatenate(list(own.values())))
        return made, rows


class Decoder(ABC):
    """Decodes the messages of one channel of a container.

    Attributes:
        sampled: arrays that held samples in a message, see `flatten`.
    """

    def __init__(self) -> None:
        self.sampled: set[str] = set()

    @abstractmethod
    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        """The wanted channels of some messages, all where None."""


@dataclass(frozen=True)
class Numbers:
    """An array of numbers in the bytes of a message."""

    count: int
    begin: int
    size: int
    kind: str

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> tuple[int, str]:
        return self.begin + k * self.size, self.kind


@dataclass(frozen=True)
class Samples:
    """Consecutive samples of one channel in a message.

    Attributes:
        values: numbers, or where they are in its bytes.
    """

    values: Sequence[Any]


def flatten(tree: Mapping[str, Any], sampled: set[str] | None = None) -> Iterator[tuple[str, Any]]:
    """Channels of a message: name and value, or `Samples`; an array without elements is itself the value.

    Args:
        tree: values by name, nested; arrays are sequences or `Numbers`.
        sampled: arrays that held samples in another message of the topic, as a last message may have few; added to.

    Raises:
        ValueError: more than `MOST_LEAVES`.
    """
    for count, leaf in enumerate(_flatten("", tree, set() if sampled is None else sampled)):
        if count >= MOST_LEAVES:
            raise ValueError(f"more than {MOST_LEAVES} values in a message")
        yield leaf


def _flatten(name: str, value: Any, sampled: set[str], joints: Sequence[str] = ()) -> Iterator[tuple[str, Any]]:
    """The same of a part of a message, where the arrays of a trajectory's points are those of joints named above."""
    if isinstance(value, Mapping):
        joints = value[_JOINTS] if _texts(value.get(_JOINTS)) else joints
        labels = {len(v): v for v in reversed([*value.values()]) if _texts(v)}
        equal = Counter(len(v) for v in value.values() if _is_long(v) and len(v) not in labels)
        for key, inner in value.items():
            path = f"{name}.{key}" if name else str(key)
            if isinstance(inner, list | Numbers):
                long = _is_long(inner) and (equal[len(inner)] > 1 or isinstance(inner[0], Mapping))
                if long or (path in sampled and len(inner)):
                    sampled.add(path)
                    yield from _samples(path, inner, joints)
                else:
                    named = labels.get(len(inner)) or (joints if len(inner) == len(joints) else None)
                    yield from _elements(path, inner, named, sampled, joints)
            else:
                yield from _flatten(path, inner, sampled, joints)
    elif isinstance(value, tuple | int | float):
        yield name, value


def _texts(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) for v in value)


def _is_long(value: Any) -> bool:
    """Whether an array holds samples, by its length; bytes are a picture, and structs with names are joints."""
    if isinstance(value, Numbers):
        return len(value) >= _LEAST_SAMPLES and value.size > 1
    if not isinstance(value, list) or len(value) < _LEAST_SAMPLES:
        return False
    return not isinstance(value[0], str | list) and not (isinstance(value[0], Mapping) and "name" in value[0])


def _samples(path: str, array: Any, joints: Sequence[str]) -> Iterator[tuple[str, Samples]]:
    """Samples of an array of numbers, or of each number in an array of structs of one form."""
    if not isinstance(array[0], Mapping):
        yield path, Samples(array)
        return
    each = [dict(_flatten("", element, set(), joints)) for element in array]
    for name in each[0]:
        if all(name in one and not isinstance(one[name], Samples | Numbers) for one in each):
            yield f"{path}.{name}", Samples([one[name] for one in each])


def _elements(
    path: str, array: list[Any] | Numbers, labels: Sequence[str] | None, sampled: set[str], joints: Sequence[str]
) -> Iterator[tuple[str, Any]]:
    if len(array) == 0:
        yield path, array if isinstance(array, Numbers) else Numbers(0, 0, 0, "")
    elif len(array) <= MOST_CHANNELS and not _texts(array):
        own = [v.get("name") if isinstance(v, Mapping) else None for v in (array[k] for k in range(len(array)))]
        if labels is None and all(isinstance(v, str) and v for v in own):
            labels = [str(v) for v in own]
        if labels is not None and len(set(labels)) < len(labels):
            labels = None  # a joint named twice: which is meant is not known
        for k in range(len(array)):
            yield from _flatten(f"{path}[{labels[k] if labels else k + 1}]", array[k], sampled, joints)
