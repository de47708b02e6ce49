"""Logs of messages and data sets as their own writers make them, for tests and benchmarks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore

STORE, STORE1 = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
START = 1_700_000_000_123_456_789
# Topic, receive stamp ns, type, message.
Said = tuple[str, int, str, Any]


def joint_state(
    stamp: int, names: Sequence[str], position: Any, effort: Any = (), velocity: Any = (), store: Any = STORE
) -> Any:
    """A JointState; header stamps in ns."""
    types = store.types
    more = {"seq": 0} if store is STORE1 else {}
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="base", **more)
    arrays = (np.ascontiguousarray(a, np.float64) for a in (position, velocity, effort))
    return types["sensor_msgs/msg/JointState"](header, list(names), *arrays)


def ros2(path: Path, said: Iterable[Said], plugin: str = "mcap") -> Path:
    """A ROS 2 bag's folder, as MCAP or db3; returns its only file of messages."""
    storage = StoragePlugin.MCAP if plugin == "mcap" else StoragePlugin.SQLITE3
    with Bag2Writer(path, version=8, storage_plugin=storage) as writer:
        known: dict[str, Any] = {}
        for topic, stamp, kind, message in said:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], stamp, STORE.serialize_cdr(message, kind))
    return next(file for file in path.iterdir() if file.suffix in (".mcap", ".db3"))


def ros1(path: Path, said: Iterable[Said], compression: str = "") -> Path:
    """A ROS 1 bag."""
    writer = Bag1Writer(path)
    if compression:
        writer.set_compression(getattr(Bag1Writer.CompressionFormat, compression))
    with writer:
        known: dict[str, Any] = {}
        for topic, stamp, kind, message in said:
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE1)
            writer.write(known[topic], stamp, STORE1.serialize_ros1(message, kind))
    return path


def mcap(
    path: Path,
    said: Iterable[tuple[str, int, bytes]],
    schemas: dict[str, tuple[str, str, bytes, str]],
    compression: str = "zstd",
    chunk: int = 2**16,
) -> Path:
    """An MCAP file with own schemas: by topic (type, schema encoding, definition, message encoding)."""
    with path.open("wb") as file:
        writer = McapWriter(
            file, compression=getattr(CompressionType, compression.upper()), chunk_size=chunk, enable_crcs=True
        )
        writer.start()
        channels = {}
        for topic, (kind, encoding, definition, message) in schemas.items():
            schema = writer.register_schema(kind, encoding, definition)
            channels[topic] = writer.register_channel(topic, message, schema)
        for topic, stamp, data in said:
            writer.add_message(channels[topic], stamp, data, stamp)
        writer.finish()
    return path


def lerobot(
    folder: Path, episodes: Sequence[dict[str, np.ndarray]], names: dict[str, list[str]], fps: float, version: int = 3
) -> Path:
    """A LeRobot data set, version 2 (a file for each episode) or 3: features of (frames, channels) each."""
    (folder / "meta").mkdir(parents=True)
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": [len(joints)], "names": {"motors": joints} if version == 2 else joints}
        for key, joints in names.items()
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    info = {
        "codebase_version": "v2.1" if version == 2 else "v3.0",
        "fps": fps,
        "total_episodes": len(episodes),
        "features": features,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
        if version == 2
        else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    tables, first = [], 0
    for k, episode in enumerate(episodes):
        n = len(next(iter(episode.values())))
        columns: dict[str, Any] = {}
        for key, values in episode.items():
            flat = pa.array(np.asarray(values).ravel())
            columns[key] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
        columns["timestamp"] = pa.array((np.arange(n) / fps).astype(np.float32))
        columns["frame_index"] = pa.array(np.arange(n))
        columns["episode_index"] = pa.array(np.full(n, k))
        columns["index"] = pa.array(np.arange(first, first + n))
        tables.append(pa.table(columns))
        first += n
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    if version == 2:
        for k, table in enumerate(tables):
            parquet.write_table(table, chunk / f"episode_{k:06d}.parquet")
    else:
        parquet.write_table(pa.concat_tables(tables), chunk / "file-000.parquet")
    return folder


def arm(n: int, rate: float = 500.0, joints: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times in ns from 0, positions and efforts of a smooth motion, (n,), (n, joints), (n, joints)."""
    stamps = np.round(np.arange(n) * 1e9 / rate).astype(np.int64)
    t = stamps * 1e-9
    k = np.arange(joints)
    q = np.sin(2 * np.pi * (0.4 + 0.13 * k) * t[:, None] + k)
    tau = 3 * np.cos(2 * np.pi * (0.31 + 0.07 * k) * t[:, None]) + 0.5 * q
    return stamps, q, tau


def shuffled(said: Callable[[int, Sequence[int]], Said], n: int, joints: int, seed: int = 0) -> list[Said]:
    """Messages whose joints stand in another order each time."""
    rng = np.random.default_rng(seed)
    return [said(k, rng.permutation(joints)) for k in range(n)]
