"""Coverage of the default path's intervals: many logs of each of a few classes, with new truth, motion and noise.

The draw of the zoo has every flaw at once, and few logs of each; it says how far off the worst is. Here a class has one
device and one flaw, so that coverage is known to a few per cent and its cause is known where it is low.
"""

from __future__ import annotations

import tempfile
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import haptid
from haptid.study.identify import identify
from haptid.study.read import read_study
from zoo.case import Case
from zoo.plant import Plant
from zoo.recording import record, write
from zoo.score import delays

LEVEL = 0.95
# A parameter that is inside less often is a defect, and the level of the test of all parameters of a class for it.
LEAST, TEST = 0.90, 0.05
CLASSES: dict[str, Case] = {
    "white torque noise": Case(0, "arm2", 500, 12, 2.0, 3, bits=16, level=0.02, delay=0.5),
    "AR(1) torque noise": Case(0, "arm2", 500, 20, 1.5, 3, bits=16, noise="AR", level=0.03, delay=1.0),
    "random-walk torque noise": Case(0, "pendulum", 200, 30, 1.0, 3, bits=16, noise="walk", level=0.02, delay=0.5),
    "encoder of 11 bits": Case(0, "arm2", 500, 12, 1.5, 3, bits=11, level=0.01, delay=0.5),
    "encoder of 12 bits, AR(1) torque noise": Case(0, "pendulum", 250, 20, 1.0, 4, bits=12, noise="AR", level=0.02),
    "encoder ripple": Case(0, "arm2", 500, 12, 1.0, 3, bits=13, encoder="ripple", steps=2.0, level=0.01),
    "coloured encoder noise": Case(0, "arm2", 500, 12, 1.0, 3, bits=15, encoder="AR", steps=4.0, level=0.01),
    "stale rows": Case(0, "arm2", 200, 16, 0.8, 3, bits=16, stale=0.13, level=0.01, delay=1.0),
    "jitter": Case(0, "pendulum", 500, 12, 1.0, 3, bits=16, jitter=0.6, level=0.01, delay=0.5),
    "a delay of each motor": Case(0, "arm2", 500, 16, 2.0, 3, bits=17, noise="AR", delay=1.0, spread=0.5),
    "12 Hz at 200 Hz": Case(0, "arm2", 200, 20, 12.0, 4, bits=18, friction=0.5, level=0.01, delay=0.5),
    "12 Hz at 200 Hz, tens of steps": Case(0, "arm2", 200, 20, 12.0, 4, bits=15, friction=0.5, level=0.01, delay=0.5),
    "slow motion, much friction": Case(0, "axis", 100, 60, 0.15, 3, bits=14, friction=0.8, noise="AR", delay=0.5),
    "noise inside the loop": Case(0, "pendulum", 500, 10, 1.5, 3, bits=16, level=0.01, loop=True, delay=1.0),
    "50 Hz": Case(0, "arm2", 50, 60, 1.0, 5, bits=16, friction=0.5, level=0.02, delay=0.5),
}


def logs_of(name: str, count: int, seed: int) -> Iterator[Case]:
    """Logs of a class; each has bodies, motion and noise of its own."""
    own = zlib.crc32(name.encode()) % 1000  # another class in the list changes no logs
    for k in range(count):
        yield replace(CLASSES[name], seed=(1000 * seed + own) * 100_000 + k)


def covered(case: Case) -> dict[str, Any]:
    """Errors of one log's parameters and delays over their standard errors, and which intervals hold the truth."""
    plant = Plant(case)
    made = record(plant)
    row: dict[str, Any] = {"seed": case.seed}
    with tempfile.TemporaryDirectory() as folder:
        study = write(plant, made, Path(folder))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                # Parameters are quoted from the free fit: the choice of the model for use changes no interval.
                found = identify(replace(read_study(study), use="free", cross_validation=None))
        except haptid.errors.HaptidError as error:
            return row | {"status": f"refused: {type(error).__name__}"}
    estimate = found.estimate
    low, high = np.asarray(estimate.conf_int(LEVEL)).T
    late, se = delays(found, len(made.delays))
    told = found.proposal.delays
    ends = None if told is None else told.conf_int(LEVEL).T
    return row | {
        "status": estimate.status,
        "names": list(estimate.names),
        "inside": ((low <= plant.beta) & (plant.beta <= high)).tolist(),
        "off": ((estimate.beta - plant.beta) / np.maximum(estimate.se, 1e-300)).tolist(),
        "delay off": None if se is None else ((late - made.delays) / np.maximum(se, 1e-300)).tolist(),
        "delay inside": None if ends is None else ((ends[0] <= made.delays) & (made.delays <= ends[1])).tolist(),
    }


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Coverage of the logs of a class whose status is "ok".

    Returns:
        Logs in all and ok; mean coverage with its 95 % Monte Carlo interval, over logs, since the intervals of one log
        are not independent; the worst parameter with its p-value by Holm's step-down test, and the parameters that it
        finds below 90 %; delays within two standard errors, and within their intervals.
    """
    ok = [row for row in rows if row["status"] == "ok"]
    if len(ok) < 2:
        return {"logs": len(rows), "ok": len(ok)}
    inside = np.array([row["inside"] for row in ok], dtype=float)
    of_log = inside.mean(axis=1)
    half = float(stats.t.ppf(0.975, len(ok) - 1) * of_log.std(ddof=1) / np.sqrt(len(ok)))
    hits, names = inside.sum(axis=0), ok[0]["names"]
    p = stats.binom.cdf(hits, len(ok), LEAST)
    late = np.array([row["delay off"] for row in ok if row["delay off"] is not None])
    held = np.array([row["delay inside"] for row in ok if row["delay inside"] is not None], dtype=float)
    return {
        "logs": len(rows),
        "ok": len(ok),
        "covered": float(inside.mean()),
        "monte carlo interval": [float(inside.mean()) - half, min(1.0, float(inside.mean()) + half)],
        "least": float(hits.min() / len(ok)),
        "p of least": float(min(1.0, len(hits) * p.min())),
        "least of": names[int(hits.argmin())],
        "below 90 %": [names[k] for k in holm(p, TEST)],
        "delays within 2 se": float(np.mean(np.abs(late) <= 2)) if late.size else float("nan"),
        "delays inside": float(held.mean()) if held.size else float("nan"),
    }


def holm(p: np.ndarray, level: float) -> list[int]:
    """Indices of the hypotheses that Holm's step-down procedure rejects; Holm (1979), Scand. J. Statist. 6."""
    rejected: list[int] = []
    for k, index in enumerate(np.argsort(p, kind="stable")):
        if p[index] > level / (len(p) - k):
            break
        rejected.append(int(index))
    return rejected


def study(count: int, seed: int, jobs: int, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each class with its figures, as they are made."""
    with ProcessPoolExecutor(jobs) as pool:
        for name in names:
            yield name, figures(list(pool.map(covered, logs_of(name, count, seed))))


def line(name: str, f: Mapping[str, Any]) -> str:
    """A class in one line."""
    if "covered" not in f:
        return f"{name:40} {f['ok']:4d} of {f['logs']:4d} ok"
    low, high = f["monte carlo interval"]
    below = f", below 90 %: {', '.join(f['below 90 %'])}" if f["below 90 %"] else ""
    return (
        f"{name:40} {f['ok']:4d} of {f['logs']:4d} ok; "
        f"{100 * f['covered']:5.1f} % [{100 * low:.1f}, {100 * high:.1f}]; "
        f"least {100 * f['least']:.0f} % ({f['least of']}); delays {100 * f['delays inside']:.1f} %{below}"
    )
