"""A log of 3.6 million samples of a six-axis arm, from file to result, and the memory it takes.

The whole `haptid identify` runs in a process of its own; its peak memory is what the system says it was.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import haptid

SAMPLES = 3_600_000
PERIOD = 20_000
RATE_HZ = 1000.0
# What it may take at most.
LIMIT_GIB = 1.0
STUDY = """
schema = 1
name = "long log"
device = "puma560"
[channels]
time = "t"
position = {{ channels = {positions}, unit = "rad" }}
torque = {{ channels = {torques}, unit = "N m" }}
[[logs]]
path = "long.parquet"
[treatment]
cutoff_hz = 40
decimation = {decimation}
"""


def periodic_motion(
    model: haptid.DynamicModel, rng: np.random.Generator, size: float, largest: float
) -> tuple[np.ndarray, np.ndarray]:
    """One period of positions and torques of parameters drawn at random, (coordinates, PERIOD) each.

    Args:
        size: of the motion's waves, at 1 rad/s.
        largest: parameter.
    """
    n = len(model.device.active)
    t = np.arange(PERIOD) / RATE_HZ
    omega = 2 * np.pi * np.array([3, 7, 13, 22, 31]) * RATE_HZ / PERIOD
    sizes = size / omega**0.7
    angle = omega[:, None] * t + rng.uniform(0, 2 * np.pi, (n, 5, 1))
    q = np.einsum("k,jkn->jn", sizes, np.sin(angle))
    qd = np.einsum("k,jkn->jn", sizes * omega, np.cos(angle))
    qdd = -np.einsum("k,jkn->jn", sizes * omega**2, np.sin(angle))
    beta = rng.uniform(0.2, 1.0, len(model.base)) * largest
    return q, haptid.inverse_dynamics(model, beta, q, qd, qdd)


def write_log(folder: Path, samples: int) -> None:
    """Tile one periodic motion; noise differs all along."""
    model = haptid.DynamicModel(haptid.read_device("puma560"))
    rng = np.random.default_rng(0)
    q, tau = periodic_motion(model, rng, 0.8, 1.0)
    n = len(q)
    copies = -(-samples // PERIOD)
    columns = {"t": np.arange(samples) / RATE_HZ}
    columns |= {f"q{k + 1}": np.tile(q[k], copies)[:samples] for k in range(n)}
    for k in range(n):
        columns[f"tau{k + 1}"] = np.tile(tau[k], copies)[:samples] + 0.3 * rng.standard_normal(samples)
    pq.write_table(pa.table(columns), folder / "long.parquet")


def run(samples: int = SAMPLES, decimation: int = 10) -> dict[str, float]:
    """Seconds, and the peak memory of the identifying process, GiB."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Written in a process of its own, so that its memory is not counted.
        make = "import sys, pathlib, long_log; long_log.write_log(pathlib.Path(sys.argv[1]), int(sys.argv[2]))"
        subprocess.run([sys.executable, "-c", make, name, str(samples)], check=True, cwd=Path(__file__).parent)
        study = folder / "study.toml"
        names = {"positions": [f"q{k}" for k in range(1, 7)], "torques": [f"tau{k}" for k in range(1, 7)]}
        study.write_text(STUDY.format(decimation=decimation, **{k: json.dumps(v) for k, v in names.items()}))
        out = folder / "out"
        begin = time.perf_counter()
        command = [sys.executable, "-m", "haptid", "identify", str(study), "--out", str(out), "--quiet"]
        process = subprocess.Popen(command)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - begin
        if status:
            raise RuntimeError(f"haptid identify ended with status {os.waitstatus_to_exitcode(status)}")
        gib = usage.ru_maxrss / (1024 if sys.platform == "darwin" else 1) / 2**20
        if gib > LIMIT_GIB:
            raise RuntimeError(f"haptid identify took {gib:.2f} GiB, above the limit of {LIMIT_GIB} GiB")
        result = json.loads((out / "result.json").read_text())
        return {
            "samples": float(samples),
            "rows": float(result["observation"]["rows"]),
            "seconds": seconds,
            "peak memory, GiB": gib,
            "relative error, %": next(v["relative_error_percent"] for v in result["validation"] if v["motor"] == "all"),
        }
