"""Logs of messages: joints by name, stamps, topics merged by time, and files that are cut short or hostile."""

from __future__ import annotations

import json
import sqlite3
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import recorders
from haptid import errors
from haptid.log import Channels, Log, Merge, Signal, read_log
from haptid.log.formats import messages
from haptid.log.formats.messages import definitions, ros
from haptid.log.formats.messages.mcap import MAGIC
from haptid.log.request import Request
from haptid.log.survey import survey
from recorders import START, STORE, STORE1, arm, joint_state, mcap, ros1, ros2, shuffled

JOINTS = ("arm/shoulder", "elbow", "wrist.1")
KIND = "sensor_msgs/msg/JointState"
N = 1500


def channels(
    topic: str = "/joint_states", torque: str = "/joint_states", stamp: str = "header", **more: Any
) -> Channels:
    return Channels(
        Signal(tuple(f"{topic}.position[{j}]" for j in JOINTS), "rad"),
        Signal(tuple(f"{torque}.effort[{j}]" for j in JOINTS), "N m"),
        time=f"{topic}@{stamp}",
        time_unit="ns",
        **more,
    )


def said(store: Any = STORE) -> list[recorders.Said]:
    """Joint states in changing order, received 2 ms late."""
    stamps, q, tau = arm(N)

    def one(k: int, order: Any) -> recorders.Said:
        stamp = START + int(stamps[k])
        message = joint_state(stamp, [JOINTS[i] for i in order], q[k, order], tau[k, order], store=store)
        return "/joint_states", stamp + 2_000_000, KIND, message

    return shuffled(one, N, 3)


def written(folder: Path, kind: str) -> Path:
    if kind == "bag":
        return ros1(folder / "run.bag", said(STORE1))
    if kind in ("BZ2", "LZ4"):
        return ros1(folder / "run.bag", said(STORE1), kind)
    path = ros2(folder / "run", said(), "db3" if kind == "db3" else "mcap")
    return path.parent if kind == "folder" else path


@pytest.mark.parametrize("kind", ["mcap", "folder", "db3", "bag", "BZ2", "LZ4"])
def test_joints_are_matched_by_name_in_every_message(tmp_path: Path, kind: str) -> None:
    stamps, q, tau = arm(N)
    log = read_log(written(tmp_path, kind), channels())
    np.testing.assert_array_equal(log.position, q)
    np.testing.assert_array_equal(log.torque, tau)
    np.testing.assert_allclose(log.t, 1e-9 * stamps, rtol=0, atol=1e-12)


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("encoding", ["json", "protobuf", "ros2msg", "ros1msg"])
def test_own_schemas(tmp_path: Path, compression: str, encoding: str) -> None:
    stamps, q, tau = arm(N)
    path = own_schema(tmp_path / "run.mcap", encoding, compression)
    log = read_log(
        path,
        Channels(
            Signal(tuple(f"/arm.motors[{j}].angle" for j in JOINTS), "rad"),
            Signal(tuple(f"/arm.motors[{j}].torque" for j in JOINTS), "N m"),
            time="/arm@header",
            time_unit="ns",
        ),
    )
    np.testing.assert_array_equal(log.position, q)
    np.testing.assert_array_equal(log.torque, tau)
    np.testing.assert_allclose(log.t, 1e-9 * stamps, rtol=0, atol=1e-12)


MOTORS = (
    "builtin_interfaces/Time stamp\nMotor[] motors\nstring note\n"
    "====\nMSG: lab/Motor\nstring name\nfloat64 angle\nfloat64 torque\nbool on\n"
)


def own_schema(path: Path, encoding: str, compression: str) -> Path:
    """Messages whose joints are structs in an array, each with its name, as an own schema has them."""
    stamps, q, tau = arm(N)
    if encoding == "protobuf":
        kind, definition = protobuf_type()
    elif encoding.endswith("msg"):
        definition = MOTORS if encoding == "ros2msg" else MOTORS.replace("builtin_interfaces/Time", "time")

    def data(k: int) -> bytes:
        stamp, rows = START + int(stamps[k]), zip(JOINTS, q[k].tolist(), tau[k].tolist(), strict=True)
        seconds, rest = divmod(stamp, 10**9)
        if encoding == "json":
            motors = [{"name": n, "angle": a, "torque": t, "on": True} for n, a, t in rows]
            return json.dumps({"stamp": {"sec": seconds, "nsec": rest}, "motors": motors, "note": "x"}).encode()
        if encoding == "protobuf":
            message = kind(stamp={"seconds": seconds, "nanos": rest})
            for n, a, t in rows:
                message.motors.add(name=n, angle=a, torque=t)
            return bytes(message.SerializeToString())
        return packed(encoding == "ros2msg", seconds, rest, list(rows), "note" * (k % 3))

    schema = {
        "json": ("Arm", "jsonschema", b"{}", "json"),
        "protobuf": ("lab.Arm", "protobuf", definition if encoding == "protobuf" else b"", "protobuf"),
    }.get(encoding) or ("lab/msg/Arm", encoding, definition.encode(), "cdr" if encoding == "ros2msg" else "ros1")
    return mcap(
        path, (("/arm", START + int(s) + 10**6, data(k)) for k, s in enumerate(stamps)), {"/arm": schema}, compression
    )


def packed(cdr: bool, seconds: int, rest: int, motors: list[tuple[str, float, float]], note: str) -> bytes:
    """The message in CDR, or in the packed form of ROS 1."""
    out = bytearray()

    def put(form: str, *values: Any) -> None:
        size = struct.calcsize("<" + form[-1])
        out.extend(bytes(-len(out) % size if cdr else 0) + struct.pack("<" + form, *values))

    def text(value: str) -> None:
        raw = value.encode() + (b"\0" if cdr else b"")
        put("I", len(raw))
        out.extend(raw)

    put("I", seconds)
    put("I", rest)
    put("I", len(motors))
    for name, angle, torque in motors:
        text(name)
        put("d", angle)
        put("d", torque)
        put("B", 1)
    text(note)
    return (b"\0\1\0\0" if cdr else b"") + bytes(out)


def protobuf_type() -> tuple[Any, bytes]:
    """A message class, and the descriptors that travel along."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    file = descriptor_pb2.FileDescriptorProto(name="lab.proto", package="lab", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    motor = file.message_type.add(name="Motor")
    field = descriptor_pb2.FieldDescriptorProto
    motor.field.add(name="name", number=1, type=field.TYPE_STRING, label=field.LABEL_OPTIONAL)
    motor.field.add(name="angle", number=2, type=field.TYPE_DOUBLE, label=field.LABEL_OPTIONAL)
    motor.field.add(name="torque", number=3, type=field.TYPE_DOUBLE, label=field.LABEL_OPTIONAL)
    whole = file.message_type.add(name="Arm")
    stamp = ".google.protobuf.Timestamp"
    whole.field.add(name="stamp", number=1, type=field.TYPE_MESSAGE, type_name=stamp, label=field.LABEL_OPTIONAL)
    whole.field.add(
        name="motors", number=2, type=field.TYPE_MESSAGE, type_name=".lab.Motor", label=field.LABEL_REPEATED
    )
    time = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(time)
    files = descriptor_pb2.FileDescriptorSet(file=[time, file])
    pool = descriptor_pool.DescriptorPool()
    for one in files.file:
        pool.AddSerializedFile(one.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("lab.Arm")), files.SerializeToString()


@pytest.mark.parametrize("kind", ["numbers", "structs", "bag"])
def test_messages_that_hold_samples_give_a_row_for_each(tmp_path: Path, kind: str) -> None:
    """Blocks of 90 samples and a shorter last one: arrays beside each other, or an array of structs."""
    stamps, q, tau = recorders.arm(2000, joints=1)
    parts = [slice(begin, min(begin + 90, 2000)) for begin in range(0, 2000, 90)]
    times = [int(stamps[part][-1]) + recorders.START for part in parts]
    if kind == "bag":
        store, state = recorders.STORE1, "sensor_msgs/msg/JointState"
        sent = [
            recorders.joint_state(t, (), q[p, 0], tau[p, 0], store=store) for t, p in zip(times, parts, strict=True)
        ]
        path = recorders.ros1(tmp_path / "a.bag", [("/a", t, state, m) for t, m in zip(times, sent, strict=True)])
        names = "/a.position", "/a.effort"
    else:
        arrays = [{"q": q[p, 0].tolist(), "tau": tau[p, 0].tolist(), "k": 1} for p in parts]
        if kind == "structs":
            arrays = [{"s": [{"q": a, "tau": b} for a, b in zip(o["q"], o["tau"], strict=True)]} for o in arrays]
        sent = [("/a", t, json.dumps(array).encode()) for t, array in zip(times, arrays, strict=True)]
        path = recorders.mcap(tmp_path / "a.mcap", sent, {"/a": ("A", "jsonschema", b"{}", "json")})
        names = ("/a.s.q", "/a.s.tau") if kind == "structs" else ("/a.q", "/a.tau")
    log = read_log(
        path, Channels(Signal(names[:1], "rad"), Signal(names[1:], "N m"), time="/a@receive", time_unit="ns")
    )
    assert any("23 messages of /a hold 2000 samples" in note for note in log.notes)
    assert log.rate_hz == pytest.approx(500, rel=1e-4)
    np.testing.assert_allclose(log.position[:, 0], q[:, 0], atol=1e-9)
    np.testing.assert_allclose(log.torque[:, 0], tau[:, 0], atol=1e-9)
    assert names[0] in survey(path).table


def test_messages_of_other_joints_and_without_effort_are_left_out(tmp_path: Path) -> None:
    """A gripper publishes on the topic of the arm, every fifth effort is empty, and some are NaN."""
    stamps, q, tau = arm(N)
    sent = []
    for k in range(N):
        stamp = START + int(stamps[k])
        effort = [] if k % 50 == 3 else np.full(3, np.nan) if k % 50 == 4 else tau[k]
        sent.append(("/joint_states", stamp, KIND, joint_state(stamp, JOINTS, q[k], effort)))
        if k % 3 == 0:
            sent.append(("/joint_states", stamp + 10, KIND, joint_state(stamp + 10, ["gripper"], [0.1], [9.0])))
    found = messages.columns(ros2(tmp_path / "run", sent), channels().sources, request := Request())
    keep = ~np.isin(np.arange(N) % 50, (3, 4))
    np.testing.assert_array_equal(found["/joint_states.position[elbow]"], q[keep, 1])
    np.testing.assert_array_equal(found["/joint_states@header"], START + stamps[keep])
    assert f"{N // 3 + 2 * N // 50} of {N + N // 3} messages" in request.notes[0]
    assert f"{N // 50} without effort" in request.notes[0]


@pytest.mark.parametrize(("effort", "why"), [((), "effort is empty in 60 of 60"), ([np.nan] * 3, "NaN in all 60")])
def test_effort_that_is_never_there_is_said(tmp_path: Path, effort: Any, why: str) -> None:
    stamps, q, _ = arm(60)
    sent = [
        ("/joint_states", START + int(s), KIND, joint_state(0, JOINTS, p, effort))
        for s, p in zip(stamps, q, strict=True)
    ]
    path = ros2(tmp_path / "run", sent)
    with pytest.raises(errors.LogChannelError, match=why) as raised:
        read_log(path, channels(stamp="receive"))
    assert raised.value.where == "/joint_states.effort[arm/shoulder]"


def two_topics(folder: Path, delay: int = 0, header: bool = True, every: int = 2) -> Path:
    """Positions at 500 Hz, and currents of another node at half of that rate, with a pause."""
    stamps, q, tau = arm(N)
    sent = [
        ("/joint_states", START + int(s), KIND, joint_state(START + int(s), JOINTS, q[k])) for k, s in enumerate(stamps)
    ]
    for k in range(0, N, every):
        if 600 <= k < 700:
            continue
        stamp = START + int(stamps[k]) + delay
        message = joint_state(stamp if header else 0, JOINTS[::-1], [], tau[k, ::-1])
        sent.append(("/currents", stamp, KIND, message))
    return ros2(folder / "run", sorted(sent, key=lambda one: one[1]))


@pytest.mark.parametrize("method", ["linear", "hold", "nearest"])
def test_another_topic_is_merged_by_time(tmp_path: Path, method: Any) -> None:
    _, q, tau = arm(N)
    mapping = channels(torque="/currents", merge=Merge(method, 0.0041))
    found = messages.columns(two_topics(tmp_path), mapping.sources, request := Request(mapping.merge))
    rows = np.rint((found["/joint_states@header"] - START) * 500e-9).astype(int)
    before = rows - rows % 2
    elbow = found["/currents.effort[elbow]"]
    np.testing.assert_array_equal(found["/joint_states.position[elbow]"], q[rows, 1])
    if method == "linear":
        want = np.where(rows % 2, 0.5 * (tau[before, 1] + tau[np.minimum(before + 2, N - 1), 1]), tau[rows, 1])
        np.testing.assert_allclose(elbow, want, rtol=0, atol=1e-12)
    elif method == "hold":
        fresh = (rows < 600) | (rows >= 700)
        np.testing.assert_array_equal(elbow[fresh], tau[before[fresh], 1])
    else:
        even = rows % 2 == 0
        fresh = even & ((rows < 600) | (rows >= 700))
        np.testing.assert_array_equal(elbow[fresh], tau[rows[fresh], 1])
    gone = set(range(605, 695))
    assert gone.isdisjoint(rows.tolist())
    assert "merged by time" in request.notes[-1]
    assert "left out" in request.notes[-1]


def test_merging_is_exact_for_a_signal_that_is_linear_in_time(tmp_path: Path) -> None:
    """Law: linear interpolation between stamps gives back a ramp, whatever the offset of the two topics."""
    sent = []
    for k in range(400):
        position, other = START + 2_000_000 * k, START + 3_000_000 * k - 777_777
        sent.append(("/joint_states", position, KIND, joint_state(position, JOINTS, np.sin([k, k + 1, 0.1 * k]))))
        sent.append(
            ("/currents", other, KIND, joint_state(other, JOINTS, [], (other - START) * np.array([1e-9, 2e-9, -1e-9])))
        )
    path = ros2(tmp_path / "run", sorted(sent, key=lambda one: one[1]))
    found = messages.columns(path, channels(torque="/currents").sources, Request())
    seconds = (found["/joint_states@header"] - START) * 1e-9
    np.testing.assert_allclose(found["/currents.effort[elbow]"], 2 * seconds, rtol=0, atol=1e-12)


def test_header_stamps_that_a_topic_lacks(tmp_path: Path) -> None:
    path = two_topics(tmp_path, header=False)
    with pytest.raises(errors.LogTimeError, match="stamp 0") as raised:
        read_log(path, channels(torque="/currents"))
    assert "receive" in raised.value.advice
    assert isinstance(read_log(path, channels(torque="/currents", stamp="receive")), Log)


def test_stamps_are_integers_until_the_first_is_subtracted(tmp_path: Path) -> None:
    """float64 seconds since 1970 would round to 0.24 microseconds."""
    stamps = np.arange(200) * 1_000_000 + np.arange(200) % 7
    q = np.sin(0.05 * np.arange(600.0)).reshape(200, 3)
    sent = [("/j", 5, KIND, joint_state(START + int(s), JOINTS, p, p[::-1])) for s, p in zip(stamps, q, strict=True)]
    found = messages.columns(ros2(tmp_path / "run", sent), ["/j@header", "/j.position[elbow]"], Request())
    assert found["/j@header"].dtype == np.int64
    np.testing.assert_array_equal(found["/j@header"] - START, stamps)


# --- files that are cut short or hostile ---


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_a_truncated_file_gives_what_is_whole(tmp_path: Path, kind: str) -> None:
    stamps, q, _ = arm(N)
    path = own_schema(tmp_path / "run.mcap", "ros2msg", "lz4") if kind == "mcap" else small_chunks(tmp_path, kind)
    topic, name = ("/arm", "motors[elbow].angle") if kind == "mcap" else ("/joint_states", "position[elbow]")
    raw = path.read_bytes()
    path.write_bytes(raw[: int(0.6 * len(raw))])
    request = Request()
    try:
        found = messages.columns(path, [f"{topic}@header", f"{topic}.{name}"], request)
    except errors.LogFileError:
        assert kind == "db3"  # SQLite may refuse the first page that is missing
        return
    count = found[f"{topic}@header"].size
    assert 0.2 * N < count < N
    np.testing.assert_array_equal(found[f"{topic}.{name}"], q[:count, 1])
    np.testing.assert_array_equal(found[f"{topic}@header"] - START, stamps[:count])
    assert any("cut short" in note or "no index" in note for note in request.notes)


def small_chunks(folder: Path, kind: str) -> Path:
    if kind == "db3":
        return ros2(folder / "run", said(), "db3")
    writer = recorders.Bag1Writer(folder / "run.bag")
    writer.CHUNK_THRESHOLD = 2**14
    writer.chunk_threshold = 2**14
    with writer:
        connection = writer.add_connection("/joint_states", KIND, typestore=STORE1)
        for topic, stamp, kind, message in said(STORE1):
            del topic
            writer.write(connection, stamp, STORE1.serialize_ros1(message, kind))
    return folder / "run.bag"


def test_a_damaged_chunk_is_left_out_and_said(tmp_path: Path) -> None:
    path = own_schema(tmp_path / "run.mcap", "ros2msg", "none")
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 0xFF
    path.write_bytes(raw)
    found = messages.columns(path, ["/arm@header", "/arm.motors[elbow].angle"], request := Request())
    stamps, q, _ = arm(N)
    rows = np.searchsorted(stamps, found["/arm@header"] - START)
    assert 0.5 * N < rows.size < N
    np.testing.assert_array_equal(found["/arm.motors[elbow].angle"], q[rows, 1])
    assert any("damaged" in note for note in request.notes)


def record(op: int, body: bytes) -> bytes:
    return struct.pack("<BQ", op, len(body)) + body


def chunk(data: bytes, size: int, compression: bytes = b"") -> bytes:
    head = struct.pack("<QQQI", 0, 1, size, zlib.crc32(data)) + struct.pack("<I", len(compression)) + compression
    return record(0x06, head + struct.pack("<Q", len(data)) + data)


HOSTILE: dict[str, Callable[[], bytes]] = {
    "a record of 2^62 bytes": lambda: struct.pack("<BQ", 0x05, 2**62),
    "a chunk of 2^40 bytes": lambda: chunk(b"x" * 100, 2**40, b"zstd"),
    "a chunk of 2^34 bytes, lz4": lambda: chunk(b"x" * 100, 2**34, b"lz4"),
    "a bomb of zstd": lambda: chunk(bomb(), 1000, b"zstd"),
    "a text of 2^32 bytes": lambda: record(0x03, struct.pack("<HI", 1, 2**32 - 1)),
    "a compression without name": lambda: chunk(b"", 0, b"\xff\xfe"),
    "nothing else": lambda: b"",
}


def bomb() -> bytes:
    import zstandard

    return zstandard.ZstdCompressor(write_content_size=False).compressobj().compress(bytes(2**28)) or b""


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_containers_are_one_error_in_bounded_memory(tmp_path: Path, what: str) -> None:
    import tracemalloc

    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + record(0x01, bytes(8)) + HOSTILE[what]() + MAGIC)
    tracemalloc.start()
    try:
        with pytest.raises(errors.LogError):
            read_log(path, channels())
        assert tracemalloc.get_traced_memory()[1] < 2**27
    finally:
        tracemalloc.stop()


def doubling(depth: int) -> str:
    """A definition in which every type has a thousand of the next one."""
    parts = [f"T{k + 1}[1000] a\n====\nMSG: lab/T{k + 1}\n" for k in range(depth)]
    return "".join(parts) + "float64[1000] x\n"


SCHEMAS = {
    "contains itself": "A a\n====\nMSG: lab/A\nA a\n",
    "nests too deep": doubling(20),
    "a thousand to the fifth": doubling(4),
    "four thousand million numbers": "float64[4000000000] x\n",
    "two thousand million texts": "string[2000000000] x\n",
    "not defined": "Foreign x\n",
    "IDL": "====\nIDL: lab/msg/A\nmodule lab {}\n",
    "empty structs": "E[] e\n====\nMSG: lab/E\n",
}


@pytest.mark.parametrize("what", SCHEMAS)
def test_schema_bombs_are_one_error(tmp_path: Path, what: str) -> None:
    data = b"\0\1\0\0" + struct.pack("<I", 2**32 - 1) + bytes(4096)
    sent = [("/arm", START + k, data) for k in range(100)]
    path = mcap(tmp_path / "run.mcap", sent, {"/arm": ("lab/msg/Top", "ros2msg", SCHEMAS[what].encode(), "cdr")})
    with pytest.raises(errors.LogError):
        read_log(path, Channels(Signal("/arm.x[1]", "rad"), Signal("/arm.x[2]", "N m"), "/arm@receive", "ns"))


def test_definitions_that_a_database_has_as_bytes(tmp_path: Path) -> None:
    path = written(tmp_path, "db3")
    with sqlite3.connect(path) as base:
        base.execute(
            "UPDATE message_definitions SET encoded_message_definition = CAST(encoded_message_definition AS BLOB)"
        )
    base.close()
    np.testing.assert_array_equal(read_log(path, channels()).position, arm(N)[1])


def test_a_database_with_views_in_place_of_tables_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.db3"
    with sqlite3.connect(path) as base:
        base.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        base.execute(
            "CREATE VIEW messages AS WITH RECURSIVE r(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM r) "
            "SELECT 1 topic_id, x timestamp, x data FROM r"
        )
    base.close()
    with pytest.raises(errors.LogFileError, match="no tables"):
        read_log(path, channels())


@pytest.mark.parametrize("kind", ["mcap", "bag", "db3"])
def test_mutated_files_are_read_or_refused(tmp_path: Path, kind: str) -> None:
    """A file with a few changed bytes, or cut, is read or is one LogError, never another exception."""
    stamps, q, tau = arm(80)
    store = STORE1 if kind == "bag" else STORE
    sent = [
        ("/joint_states", START + int(s), KIND, joint_state(START + int(s), JOINTS, q[k], tau[k], store=store))
        for k, s in enumerate(stamps)
    ]
    path = ros1(tmp_path / "run.bag", sent) if kind == "bag" else ros2(tmp_path / "run", sent, kind)
    raw, rng = path.read_bytes(), np.random.default_rng(4)
    for _ in range(120):
        changed = bytearray(raw)
        for at in rng.integers(0, len(raw), rng.integers(1, 6)):
            changed[at] = rng.integers(256)
        path.write_bytes(changed[: rng.integers(1, len(raw)) if rng.random() < 0.3 else len(raw)])
        try:
            read_log(path, channels())
        except errors.LogError:
            continue


@pytest.mark.parametrize("rows", [1, 3])
def test_layouts_agree_with_the_library_that_wrote_them(rows: int) -> None:
    """Oracle: every number of a message with all primitive types, by the typestore of rosbags."""
    definition = "".join(
        f"{kind} a{k}\n{kind}[{rows}] b{k}\n{kind}[] c{k}\nstring d{k}\n"
        for k, kind in enumerate(definitions.PRIMITIVES)
        if kind not in ("byte", "char", "bool")
    )
    from rosbags.typesys import get_types_from_msg

    store = recorders.get_typestore(recorders.Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(definition, "lab/msg/All"))
    rng = np.random.default_rng(rows)
    values: dict[str, Any] = {}
    for k, kind in enumerate(kind for kind in definitions.PRIMITIVES if kind not in ("byte", "char", "bool")):
        k = list(definitions.PRIMITIVES).index(kind)
        dtype = np.dtype(definitions.PRIMITIVES[kind])
        drawn = rng.integers(0, 100, 2 * rows + 1).astype(dtype)
        values |= {
            f"a{k}": drawn[0].item(),
            f"b{k}": drawn[:rows],
            f"c{k}": drawn[rows:],
            f"d{k}": "t" * int(rng.integers(5)),
        }
    message = store.types["lab/msg/All"](**values)
    data = bytes(store.serialize_cdr(message, "lab/msg/All"))
    batch = ros.RosDecoder(definition, "lab/msg/All", cdr=True).decode([data] * 2, None)
    assert batch.other == 0
    for name, value in values.items():
        if not isinstance(value, str):
            flat = {name: value} if np.ndim(value) == 0 else {f"{name}[{i}]": v for i, v in enumerate(value, 1)}
            for channel, number in flat.items():
                assert batch.values[channel][1] == number, channel


def test_more_orders_of_joints_than_layouts_are_kept() -> None:
    """Six joints in random order: nearly every message has a layout of its own, and each is right."""
    rng, names = np.random.default_rng(2), [f"joint_{k}" for k in range(6)]
    values, data = rng.normal(size=(400, 6)), []
    for row in values:
        order = rng.permutation(6)
        message = joint_state(START, [names[k] for k in order], row[order])
        data.append(bytes(STORE.serialize_cdr(message, KIND)))
    text = STORE.generate_msgdef(KIND)[0]
    batch = ros.RosDecoder(text, KIND, cdr=True).decode(data, None)
    for k, name in enumerate(names):
        np.testing.assert_array_equal(batch.values[f"position[{name}]"], values[:, k])


def test_json_messages_whose_samples_are_not_all_numbers_are_left_out(tmp_path: Path) -> None:
    """An object among numbers was a TypeError that no one converted."""
    good = {"q": list(np.sin(np.arange(64.0))), "tau": list(np.cos(np.arange(64.0)))}
    bad = {**good, "q": [*good["q"][:-1], {"x": 1}]}
    sent = [("/a", START + k * 640_000_000, json.dumps(bad if k == 5 else good).encode()) for k in range(30)]
    path = mcap(tmp_path / "a.mcap", sent, {"/a": ("A", "jsonschema", b"{}", "json")})
    log = read_log(path, Channels(Signal("/a.q", "rad"), Signal("/a.tau", "N m"), "/a@receive", "ns"))
    assert log.rate_hz == pytest.approx(100, rel=0.02)
