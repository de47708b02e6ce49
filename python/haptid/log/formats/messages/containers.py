"""Containers of messages by their content: MCAP, ROS 1 bags and ROS 2 databases."""

from __future__ import annotations

from pathlib import Path

from haptid.log.formats.folders import bag_files
from haptid.log.formats.messages import bag, mcap
from haptid.log.formats.messages.container import Container
from haptid.log.formats.messages.database import Database
from haptid.log.formats.sniff import corrupt, empty


def containers(path: Path) -> list[Container]:
    """The containers of a file, or of a bag's folder in their order."""
    if not path.is_dir():
        return [_container(path)]
    files = bag_files(path)
    if not files:
        raise empty(path, "no .mcap, .db3 or .bag files")
    return [_container(file) for file in files]


def _container(path: Path) -> Container:
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(mcap.MAGIC[:5]):
        return mcap.Mcap(path)
    if head.startswith(bag.MAGIC[:8]):
        return bag.Bag(path)
    if head.startswith(b"SQLite format 3"):
        return Database(path)
    what = "it does not begin like MCAP, a ROS bag or SQLite"
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        what = "the file as a whole is compressed; `zstd -d` unpacks it"
    raise corrupt(path, path.suffix.lstrip("."), what)
