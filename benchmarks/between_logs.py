"""Do intervals over days hold the mean day, and those of a repeat the estimate from one more log?

Three devices, three to six logs of 6 s; friction, torque constants (temperature) and home offsets are drawn anew for
each log, or stay. Logs of one motion, and of different ones. Coverage of 95 % intervals, per cent, over all parameters
and of the worst and best one: that of the estimate (blocks, the mean of these logs), over days, and of a repeat; the
median width of the interval over days in units of the estimate's.

    python benchmarks/between_logs.py [--repetitions 300]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402

import haptid  # noqa: E402
from days import Days  # noqa: E402
from small_study import two_links  # noqa: E402

RESULTS = Path(__file__).resolve().parent / "results" / "between-logs.json"
FRICTION = {"two links": (0.05, 0.2), "phantom_premium_15": (6e-4, 0.02), "arm3": (0.05, 0.2)}
# Device, logs, size of what changes between them, and whether they have one motion.
CASES = [
    ("two links", 3, 0.0, False),
    ("two links", 3, 1.0, True),
    ("two links", 3, 1.0, False),
    ("two links", 3, 0.1, False),
    ("two links", 6, 1.0, False),
    ("phantom_premium_15", 3, 0.0, False),
    ("phantom_premium_15", 3, 1.0, False),
    ("phantom_premium_15", 6, 1.0, False),
    ("arm3", 3, 0.0, False),
    ("arm3", 3, 1.0, False),
    ("arm3", 5, 1.0, True),
    ("arm3", 5, 1.0, False),
]
PHI = 0.9


@cache
def days(name: str, size: float) -> Days:
    """A device and how much changes."""
    model = two_links() if name == "two links" else haptid.DynamicModel(haptid.read_device(name))
    return Days(model, size, phi=PHI, friction=FRICTION[name])


def drawn(case: tuple[str, int, float, bool], seed: int) -> np.ndarray:
    """Of one experiment: what each interval holds, (3, p), and the widths' ratio and whether any is said to scatter."""
    name, logs, size, same = case
    made, rng = days(name, size), np.random.default_rng([seed, logs, int(100 * size), same])
    seeds = [1] * (logs + 1) if same else [100 * seed + k for k in range(logs + 1)]
    motions = [made.log(rng, k) for k in seeds]
    found = haptid.estimate(haptid.observe(made.model, *motions[:-1]), haptid.WLS())
    again = haptid.estimate(haptid.observe(made.model, motions[-1]), haptid.WLS()).beta
    between = found.between_logs
    assert between is not None
    ends = (found.conf_int(), between.conf_int(), between.repeat_conf_int())
    wanted = (made.beta, made.beta, again)
    holds = [(low_high[:, 0] <= x) & (x <= low_high[:, 1]) for low_high, x in zip(ends, wanted, strict=True)]
    wide = np.ptp(ends[1], axis=1) / np.ptp(ends[0], axis=1)
    return np.array([*holds, wide, np.full(len(wide), bool(between.differs()))], dtype=float)


def study(repetitions: int) -> dict[str, dict[str, float]]:
    """All cases."""
    figures = {}
    with ProcessPoolExecutor(int(os.environ.get("HAPTID_WORKERS", os.cpu_count() or 1))) as pool:
        for case in CASES:
            name, logs, size, same = case
            found = np.array(list(pool.map(drawn, [case] * repetitions, range(repetitions), chunksize=10)))
            each = found.mean(axis=0)
            key = f"{name}, {logs} logs of {'one motion' if same else 'different motions'}, changes x {size:g}"
            figures[key] = {
                f"{what}: {kind}": round(100 * float(of(each[k])), 1)
                for k, what in enumerate(("these logs", "over days", "a repeat"))
                for kind, of in (("mean", np.mean), ("worst", np.min), ("best", np.max))
            }
            figures[key]["median width over days / of these logs"] = round(float(np.nanmedian(found[:, 3])), 2)
            figures[key]["said to scatter, per cent of experiments"] = round(100 * float(found[:, 4, 0].mean()), 1)
    return figures


def main() -> None:
    """Run, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=300)
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    made = {"repetitions": given.repetitions, **study(given.repetitions)}
    given.out.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(made, indent=1))


if __name__ == "__main__":
    main()
