"""Write the seeds: `python -m fuzz.make_seeds`. Small inputs of every kind, made by haptid's own writers."""

from __future__ import annotations

import gzip
import json
import sys
import tempfile
from importlib import import_module
from importlib.resources import files
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
from pyarrow import parquet
from scipy import io

import haptid
from haptid.dynamics.model import mechanism_arguments
from haptid.report import make_report

ROOT = Path(__file__).parents[1]
TESTS = ROOT / "tests"
HERE = Path(__file__).parent / "seeds"
DEVICE = """schema = 1
name = "arm"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
limits = { position = [-2.0, 2.0] }
[[joints]]
name = "2"
d = "L"
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "custom"
joints = ["1"]
name = "K"
unit = "N m"
expression = "sin(q_1)"
[lengths]
L = 0.3
"""
STUDY = """schema = 1
name = "arm"
device = "device.toml"
[channels]
time = "t"
position = { channels = ["q1", "q2"], unit = "rad" }
torque = { channels = ["tau1", "tau2"], unit = "N m" }
[[logs]]
path = "log.csv"
[[logs]]
path = "check.csv"
role = "validate"
[treatment]
cutoff_hz = 20
decimation = 5
"""


def columns(seed: int, seconds: float = 4.0) -> dict[str, np.ndarray]:
    """Positions and torques of a motion of two joints; the torques are not those of a device."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.01)
    waves = [sum(np.sin(2 * np.pi * f * t + p) for f, p in rng.uniform(0.1, 2.0, (4, 2))) for _ in range(4)]
    signals = [np.round(wave + 0.01 * rng.standard_normal(t.size), 6) for wave in waves]
    return dict(zip(("t", "q1", "q2", "tau1", "tau2"), (np.round(t, 6), *signals), strict=True))


def main() -> None:
    """Write all of them."""
    made = columns(1, 0.8)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "device.toml").write_text(DEVICE)
        (folder / "study.toml").write_text(STUDY)
        for seed, log in ((1, "log.csv"), (2, "check.csv")):
            write_csv(folder / log, columns(seed))
        found = haptid.identify(haptid.read_study(folder / "study.toml"))
        haptid.Result.of(found).save(folder / "result")
        make_report(found).write(folder / "result")
        packed = (folder / "result" / "report-data.json.gz").read_bytes()
        save("result", "arm.json", (folder / "result" / "result.json").read_bytes())
        save("report", "arm.json", gzip.decompress(packed))
        save("device", "arm.toml", DEVICE.encode())
        save("study", "arm.toml", STUDY.encode())
        np.set_printoptions(threshold=10**6)
        arguments = ", ".join(map(notation, mechanism_arguments(found.model)))
        save("core", "arm.txt", f"({arguments},)".encode())
        write_csv(folder / "log.csv", made)
        np.savez_compressed(folder / "log.npz", **made)
        parquet.write_table(pa.table(made), folder / "log.parquet")
        with h5py.File(folder / "log.h5", "w") as file:
            for channel, column in made.items():
                file[f"rec/{channel}"] = column
        io.savemat(folder / "log.mat", {"rec": made}, do_compression=True)
        for suffix in ("csv", "npz", "parquet", "h5", "mat"):
            save(f"log-{suffix}", f"log.{suffix}", (folder / f"log.{suffix}").read_bytes())
    tables(made)
    messages()
    robots()
    for device in ("phantom_premium_15", "staubli_tx40"):
        save("device", f"{device}.toml", (files("haptid.device") / "library" / f"{device}.toml").read_bytes())
    for k, text in enumerate(("sin(q_1)*v_2**2/L - exp(-q_2/3)", "abs(v_1)**1.5*tanh(-v_2) + sqrt(q_1**2 + 1)*pi")):
        save("expression", f"{k}.txt", text.encode())


def tables(made: dict[str, np.ndarray]) -> None:
    """Further formats of tables."""
    import nptdms

    some = {name: column[:30] for name, column in made.items()}
    rows = [dict(zip(some, map(float, row), strict=True)) for row in zip(*some.values(), strict=True)]
    save("log-json", "columns.json", json.dumps({"rec": {n: column.tolist() for n, column in some.items()}}).encode())
    save("log-json", "rows.json", json.dumps(rows).encode())
    nested = [{"t": row["t"], "name": ["a", "b"], "q": [row["q1"], row["q2"]], "s": {"x": None}} for row in rows]
    save("log-jsonl", "nested.jsonl", "\n".join(map(json.dumps, nested)).encode())
    save("log-jsonl", "plain.jsonl", "\n".join(map(json.dumps, rows)).encode())
    lists = [
        f"{name} : ARRAY[1..{x.size}] OF REAL := [{', '.join(map(repr, x.tolist()))}];" for name, x in some.items()
    ]
    elements = [f"{name}[{k}] := {value!r};" for name, x in some.items() for k, value in enumerate(x.tolist(), 1)]
    save("log-csv", "lists.txt", "\n".join(lists).encode())
    save("log-csv", "elements.txt", "\n".join(elements).encode())
    save("log-csv", "utf-16.csv", "\n".join(["t;q", *(f"{k};{k % 5}" for k in range(30))]).encode("utf-16"))
    lines = [" ".join([name, *map(repr, column.tolist())]) for name, column in some.items()]
    save("log-rows", "named.txt", "\n".join(lines).encode())
    lines = ["[key]; [value]", "Flags; 16"]
    for k, (name, column) in enumerate(some.items()):
        lines += [f"{k}.Variable; {name}", f"{k}.Data; ", *(f"; {t}; {value}" for t, value in enumerate(column))]
    save("log-trace", "text.trace", "\n".join(lines).encode())
    variables = "".join(
        f'<TraceVariable VarName="{name}"><Values>{",".join(map(str, column))}</Values><Timestamps>'
        f"{','.join(map(str, range(column.size)))}</Timestamps></TraceVariable>"
        for name, column in some.items()
    )
    save("log-trace", "document.trace", f"<?xml version='1.0'?><Trace>{variables}</Trace>".encode())
    sampled = [["Name", *some], ["SampleTime[ms]", *("1" for _ in some)]]
    sampled += [list(map(str, (t, *row))) for t, row in enumerate(zip(*some.values(), strict=True))]
    scope = "\n".join("\t".join(row) for row in [["Name", "run"], ["File", "run.csv"], *sampled])
    save("log-trace", "scope.trace", scope.encode())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.save(folder / "log.npy", np.column_stack([*some.values()]))
        with nptdms.TdmsWriter(folder / "log.tdms") as writer:
            writer.write_segment([nptdms.ChannelObject("rec", key, column) for key, column in some.items()])
        for suffix in ("npy", "tdms"):
            save(f"log-{suffix}", f"log.{suffix}", (folder / f"log.{suffix}").read_bytes())


def messages() -> None:
    """Joint states in MCAP and bags, as their own writers make them."""
    sys.path.insert(0, str(TESTS))
    recorders = import_module("recorders")
    stamps, q, tau = recorders.arm(60)
    kind, names = "sensor_msgs/msg/JointState", ("a", "b", "c")

    def said(store: object) -> list[tuple[str, int, str, object]]:
        at = [recorders.START + int(stamp) for stamp in stamps]
        return [("/j", s, kind, recorders.joint_state(s, names, q[k], tau[k], store=store)) for k, s in enumerate(at)]

    texts = [json.dumps({"t": k, "j": [{"name": "a", "q": float(p)}]}).encode() for k, p in enumerate(q[:, 0])]
    sent = [("/j", int(s), text) for s, text in zip(stamps, texts, strict=True)]
    schema = {"/j": ("J", "jsonschema", b"{}", "json")}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = {
            "ros2.mcap": recorders.ros2(folder / "mcap", said(recorders.STORE)),
            "ros2.db3": recorders.ros2(folder / "db3", said(recorders.STORE), "db3"),
            "plain.bag": recorders.ros1(folder / "plain.bag", said(recorders.STORE1)),
            "lz4.bag": recorders.ros1(folder / "lz4.bag", said(recorders.STORE1), "LZ4"),
            "json.mcap": recorders.mcap(folder / "json.mcap", sent, schema, "none"),
            "zstd.mcap": recorders.mcap(folder / "zstd.mcap", sent, schema, "zstd"),
        }
        for file, path in made.items():
            save(f"log-{file.rpartition('.')[2]}", file, path.read_bytes())


def robots() -> None:
    """Robot descriptions of the examples, and those that the tests are written with."""
    for part in (TESTS, TESTS / "unit", TESTS / "oracle"):
        sys.path.insert(0, str(part))
    plain, peers = import_module("test_robot_files"), import_module("test_robot_files_against_peers")
    usd = import_module("test_usd_against_mujoco")
    plane, space = (peers.LOOP.format(axis="0 1 0", more=x) for x in ("", '<joint name="bend" axis="0.2 0.1 1"/>'))
    table = "# convention: {}\nname,alpha_deg,a,theta_deg,d\n1,0,0,0,0\n2,-90,0,0,0.1\n3,0,0.43,0,0.15\n"
    lengths = {"d2": "0.3", "d3": "0.45", "d4": "0.15", "d8": "0.2", "d9": "0.45", "rl4": "0.5"}
    par = plain.SR400
    for name, length in lengths.items():
        par = par.replace(name, length)
    texts = {
        "urdf": {"tests": plain.ARM} | {p.stem: p.read_text() for p in (ROOT / "examples" / "robots").glob("*.urdf")},
        "xml": {"hard": peers.HARD, "plane": plane, "space": space, "tendons": peers.TENDONS, "shapes": peers.SHAPES}
        | {"usd": usd.MJCF, "four-bar": (ROOT / "examples" / "robots" / "four-bar.xml").read_text()},
        "sdf": {"tests": plain.SDF},
        "par": {"sr400": par},
        "csv": {name: table.format(name) for name in ("dh", "craig")},
        "xacro": {"tests": peers.XACRO.format(include="", where="${pi}").replace("{{", "{").replace("}}", "}")},
        "usda": {"arm": usd.USD, "loop": usd.LOOP},
    }
    for suffix, named in texts.items():
        for name, text in named.items():
            save(f"robot-{suffix}", f"{name}.{suffix}", text.encode())


def notation(value: object) -> str:
    """An argument in the notation of the target `core`."""
    if isinstance(value, np.ndarray):
        return f'array({value.tolist()!r}, "{value.dtype}")'
    if isinstance(value, list):
        return f"[{', '.join(map(notation, value))}]"
    if isinstance(value, tuple):
        return f"({', '.join(map(notation, value))},)" if value else "()"
    return repr(value)


def write_csv(path: Path, made: dict[str, np.ndarray]) -> None:
    """A text log."""
    np.savetxt(path, np.column_stack([*made.values()]), fmt="%.6g", delimiter=",", header=",".join(made), comments="")


def save(target: str, name: str, data: bytes) -> None:
    """One seed."""
    (HERE / target).mkdir(parents=True, exist_ok=True)
    (HERE / target / name).write_bytes(data)


if __name__ == "__main__":
    main()
