"""Threads, processes and long runs: `python -m fuzz.long_runs --calls 10000 --interrupts 100`.

`identify` in eight threads, in a forked and in a spawned process gives the numbers of one call; --calls of them in one
process take no more memory and no more descriptors; Ctrl-C at random moments of the command, its start included, ends
it with status 130 (or 0, where it was done) and without a traceback. Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import numpy as np

import haptid
from fuzz.interruptions import command, study

THREADS = 8
# Memory that calls may add beyond those of the first tenth, bytes a call: a leak of one log is 50 times that.
MOST_GROWTH = 2_000


def numbers(path: Path) -> list[float]:
    """Values and standard errors of an identification."""
    found = haptid.identify(haptid.read_study(path)).estimate
    return [*found.beta.tolist(), *found.se.tolist()]


def by_all_ways(path: Path, threads: int = THREADS) -> dict[str, int]:
    """Calls that differ from one in this thread, by way."""
    wanted = np.array(numbers(path))

    def wrong(found: list[list[float]]) -> int:
        return sum(not np.allclose(one, wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max()) for one in found)

    made = {}
    with ThreadPoolExecutor(threads) as pool:
        made[f"{threads} threads"] = wrong(list(pool.map(numbers, [path] * threads)))
    for start in ("fork", "spawn"):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(start)) as pool:
            made[start] = wrong([pool.submit(numbers, path).result(timeout=600)])
    return made


def state() -> tuple[int, int]:
    """Resident memory of this process, bytes, and its open descriptors."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize(), len(os.listdir("/proc/self/fd"))


def many(path: Path, calls: int) -> tuple[float, int]:
    """Growth of memory, bytes a call, and of descriptors, over calls after the first tenth."""
    first = max(calls // 10, 1)
    for _ in range(first):
        numbers(path)
    memory, descriptors = state()
    for _ in range(calls - first):
        numbers(path)
    after, there = state()
    return (after - memory) / max(calls - first, 1), there - descriptors


def interrupted(folder: Path, count: int, seed: int) -> list[str]:
    """What runs did on SIGINT that they should not."""
    rng, line, found = random.Random(seed), command("identify", folder), []
    start = time.monotonic()
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
    lasted = time.monotonic() - start
    for _ in range(count):
        with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
            at = lasted * rng.uniform(0.0, 1.0)
            time.sleep(at)
            run.send_signal(signal.SIGINT)
            _, said = run.communicate()
        # -2: before Python itself listens, or in its import of the standard library.
        if run.returncode not in (0, 130, -2) or ("Traceback" in said and "haptid" in said):
            found.append(f"after {at:.2f} s: status {run.returncode}, {said[-300:]}")
    return found


def main() -> int:
    """All of it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=100)
    parser.add_argument("--interrupts", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        path = study(Path(name))
        differ = by_all_ways(path)
        sys.stdout.write(f"calls that differ: {differ}\n")
        growth, descriptors = many(path, given.calls)
        sys.stdout.write(f"{given.calls} calls: {growth:.0f} bytes a call more, {descriptors} descriptors more\n")
        sys.stdout.flush()
        faults = interrupted(Path(name), given.interrupts, given.seed)
        sys.stdout.write(f"{given.interrupts} interrupts: {len(faults)} faults\n" + "".join(f"  {x}\n" for x in faults))
    return int(bool(any(differ.values()) or growth > MOST_GROWTH or descriptors > 0 or faults))


if __name__ == "__main__":
    sys.exit(main())
