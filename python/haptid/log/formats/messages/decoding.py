"""The decoder of a topic by its encoding."""

from __future__ import annotations

from haptid.log.formats.messages.batch import Decoder
from haptid.log.formats.messages.container import Topic
from haptid.log.formats.messages.ros import RosDecoder
from haptid.log.formats.messages.trees import JsonDecoder, ProtobufDecoder


def decoder_of(topic: Topic) -> Decoder:
    """The decoder of a topic.

    Raises:
        ValueError: its encoding is not known, or its definition is missing or wrong.
    """
    if topic.encoding in ("cdr", "ros1"):
        if topic.schema not in ("ros2msg", "ros1msg", ""):
            raise ValueError(f"its type {topic.kind} is defined as {topic.schema!r}; ros2msg and ros1msg are read")
        if not topic.definition:
            raise ValueError(f"the definition of its type {topic.kind} does not travel along and is not a common one")
        return RosDecoder(topic.definition.decode(errors="replace"), topic.kind, topic.encoding == "cdr")
    if topic.encoding == "json":
        return JsonDecoder()
    if topic.encoding == "protobuf":
        return ProtobufDecoder(topic)
    raise ValueError(f"its encoding {topic.encoding!r} is not read; cdr, ros1, protobuf and json are")
