"""ROS 2 databases (db3): messages as rows of SQLite.

Source: rosbag2_storage_sqlite3.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator

from haptid.log.formats.messages.container import MOST_CHUNK, Container, Messages, Topic
from haptid.log.formats.messages.definitions import COMMON
from haptid.log.formats.sniff import corrupt, opened_file

# Messages that are taken from a database at once.
_ROWS = 1000


class Database(Container):
    """ROS 2 database (db3). Definitions of common types are known where it has none (before ROS 2 Iron)."""

    def messages(self, wanted: Collection[str] | None = None) -> Iterator[Messages]:
        with opened_file(self.path, "ROS 2 database"):
            uri = f"{self.path.resolve().as_uri()}?mode=ro&immutable=1"
            base = sqlite3.connect(uri, uri=True)
        try:
            with opened_file(self.path, "ROS 2 database"):
                base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_CHUNK)
                base.execute("PRAGMA trusted_schema = OFF")
                self._topics(base)
            keep = self._of(wanted)
            marks = "" if keep is None else f"WHERE topic_id IN ({','.join(map(str, keep))})"
            rows = base.execute(f"SELECT topic_id, timestamp, data FROM messages {marks} ORDER BY rowid")
            count = 0
            try:
                while some := rows.fetchmany(_ROWS):
                    count += len(some)
                    for channel in self.topics:
                        own = [(t, d) for c, t, d in some if c == channel and type(t) is int and type(d) is bytes]
                        if own:
                            yield channel, [t for t, _ in own], [d for _, d in own]
            except sqlite3.DatabaseError as error:
                if not count:
                    raise corrupt(self.path, "ROS 2 database", str(error)) from error
                self._note(f"{self.path.name} is damaged or cut short: the {count} messages before are used")
        finally:
            base.close()

    def _topics(self, base: sqlite3.Connection) -> None:
        tables = {name for name, kind in base.execute("SELECT name, type FROM sqlite_master") if kind == "table"}
        if not {"topics", "messages"} <= tables:
            raise corrupt(self.path, "ROS 2 database", "it has no tables `topics` and `messages`")
        stored: dict[str, str | bytes] = {}
        if "message_definitions" in tables:
            stored = dict(base.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
        for channel, name, kind, encoding in base.execute("SELECT id, name, type, serialization_format FROM topics"):
            found = stored.get(kind) or COMMON.get(str(kind).replace("/msg/", "/"), "")
            definition = found if isinstance(found, bytes) else str(found).encode()  # or a BLOB
            if type(channel) is not int:
                raise corrupt(self.path, "ROS 2 database", f"the id of topic {name!r} is {channel!r}")
            self._topic(channel, Topic(str(name), str(kind), str(encoding), definition, "ros2msg"))
