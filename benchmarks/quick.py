"""`make bench-quick`: how fast the present commit is, beside NumPy in the same run, and what became slower.

Each work is measured in turn with a reference, some work of NumPy that takes about as long: both see the same clock and
the same neighbours, so that their ratio is comparable between runs, and the least of each counts. Ratios depend on the
processor nevertheless: they are recorded by back end and processor. On a processor without a record another's ratios
stand beside, and decide nothing. A work that seems slower is measured again before it is named.

    python benchmarks/quick.py              compare, exit status 1 if something is slower by more than 10 %
    python benchmarks/quick.py --record     keep the ratios as the record of this back end and processor
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import haptid
from arm import Arm
from dynamics import search, works
from haptid.dynamics.symbolic import regroupings
from haptid.experiment.bench.trajectories import Trajectory
from haptid.experiment.excitation import motion_condition
from run import machine

RECORD = Path(__file__).parent / "results" / "quick.json"
# Share of a recorded ratio that may be lost; measurements of a work that lost more, before it is named.
SLOWER, TRIES = 0.1, 3
# Turns of each work and its reference, and seconds that one turn takes at least.
TURNS, LONG = 15, 0.02
SAMPLES, ROWS, TAPS, DECIMATION = 8192, 1984, 101, 10
Run = Callable[[], object]


def measured(run: Run, reference: Run) -> float:
    """How many times faster than its reference the work is, of the fastest turns."""
    least = [float("inf"), float("inf")]
    rows = [max(1, round(LONG / once(one))) for one in (run, reference)]
    for _ in range(TURNS):
        for k, one in enumerate((run, reference)):
            begin = time.process_time()
            for _ in range(rows[k]):
                one()
            least[k] = min(least[k], (time.process_time() - begin) / rows[k])
    return least[1] / least[0]


def once(run: Run) -> float:
    """Seconds of a second run."""
    run()
    begin = time.perf_counter()
    run()
    return max(time.perf_counter() - begin, 1e-7)


def started(arguments: list[str]) -> float:
    """Processor time of a command, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def starts(arguments: list[str]) -> float:
    """How many times faster than `import numpy` a command is, of the fastest of some turns."""
    turns = [(started(arguments), started(["-c", "import numpy"])) for _ in range(5)]
    return min(numpy for _, numpy in turns) / min(own for own, _ in turns)


def reductions(arm: Arm) -> dict[str, Run]:
    """A reduction of all samples in one block, as they are and behind a filter."""

    def of(taps: np.ndarray, decimation: int) -> Run:
        half = len(taps) // 2
        rows = (SAMPLES - 2 * half - 1) // decimation + 1
        some = (arm.tau, arm.columns, taps, decimation, half, rows, rows, np.ones((arm.n, rows)))
        return lambda: arm.core.reduce(*arm.motion(SAMPLES), *some)

    return {
        "regressor and reduction": of(np.ones(1), 1),
        "regressor, filter and reduction": of(np.hanning(TAPS + 2)[1:-1], DECIMATION),
    }


def all_works() -> dict[str, Callable[[], float]]:
    """Every work by its name, and what measures its ratio."""
    arm = Arm()
    rng = np.random.default_rng(0)
    rows, square = rng.normal(size=(ROWS, 44)), rng.normal(size=(128, 128))
    qr, product = lambda: np.linalg.qr(rows, mode="r"), lambda: square @ square
    states = (np.ascontiguousarray(x[:, :200].T) for x in (arm.q, arm.qd, arm.qdd))
    motion = Trajectory(0.01, *states)
    cost, slopes = search(arm, motion)
    small = arm.motion(128)
    out = arm.core.regressor(*small, arm.columns)
    cores: dict[str, Run] = {"regressor": lambda: arm.core.regressor(*small, arm.columns, None, out)}
    cores |= {name: work.run for name, work in works(arm).items()} | reductions(arm)
    branch = haptid.DynamicModel(haptid.read_device("cea_medical_branch"))
    python: dict[str, Run] = {
        "condition number of a motion": lambda: motion_condition(arm.model, motion),
        "cost of a motion in a search": cost.run,
        "cost of a motion and its slopes": slopes.run,
        "exact groupings": lambda: regroupings(branch),
    }
    measures = {name: lambda run=run: measured(run, qr) for name, run in cores.items()}
    # What is mostly calls from Python has many short calls as its reference.
    measures |= {
        name: lambda run=run: measured(run, lambda: [product() for _ in range(20)]) for name, run in python.items()
    }
    commands = {"help": ["-m", "haptid", "--help"], "model": ["-m", "haptid", "model", "arm7"]}
    return measures | {f"start: {name}": lambda command=command: starts(command) for name, command in commands.items()}


def lost(name: str, ratio: float, recorded: dict[str, float]) -> bool:
    """Whether a ratio is lower than the record allows."""
    return ratio < (1 - SLOWER) * recorded.get(name, 0.0)


def main() -> int:
    """Measure, print, and compare or record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--record", action="store_true", help="keep the ratios as the record of this back end")
    record = parser.parse_args().record
    where = machine()
    records = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else []
    own = next((one for one in records if same(one["where"], where)), None)
    beside = own or next((one for one in records if one["where"]["backend"] == where["backend"]), None)
    shown = beside["ratios"] if beside else {}
    judged = {} if record or own is None else own["ratios"]
    ratios, slower = {}, []
    for name, measure in all_works().items():
        ratio, tries = measure(), 1
        while lost(name, ratio, judged) and tries < TRIES:
            ratio, tries = max(ratio, measure()), tries + 1
        ratios[name] = round(ratio, 4)
        before = f"{shown[name]:10.3g}" if name in shown else "         -"
        print(f"{name:40s} {ratio:10.3g} {before}  {'SLOWER' if lost(name, ratio, judged) else ''}", flush=True)
        slower += [name] if lost(name, ratio, judged) else []
    if record:
        kept = [one for one in records if one is not own] + [{"where": where, "ratios": ratios}]
        RECORD.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        return 0
    if own is None:
        other = f"; the ratios beside are of {beside['where']['processor']}, and decide nothing" if beside else ""
        print(f"no record of back end {where['backend']} on {where['processor']}{other}: run with --record")
        return 0
    print(f"slower than commit {own['where']['commit']}: {', '.join(slower)}" if slower else "nothing fell")
    return 1 if slower else 0


def same(one: dict[str, str], other: dict[str, str]) -> bool:
    """Whether ratios of two machines are comparable."""
    return all(one[key] == other[key] for key in ("backend", "processor"))


if __name__ == "__main__":
    sys.exit(main())
