"""A whole identification of a 7-joint log, from the Parquet file to intervals, compared with two other pipelines.

Treatment: positions through a Butterworth filter both ways, 40 Hz; torque and columns through one filter, and one row
of ten kept. Each pipeline (`pipelines/`) runs in a process of its own, one thread, from the file to the estimate with
its intervals, all imported before; its time is that of the processor, its memory what the system reports. Filters
differ in detail, so agreement is that of the torque of all models on another motion, without noise.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from compare_peers import HERE, PYTHON, left_out, one_thread
from pipelines.setting import JOINTS, RATE_HZ
from run_peer import LEFT_OUT

SIZES = (20_000, 400_000, 4_000_000)
# Name of each pipeline, its file, and the sizes of its logs: longer ones take minutes, or all memory.
PIPELINES = {
    "haptid": ("haptid_pipeline", SIZES),
    "script with Pinocchio and SciPy": ("script", SIZES[:2]),
    "figaroh's functions": ("figaroh_pipeline", SIZES[:2]),
}
PERIOD, CHECKED, SHORT = 20_000, 500, 4000
# Error of a model's torque on another motion, %, that filters explain; a pipeline that takes longer, s, is left out.
AGREED, LIMIT = 2.0, 240.0


def run(sizes: tuple[int, ...] = SIZES) -> dict[str, float]:
    """Seconds of the processor, shares, peak memory, errors, and ratios of the times."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        short = logged(Path(name), SHORT)
        for samples in sizes:
            path = logged(Path(name), samples)
            for pipeline, (file, most) in PIPELINES.items():
                found = measured(pipeline, file, path, short) if samples in most else {}
                figures |= {f"{samples} samples: {pipeline}, {what}": value for what, value in found.items()}
                if found and pipeline != "haptid":
                    ratio = found["s"] / figures[f"{samples} samples: haptid, s"]
                    figures[f"{samples} samples: {pipeline} over haptid"] = ratio
            path.unlink()
    return figures


def logged(folder: Path, samples: int) -> Path:
    """A log of so many samples, written by a process of its own: its memory does not count for a pipeline."""
    path = folder / f"{samples}.parquet"
    subprocess.run([sys.executable, __file__, str(path), str(samples)], check=True)
    return path


def measured(pipeline: str, file: str, path: Path, short: Path) -> dict[str, float]:
    """Figures of a pipeline; none where it is not installed or takes too long."""
    python = sys.executable if pipeline == "haptid" else str(PYTHON)
    call = [python, str(HERE / "run_pipeline.py"), file, str(path), str(short)]
    environment = {**os.environ, **one_thread()}
    try:
        done = subprocess.run(call, capture_output=True, text=True, env=environment, timeout=LIMIT, check=False)
    except FileNotFoundError:
        left_out(pipeline, "there is no environment of peers: see `make bench`")
        return {}
    except subprocess.TimeoutExpired:
        left_out(pipeline, f"it took over {LIMIT:.0f} s")
        return {}
    if done.returncode == LEFT_OUT:
        left_out(pipeline, done.stderr.strip())
        return {}
    assert done.returncode == 0, done.stderr
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    seconds, memory, error = (found.pop(what) for what in ("seconds", "memory", "error"))
    assert error < AGREED, f"{pipeline}: the torque of its model is {error:.2f} % off"
    shares = {f"share of {step}, %": 100 * value / seconds for step, value in found.items()}
    return {"s": seconds, "peak memory, GiB": memory, "error of torque, %": error, **shares}


def motion(rng: np.random.Generator, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations of one period, (3, joints, samples)."""
    t = np.arange(samples) / RATE_HZ
    omega = 2 * np.pi * np.array([3, 7, 13, 22, 31]) * RATE_HZ / PERIOD
    size = 0.8 / omega**0.7
    angle = omega[:, None] * t + rng.uniform(0, 2 * np.pi, (JOINTS, 5, 1))
    q = np.einsum("k,jkn->jn", size, np.sin(angle))
    qd = np.einsum("k,jkn->jn", size * omega, np.cos(angle))
    return q, qd, -np.einsum("k,jkn->jn", size * omega**2, np.sin(angle))


def write_log(path: Path, samples: int) -> None:
    """Tile one periodic motion of the arm, noise differing all along; next to it the robot and another motion."""
    import pyarrow as pa
    from pyarrow import parquet

    import haptid

    model, rng = haptid.DynamicModel(haptid.read_device("arm7")), np.random.default_rng(0)
    q, qd, qdd = motion(rng, PERIOD)
    beta = rng.uniform(0.2, 1.0, len(model.base))
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    copies = -(-samples // PERIOD)
    columns = {"t": np.arange(samples) / RATE_HZ}
    columns |= {f"q{k + 1}": np.tile(q[k], copies)[:samples] for k in range(JOINTS)}
    for k in range(JOINTS):
        columns[f"tau{k + 1}"] = np.tile(tau[k], copies)[:samples] + 0.3 * rng.standard_normal(samples)
    parquet.write_table(pa.table(columns), path, row_group_size=2**18)
    other = [x[:, :: PERIOD // CHECKED] for x in motion(rng, PERIOD)]
    np.savez(
        path.with_suffix(".npz"),
        parent=[joint.parent for joint in model.device.joints],
        rotation=[joint.rotation for joint in model.device.joints],
        translation=[joint.translation for joint in model.device.joints],
        gravity=model.device.gravity,
        tau=haptid.inverse_dynamics(model, beta, *other),
        **dict(zip(("q", "qd", "qdd"), other, strict=True)),
    )


if __name__ == "__main__":
    write_log(Path(sys.argv[1]), int(sys.argv[2]))
