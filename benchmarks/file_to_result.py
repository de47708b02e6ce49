"""A whole identification of a 7-joint log, from the Parquet file to intervals, beside a good script with Pinocchio.

Treatment: positions through a Butterworth filter both ways, 40 Hz; torque and columns through one filter, and one row
of ten kept. Each runs in a process of its own, one thread, from after its imports to the estimate with its intervals;
its time is that of the processor, its memory what the system says it was. The script filters and differentiates with
SciPy, makes the regressor of every sample with Pinocchio, decimates W chunk by chunk and solves by QR.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

SIZES = (20_000, 400_000, 4_000_000)
# The script takes over two minutes of the largest.
SCRIPT_SIZES = (20_000, 400_000)
PERIOD, RATE_HZ, DECIMATION, CUTOFF_HZ = 20_000, 1000.0, 10, 40.0
JOINTS = 7
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"), "1")


def write_log(path: Path, samples: int) -> None:
    """Tile one periodic motion of the arm; noise differs all along."""
    import numpy as np
    import pyarrow as pa
    from pyarrow import parquet

    import haptid

    device, rng = haptid.read_device("arm7"), np.random.default_rng(0)
    t = np.arange(PERIOD) / RATE_HZ
    omega = 2 * np.pi * np.array([3, 7, 13, 22, 31]) * RATE_HZ / PERIOD
    size = 0.8 / omega**0.7
    angle = omega[:, None] * t + rng.uniform(0, 2 * np.pi, (JOINTS, 5, 1))
    q = np.einsum("k,jkn->jn", size, np.sin(angle))
    qd = np.einsum("k,jkn->jn", size * omega, np.cos(angle))
    qdd = -np.einsum("k,jkn->jn", size * omega**2, np.sin(angle))
    tau = haptid.inverse_dynamics(device, rng.uniform(0.2, 1.0, len(device.base)), q, qd, qdd)
    copies = -(-samples // PERIOD)
    columns = {"t": np.arange(samples) / RATE_HZ}
    columns |= {f"q{k + 1}": np.tile(q[k], copies)[:samples] for k in range(JOINTS)}
    for k in range(JOINTS):
        columns[f"tau{k + 1}"] = np.tile(tau[k], copies)[:samples] + 0.3 * rng.standard_normal(samples)
    parquet.write_table(pa.table(columns), path, row_group_size=2**18)


def ours(path: Path) -> Callable[[], dict[str, float]]:
    """What haptid does, and what share of it each step takes."""
    import time

    import haptid
    from haptid.log import is_long

    device = haptid.read_device("arm7")
    names = ([f"{kind}{k + 1}" for k in range(JOINTS)] for kind in ("q", "tau"))
    channels = haptid.Channels(haptid.Signal(next(names), "rad"), haptid.Signal(next(names), "N m"), time="t")
    treatment = haptid.Treatment(cutoff_hz=CUTOFF_HZ, decimation=DECIMATION)

    def work() -> dict[str, float]:
        stamps = [time.process_time()]
        log = (haptid.open_log if is_long(path) else haptid.read_log)(path, channels)
        stamps.append(time.process_time())
        motion = haptid.treat(log, treatment)
        stamps.append(time.process_time())
        observation = haptid.observe(device, motion)
        stamps.append(time.process_time())
        estimate = haptid.estimate(observation, haptid.WLS())
        assert len(estimate.parameters) == len(device.base)
        stamps.append(time.process_time())
        steps = ("reading", "filtering", "reduction", "estimate")
        return {step: b - a for step, a, b in zip(steps, stamps, stamps[1:], strict=False)}

    return work


def script(path: Path) -> Callable[[], dict[str, float]]:
    """What a good script does, in chunks so that W is never whole."""
    import numpy as np
    import pinocchio
    from pyarrow import parquet
    from scipy import linalg, signal

    model = pinocchio.Model()
    for k in range(JOINTS):
        turned = pinocchio.SE3(pinocchio.utils.rotate("x", np.pi / 2 * (-1) ** k), np.array([0.0, 0.1, 0.2]))
        model.addJoint(k, pinocchio.JointModelRZ(), turned, f"joint{k}")
    data, chunk = model.createData(), 20_000

    def work() -> dict[str, float]:
        table = parquet.read_table(path, use_threads=False)
        q, tau = (np.column_stack([table[f"{kind}{k + 1}"] for k in range(JOINTS)]) for kind in ("q", "tau"))
        q = signal.filtfilt(*signal.butter(4, CUTOFF_HZ, fs=RATE_HZ), q, axis=0)
        qd = np.gradient(q, 1 / RATE_HZ, axis=0)
        qdd = np.gradient(qd, 1 / RATE_HZ, axis=0)
        R = np.zeros((0, 10 * JOINTS + 1))
        for start in range(0, len(q), chunk):
            rows = range(start, min(start + chunk, len(q)))
            W = np.stack([pinocchio.computeJointTorqueRegressor(model, data, q[i], qd[i], qdd[i]) for i in rows])
            y = np.concatenate([W, tau[rows.start : rows.stop, :, None]], axis=2)
            kept = signal.decimate(y, DECIMATION, ftype="fir", axis=0).reshape(-1, 10 * JOINTS + 1)
            R = linalg.qr(np.concatenate([R, kept]), mode="r")[0][: 10 * JOINTS + 1]
        chi = linalg.lstsq(R[:, :-1], R[:, -1])[0]
        assert np.isfinite(chi).all()
        return {}

    return work


def measure(which: str, path: Path) -> dict[str, float]:
    """Seconds and peak memory, GiB, of one of them in a process of its own."""
    call = [sys.executable, __file__, which, str(path)]
    done = subprocess.run(call, check=True, capture_output=True, text=True, env={**os.environ, **THREADS})
    return dict(json.loads(done.stdout.splitlines()[-1]))


def run(sizes: tuple[int, ...] = SIZES) -> dict[str, float]:
    """Seconds of the processor, shares, peak memory, and how many times the script takes."""
    figures: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        for samples in sizes:
            path = Path(name) / f"{samples}.parquet"
            subprocess.run([sys.executable, __file__, "write", str(path), str(samples)], check=True)
            found = measure("ours", path)
            seconds = found.pop("seconds")
            figures[f"{samples} samples, s"] = seconds
            figures[f"{samples} samples, peak memory, GiB"] = found.pop("memory")
            figures |= {f"{samples} samples, share of {step}, %": 100 * v / seconds for step, v in found.items()}
            if samples in SCRIPT_SIZES:
                theirs = measure("script", path)
                figures[f"{samples} samples, script with Pinocchio and SciPy, s"] = theirs["seconds"]
                figures[f"{samples} samples, script, peak memory, GiB"] = theirs["memory"]
                figures[f"{samples} samples, script over haptid"] = theirs["seconds"] / seconds
    return figures


def main() -> None:
    """One of them, in this process; its figures as JSON."""
    import resource
    import time

    which, path = sys.argv[1], Path(sys.argv[2])
    if which == "write":
        write_log(path, int(sys.argv[3]))
        return
    work = {"ours": ours, "script": script}[which](path)
    begin = time.process_time()
    steps = work()
    seconds = time.process_time() - begin
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 if sys.platform == "darwin" else 1) / 2**20
    print(json.dumps({"seconds": seconds, "memory": peak, **steps}))


if __name__ == "__main__":
    main()
