"""Messages of JSON and protobuf as trees of values, decoded one after the other."""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from haptid.errors import MissingDependencyError
from haptid.log.formats.messages.batch import HEADER, MOST_ELEMENTS, Batch, Decoder, Numbers, Samples, Stamp, flatten
from haptid.log.formats.messages.container import Topic

# Names of the parts of a stamp.
_SECONDS, _REST = ("sec", "secs", "seconds"), ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")


class _TreeDecoder(Decoder):
    """Messages that are decoded into values one after the other."""

    @abstractmethod
    def tree(self, message: bytes) -> Mapping[str, Any]:
        """A message as nested values."""

    def decode(self, messages: Sequence[bytes], wanted: set[str] | None) -> Batch:
        batch = Batch(len(messages))
        found: dict[str, tuple[list[int], list[Any]]] = {}
        for row, message in enumerate(messages):
            try:
                leaves = [
                    (name, np.array(value.values, np.float64))
                    if isinstance(value, Samples) and (wanted is None or name in wanted)
                    else (name, value)
                    for name, value in flatten(stamped(self.tree(message)), self.sampled)
                ]
            except (ValueError, TypeError, RecursionError, KeyError, AttributeError):
                batch.other += 1
                continue
            for name, value in leaves:
                if isinstance(value, np.ndarray):
                    batch.samples.setdefault(name, {})[row] = value
                elif isinstance(value, Samples):
                    continue
                elif isinstance(value, Numbers):
                    batch.empty[name] = batch.empty.get(name, 0) + 1
                elif wanted is None or name in wanted or (type(value) is Stamp and HEADER in wanted):
                    batch.stamps |= {name} if type(value) is Stamp else set()
                    rows, values = found.setdefault(name, ([], []))
                    rows.append(row)
                    values.append(value)
        for name, (rows, values) in found.items():
            whole = all(type(v) in (int, Stamp) and abs(v) < 2**63 for v in values)
            batch.put(name, rows, np.array(values, np.int64 if whole else np.float64))
        return batch


def stamped(value: Any, depth: int = 0) -> Any:
    """The same values, with {sec, nanosec} as whole nanoseconds.

    Raises:
        ValueError: nested too deep.
    """
    if depth > 32:
        raise ValueError("values are nested more than 32 deep")
    if isinstance(value, Mapping):
        if len(value) == 2:
            seconds = next((value[k] for k in _SECONDS if k in value), None)
            rest = next((value[k] for k in _REST if k in value), None)
            if type(seconds) is int and type(rest) is int:
                return Stamp(seconds * 10**9 + rest)
        return {key: stamped(inner, depth + 1) for key, inner in value.items()}
    if isinstance(value, list):
        if len(value) > MOST_ELEMENTS:
            return None
        return [stamped(inner, depth + 1) for inner in value]
    return value


class JsonDecoder(_TreeDecoder):
    """JSON: numbers, and stamps as {sec, nsec}."""

    def tree(self, message: bytes) -> Mapping[str, Any]:
        found = json.loads(message)
        if not isinstance(found, dict):
            raise ValueError("a message is not an object")
        return found


class ProtobufDecoder(_TreeDecoder):
    """Protobuf, by the set of descriptors that travels along."""

    def __init__(self, topic: Topic) -> None:
        super().__init__()
        try:
            from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
            from google.protobuf.message import DecodeError
        except ImportError as error:
            raise MissingDependencyError(
                f"topic {topic.name} is encoded by protobuf, which needs a package that is not installed.",
                where="protobuf",
                advice='Install it with `pip install "haptid[ros]"`.',
            ) from error
        files = descriptor_pb2.FileDescriptorSet()
        pool = descriptor_pool.DescriptorPool()
        try:
            files.ParseFromString(topic.definition)
            for file in files.file:
                pool.Add(file) if hasattr(pool, "Add") else pool.AddSerializedFile(file.SerializeToString())
            self.kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(topic.kind))
        except (DecodeError, KeyError, TypeError) as error:
            raise ValueError(f"the descriptors of its type {topic.kind} are wrong ({error})") from error
        self.wrong = DecodeError

    def tree(self, message: bytes) -> Mapping[str, Any]:
        try:
            found = self.kind.FromString(message)
        except self.wrong as error:
            raise ValueError(str(error)) from error
        return _values(found, 0)


@lru_cache(maxsize=256)
def _described(descriptor: Any) -> tuple[tuple[str, bool, bool, bool], ...]:
    """Name of each field, and whether it is repeated, a message, or optional."""
    return tuple(
        (f.name, bool(f.is_repeated), f.message_type is not None, bool(f.has_presence)) for f in descriptor.fields
    )


def _values(message: Any, depth: int) -> dict[str, Any]:
    """Fields of a protobuf message; submessages and optional fields only where they are set."""
    if depth > 32:
        raise ValueError("messages are nested more than 32 deep")
    found: dict[str, Any] = {}
    for name, repeated, nested, optional in _described(message.DESCRIPTOR):
        if optional and not message.HasField(name):
            continue
        value = getattr(message, name)
        if repeated and hasattr(value, "items"):
            found[name] = {str(k): _values(v, depth + 1) if nested else v for k, v in value.items()}
        elif repeated:
            found[name] = [_values(v, depth + 1) for v in value] if nested else list(value)
        else:
            found[name] = _values(value, depth + 1) if nested else value
    return found
