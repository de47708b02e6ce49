"""A data set of 10^8 samples identified file by file: memory, processor time, two workers beside one, what more costs.

The device is the PHANToM, three joints. Every file has noise of its own, and is a file of its own on the disk.
Other programs may share the processors: times are the processor's, ratios are of runs one after the other, and the load
is recorded.
"""

from __future__ import annotations

import csv
import heapq
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import numpy as np
import pyarrow as pa
from pyarrow import parquet

import haptid
from haptid.executors import DaskExecutor
from haptid.study import read_study
from haptid.study.pool import Pool, identify_pool
from long_log import PERIOD, RATE_HZ, periodic_motion

DEVICE = "phantom_premium_15"
SIZES, FILE = (10**5, 10**6, 10**7, 10**8), 500_000
# Files of the runs on a cluster, at three sizes; pairs of runs of the largest with one worker and two; empty tasks.
FILES, PAIRS, EMPTY = (8, 16, 32), 3, 200
# Settings of the C library's allocator in workers. Dask's own give memory back at every array: twice the work.
KEPT = {"MALLOC_TRIM_THRESHOLD_": "1000000000", "MALLOC_MMAP_THRESHOLD_": "33554432"}
# Of the extrapolation: samples, workers, and what is assumed, bytes/s: of each worker, of the store to all together.
SAMPLES, WORKERS, NETWORK, STORE = 10**9, (8, 64), 125e6, 1.25e9
STUDY = f"""
schema = 1
name = "data set"
device = "{DEVICE}"
[channels]
time = "t"
position = {{{{ channels = ["q1", "q2", "q3"], unit = "rad" }}}}
torque = {{{{ channels = ["tau1", "tau2", "tau3"], unit = "N m" }}}}
[[logs]]
path = "{{own}}"
[treatment]
cutoff_hz = 40
decimation = 10
"""


def run(sizes: Sequence[int] = SIZES, place: str | None = None) -> dict[str, float]:
    """Memory and times by size, ratios of workers, errors of the cost model, and what it says of more.

    Args:
        sizes: samples.
        place: folder for the files, 6 GB for 10^8 samples; a temporary one where None.
    """
    with tempfile.TemporaryDirectory(dir=place) as name:
        folder = Path(name)
        write_files(folder / "all", max(sizes))
        figures = {"samples of a file": float(FILE), "load before": os.getloadavg()[1]}
        for size in sizes:
            figures |= {f"{size:.0e} samples: {what}": x for what, x in alone(folder, size).items()}
        figures |= on_a_cluster(folder) | {"load after": os.getloadavg()[1]}
    return figures | extrapolated(figures)


def write_files(folder: Path, samples: int) -> None:
    """Files of one periodic motion each, with noise of its own; the first is short, for the smallest size."""
    folder.mkdir()
    model = haptid.DynamicModel(haptid.read_device(DEVICE))
    rng = np.random.default_rng(0)
    q, tau = periodic_motion(model, rng, 0.25, 1e-3)
    n = len(q)
    noise = 0.05 * tau.std(axis=1, keepdims=True)
    for k in range(max(1, samples // FILE)):
        columns = {"t": np.arange(FILE) / RATE_HZ}
        columns |= {f"q{j + 1}": np.tile(q[j], FILE // PERIOD) for j in range(n)}
        drawn = rng.standard_normal((n, FILE))
        columns |= {f"tau{j + 1}": np.tile(tau[j], FILE // PERIOD) + noise[j] * drawn[j] for j in range(n)}
        parquet.write_table(pa.table(columns), folder / f"part-{k}.parquet", use_dictionary=False, compression="none")


def subset(folder: Path, samples: int) -> Path:
    """A study, and a folder of links to files with that number of samples together; the beginning of one for fewer."""
    own = folder / f"{samples} samples"
    if own.exists():
        return own
    (own / "set").mkdir(parents=True)
    if samples < FILE:
        parquet.write_table(
            parquet.read_table(folder / "all" / "part-0.parquet").slice(0, samples), own / "set" / "part-0.parquet"
        )
    for k in range(samples // FILE):
        (own / "set" / f"part-{k}.parquet").symlink_to(folder / "all" / f"part-{k}.parquet")
    (own / "study.toml").write_text(STUDY.format(own="set/part-0.parquet"))
    return own


def alone(folder: Path, samples: int) -> dict[str, float]:
    """Of the whole command in a process of its own: processor time, memory, error; of its files: processor time."""
    own = subset(folder, samples)
    command = ["pool", str(own / "study.toml"), str(own / "set"), "--out", str(own / "out"), "--quiet"]
    process = subprocess.Popen([sys.executable, "-m", "haptid", *command])
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise RuntimeError(f"haptid pool ended with status {os.waitstatus_to_exitcode(status)}")
    with (own / "out" / "files.csv").open() as file:
        rows = list(csv.DictReader(file))
    found = json.loads((own / "out" / "pool.json").read_text())
    assert not any(row["problem"] for row in rows)
    assert sum(int(row["samples"]) for row in rows) == samples
    return {
        "files": float(len(rows)),
        "processor time, s": usage.ru_utime + usage.ru_stime,
        "of the files, s": sum(float(row["processor"]) for row in rows),
        "peak memory, GiB": usage.ru_maxrss / (1024 if sys.platform == "darwin" else 1) / 2**20,
        "error on unseen blocks, %": found["unseen_error_percent"],
    }


@contextmanager
def cluster(workers: int, kept: dict[str, str]) -> Iterator[str]:
    """Address of a scheduler in this process, with workers in processes of their own and their allocator's settings."""
    import distributed

    with warnings.catch_warnings(), mock.patch.dict(os.environ, kept):
        warnings.simplefilter("ignore")
        local = {"threads_per_worker": 1, "dashboard_address": None}
        with distributed.LocalCluster(n_workers=workers, **local) as made:
            yield made.scheduler_address


def on_a_cluster(folder: Path) -> dict[str, float]:
    """Speed-up of two workers, cost of the scheduler, and errors of the model of the time, at three sizes."""
    figures: dict[str, float] = {}
    sets = {files: subset(folder, files * FILE) for files in FILES}
    with cluster(1, {}) as plain:
        pooled(sets[FILES[0]], plain)
        unkept = work(pooled(sets[FILES[0]], plain)) / FILES[0]
    figures["processor time of a file, workers as Dask starts them, s"] = unkept
    with cluster(1, KEPT) as one, cluster(2, KEPT) as two:
        for address in (one, two):
            pooled(sets[FILES[0]], address)  # everything is imported
        pairs = [[pooled(sets[FILES[-1]], address) for address in (one, two)] for _ in range(PAIRS)]
        figures["one worker's time over that of two, median"] = middle([a.seconds / b.seconds for a, b in pairs])
        figures["one worker's time over that of two, least"] = min(a.seconds / b.seconds for a, b in pairs)
        figures["one worker's time over that of two, greatest"] = max(a.seconds / b.seconds for a, b in pairs)
        figures["two workers, their processor time over that of one"] = middle([work(b) / work(a) for a, b in pairs])
        figures["two workers, time of the clock in files over that of one"] = middle(
            [clock(b) / clock(a) for a, b in pairs]
        )
        for k, workers in enumerate(("one worker", "two workers")):
            shares = [clock(pair[k]) / ((k + 1) * pair[k].seconds) for pair in pairs]
            figures[f"{workers}, share of the run that is in files, median"] = middle(shares)
        figures |= (scheduler := scheduling(two))
        for files in FILES:
            made = pooled(sets[files], two)
            expected = makespan([one.seconds for one in made.files], 2, scheduler["scheduler, s a task"])
            figures[f"{files} files on two workers, s of the clock"] = made.seconds
            figures[f"{files} files on two workers, by the model, s"] = expected
    figures["bytes of a file"] = float(made.files[0].fetched)
    figures["bytes of its R factors"] = float(made.files[0].returned)
    processor = [one.processor for one in made.files]
    figures["processor time of a file, s"] = statistics.fmean(processor)
    figures["slowest file over the mean"] = max(processor) / statistics.fmean(processor)
    return figures


def pooled(own: Path, address: str) -> Pool:
    """A data set on a cluster."""
    return identify_pool(read_study(own / "study.toml"), str(own / "set"), workers=DaskExecutor(address))


def work(made: Pool) -> float:
    """Processor time of all files, s."""
    return sum(one.processor for one in made.files)


def clock(made: Pool) -> float:
    """Time of the clock that workers were at files, s; the rest of a run is scheduling, and waiting for the last."""
    return sum(one.seconds for one in made.files)


def middle(ratios: Sequence[float]) -> float:
    """The median."""
    return float(statistics.median(ratios))


def scheduling(address: str) -> dict[str, float]:
    """Processor time of scheduler and client for a task that does nothing and returns as much as a file does, s."""
    begin = time.process_time()
    done = list(DaskExecutor(address).map(returned, [70_000] * EMPTY))
    assert len(done) == EMPTY
    return {"scheduler, s a task": (time.process_time() - begin) / EMPTY}


def returned(size: int) -> bytes:
    """Zeros of a size in bytes, as a task returns them."""
    return bytes(size)


def makespan(seconds: Sequence[float], workers: int, scheduler: float) -> float:
    """Time until the last task is done: each goes to the worker that is free first, and is scheduled one by one, s."""
    free = [0.0] * workers
    for k, one in enumerate(seconds):
        heapq.heappush(free, max(heapq.heappop(free), (k + 1) * scheduler) + one)
    return max(free)


def extrapolated(figures: dict[str, float]) -> dict[str, float]:
    """What 10^9 samples cost by the model, with the measured work, bytes and slowest file, and an assumed network."""
    made: dict[str, float] = {"assumed: bytes/s of a worker": NETWORK, "assumed: bytes/s of the store": STORE}
    tasks, size = SAMPLES // FILE, figures["bytes of a file"]
    processor, scheduler = figures["processor time of a file, s"], figures["scheduler, s a task"]
    for workers in WORKERS:
        fetching = size / min(NETWORK, STORE / workers)
        times = [fetching + processor] * (tasks - 1) + [(fetching + processor) * figures["slowest file over the mean"]]
        of_all = f"{SAMPLES:.0e} samples on {workers} workers"
        made[f"{of_all}: fetching, s a worker"] = tasks / workers * fetching
        made[f"{of_all}: processor, s a worker"] = tasks / workers * processor
        made[f"{of_all}: scheduler, s"] = tasks * scheduler
        made[f"{of_all}: R factors to the scheduler, s"] = tasks * figures["bytes of its R factors"] / NETWORK
        made[f"{of_all}: waiting for the slowest, s"] = makespan(times, workers, scheduler) - makespan(
            times[:-1], workers, scheduler
        )
        made[f"{of_all}: together, s"] = makespan(times, workers, scheduler)
    return made
