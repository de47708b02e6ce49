"""Rates and memory of the readers of logs, each in a process of its own, on logs as the formats' own writers make them.

Run `python benchmarks/log_readers.py --out benchmarks/results/log_readers.json`. The files are made once in a temporary
folder (about 700 MB). Every reader reads 60 000 samples of 7 joints: stamps, positions and torques. `images` is an MCAP
file of 425 MB, zstd, in which most bytes are images.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES, JOINTS, RATE = 60_000, 7, 1000.0
NAMES = tuple(f"joint_{k}" for k in range(JOINTS))
KIND = "sensor_msgs/msg/JointState"


def make(folder: Path) -> dict[str, tuple[Path, str]]:
    """The files, each with what names its channels: a topic, "columns", or "data set"."""
    import h5py
    import nptdms
    import pyarrow as pa
    from pyarrow import csv, parquet

    import recorders

    stamps, q, tau = recorders.arm(SAMPLES, RATE, JOINTS)

    def said(store: Any = recorders.STORE) -> Any:
        for k in range(SAMPLES):
            stamp = recorders.START + int(stamps[k])
            yield "/j", stamp, KIND, recorders.joint_state(stamp, NAMES, q[k], tau[k], np.zeros(JOINTS), store)

    table = {"t": stamps * 1e-9} | {f"q{k + 1}": q[:, k] for k in range(JOINTS)}
    table |= {f"tau{k + 1}": tau[:, k] for k in range(JOINTS)}
    files = {
        "MCAP": (recorders.ros2(folder / "mcap", said()), "/j"),
        "ROS 2 db3": (recorders.ros2(folder / "db3", said(), "db3"), "/j"),
        "ROS 1 bag": (recorders.ros1(folder / "log.bag", said(recorders.STORE1)), "/j"),
        "MCAP, zstd, images": (_images(folder / "images.mcap"), "/j"),
    }
    csv.write_csv(pa.table(table), folder / "log.csv")
    csv.write_csv(pa.table(table), folder / "blanks.csv", csv.WriteOptions(delimiter=" "))
    parquet.write_table(pa.table(table), folder / "log.parquet")
    with h5py.File(folder / "log.h5", "w") as file:
        for name, column in table.items():
            file[name] = column
    with nptdms.TdmsWriter(folder / "log.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("run", name, column) for name, column in table.items()])
    recorders.lerobot(folder / "lerobot", [{"q": q, "tau": tau}], {"q": list(NAMES), "tau": list(NAMES)}, RATE)
    files |= {
        "CSV": (folder / "log.csv", "columns"),
        "CSV, blanks": (folder / "blanks.csv", "columns"),
        "Parquet": (folder / "log.parquet", "columns"),
        "HDF5": (folder / "log.h5", "columns"),
        "TDMS": (folder / "log.tdms", "run"),
        "LeRobot v3": (folder / "lerobot", "data set"),
    }
    return files


def _images(path: Path) -> Path:
    """Joint states between images of a camera: 300 000 samples in 425 MB."""
    import recorders

    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, 2**20, np.uint8).tobytes()
    stamps, q, tau = recorders.arm(300_000, RATE, JOINTS)
    image = ("lab/msg/Image", "ros2msg", b"uint8[] data", "cdr")
    text = recorders.STORE.generate_msgdef(KIND)[0].encode()

    def said() -> Any:
        for k in range(300_000):
            stamp = recorders.START + int(stamps[k])
            message = recorders.joint_state(stamp, NAMES, q[k], tau[k], np.zeros(JOINTS))
            yield "/j", stamp, bytes(recorders.STORE.serialize_cdr(message, KIND))
            if k % 900 == 0:
                yield "/camera", stamp, b"\0\1\0\0" + len(noise).to_bytes(4, "little") + noise

    return recorders.mcap(path, said(), {"/j": (KIND, "ros2msg", text, "cdr"), "/camera": image}, "zstd", 2**20)


def mapping(what: str) -> Any:
    """The channels of a file."""
    from haptid.log import Channels, Signal

    if what == "data set":
        q, tau, time_name, unit = (*(tuple(f"{s}[{n}]" for n in NAMES) for s in ("q", "tau")), "time", "s")
    elif what.startswith("/"):
        q, tau = (tuple(f"{what}.{s}[{n}]" for n in NAMES) for s in ("position", "effort"))
        time_name, unit = f"{what}@header", "ns"
    else:
        head = "" if what == "columns" else f"{what}."
        q, tau = (tuple(f"{head}{s}{k + 1}" for k in range(JOINTS)) for s in ("q", "tau"))
        time_name, unit = f"{head}t", "s"
    return Channels(Signal(q, "rad"), Signal(tau, "N m"), time=time_name, time_unit=unit)


def measure(path: Path, what: str) -> dict[str, float]:
    """Reads the columns of a file; rate, and growth of the largest resident memory beyond the arrays themselves."""
    from haptid.log.file_format import format_of
    from haptid.log.request import Request

    wanted = mapping(what).sources
    kind = format_of(path)
    import_module(f"haptid.log.formats.{kind.module}")
    Path("/proc/self/clear_refs").write_text("5")  # the largest resident memory begins again
    before = _resident()
    begin = time.perf_counter()
    columns = kind.columns(path, wanted, Request())
    seconds = time.perf_counter() - begin
    grown = (_resident() - before) / 1024
    own = sum(column.nbytes for column in columns.values()) / 2**20
    count = len(columns[wanted[0]])
    size = sum(f.stat().st_size for f in path.rglob("*") if f.is_file()) if path.is_dir() else path.stat().st_size
    return {
        "samples": count,
        "seconds": round(seconds, 3),
        "samples_per_s": round(count / seconds),
        "file_MB": round(size / 1e6, 1),
        "arrays_MiB": round(own, 1),
        "memory_MiB": round(grown, 1),
    }


def _resident() -> int:
    """Largest resident memory so far, kB (Linux)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("VmHWM")).split()[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--one", nargs=2, metavar=("PATH", "CHANNELS"), help="measure one file in this process")
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(Path(given.one[0]), given.one[1])))
        return
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (path, what) in make(Path(folder)).items():
            runs = []
            for _ in range(2):
                command = [sys.executable, __file__, "--one", str(path), what]
                runs.append(json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout))
            found[name] = min(runs, key=lambda run: run["seconds"])
            print(f"{name:20} {found[name]}")
    if given.out:
        about = {"python": platform.python_version(), "machine": platform.machine(), "best of": 2}
        given.out.write_text(json.dumps({"about": about, "readers": found}, indent=2) + "\n")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
    main()
