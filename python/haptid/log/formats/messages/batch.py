"""Channels of messages: values of each by their paths in a message, and the protocol of a decoder.

A channel's name in a message is its path, `position[elbow]`: elements of an array are named after the texts of a
sibling array of the same length (`name` of a JointState), structs in an array after their own `name`, others by numbers
from 1. So a joint is found by its name in every message, wherever it stands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haptid.log.formats.sniff import MOST_CHANNELS

# Values of one message that are named; elements of an array that are not numbers.
MOST_LEAVES, MOST_ELEMENTS = 4096, 4096
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
    """

    count: int
    values: dict[str, NDArray[Any]] = field(default_factory=dict)
    present: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    empty: dict[str, int] = field(default_factory=dict)
    stamps: set[str] = field(default_factory=set)
    other: int = 0

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


class Decoder(ABC):
    """Decodes the messages of one channel of a container."""

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


def flatten(tree: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Channels of a message: name and value; an array without elements is itself the value.

    Args:
        tree: values by name, nested; arrays are sequences or `Numbers`.

    Raises:
        ValueError: more than `MOST_LEAVES`.
    """
    for count, leaf in enumerate(_flatten("", tree)):
        if count >= MOST_LEAVES:
            raise ValueError(f"more than {MOST_LEAVES} values in a message")
        yield leaf


def _flatten(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        labels = {len(v): v for v in reversed([*value.values()]) if _texts(v)}
        for key, inner in value.items():
            path = f"{name}.{key}" if name else str(key)
            if isinstance(inner, list | Numbers):
                yield from _elements(path, inner, labels.get(len(inner)))
            else:
                yield from _flatten(path, inner)
    elif isinstance(value, tuple | int | float):
        yield name, value


def _texts(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(v, str) for v in value)


def _elements(path: str, array: list[Any] | Numbers, labels: list[str] | None) -> Iterator[tuple[str, Any]]:
    if len(array) == 0:
        yield path, array if isinstance(array, Numbers) else Numbers(0, 0, 0, "")
    elif len(array) <= MOST_CHANNELS and not _texts(array):
        own = [v.get("name") if isinstance(v, Mapping) else None for v in (array[k] for k in range(len(array)))]
        if labels is None and all(isinstance(v, str) and v for v in own):
            labels = [str(v) for v in own]
        if labels is not None and len(set(labels)) < len(labels):
            labels = None  # a joint named twice: which is meant is not known
        for k in range(len(array)):
            yield from _flatten(f"{path}[{labels[k] if labels else k + 1}]", array[k])
