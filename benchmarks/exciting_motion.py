"""Motions of one branch of the CEA interface that tell its 34 base parameters well: the examples, and one call's."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

import haptid
from haptid.experiment import bench
from haptid.experiment.bench.limits import loop_conditioning
from haptid.experiment.excitation import (
    Excitation,
    FourierSeries,
    Limits,
    ScaledCondition,
    Search,
    design_excitation,
    observed_motion,
    quality,
)

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "cea"
# What is sought: positions about a centre, rad, to either side of it, degrees; speed, rad/s; acceleration, rad/s^2.
CENTRE, STROKE, SPEED, ACCELERATION = (-0.3757, -1.5968, 3.1288), 75.0, 13.0, 200.0


# Searches whose progress is recorded: device, limits, motions searched among, evaluations: as many as take two
# seconds of a core of 2026, and four for the arm. Limits of arm7 are made up, as it is.
HALF = float(np.radians(STROKE))
RACES = {
    "cea_medical_branch": (
        Limits(tuple((x - HALF, x + HALF) for x in CENTRE), (SPEED,), (ACCELERATION,)),
        FourierSeries(),
        480,
    ),
    "phantom_premium_15": (Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,)), FourierSeries(), 700),
    "arm7": (Limits(((-2.0, 2.0),) * 7, (2.0,), (10.0,)), FourierSeries(count=5), 1500),
}
# Processor times at which the least condition number so far is recorded; seeds; how many times longer a long search is.
SECONDS, SEEDS, LONG = (0.5, 1.0, 2.0, 4.0), 3, 10


def race(name: str, tries: int, seed: int) -> tuple[Excitation, list[tuple[float, float]], float]:
    """A motion found, processor time, s, and least condition number at each improvement, and the time of the search.

    The clock is read at improvements only: where it takes a system call, one at each evaluation is a third of the time.
    """
    within, family, _ = RACES[name]
    model, curve = haptid.DynamicModel(haptid.read_device(name)), list[tuple[float, float]]()
    search = Search(tries=tries, seed=seed)
    start = time.process_time()

    def note(_: float, cost: float) -> None:
        found = float(np.exp(min(cost, 100.0)))
        if not curve or found < curve[-1][1]:
            curve.append((time.process_time() - start, found))

    found = design_excitation(model, family, within, criterion=ScaledCondition(), search=search, progress=note)
    return found, curve, time.process_time() - start


def races() -> dict[str, float]:
    """Condition number after some processor time and at the end, median over seeds, beside that of a long search."""
    figures: dict[str, float] = {}
    for name, (_, _, tries) in RACES.items():
        runs = [race(name, tries, seed) for seed in range(SEEDS)]
        for seconds in SECONDS:
            so_far = [next((c for t, c in reversed(curve) if t <= seconds), np.inf) for _, curve, _ in runs]
            if seconds < min(whole for _, _, whole in runs):
                figures[f"{name}, condition with unit columns after {seconds:g} s"] = float(np.median(so_far))
        figures[f"{name}, condition raw"] = float(np.median([found.after.raw for found, _, _ in runs]))
        ends = [found.after.scaled for found, _, _ in runs]
        figures[f"{name}, condition with unit columns"] = float(np.median(ends))
        figures[f"{name}, worst condition with unit columns"] = max(ends)
        figures[f"{name}, evaluations"] = tries
        figures[f"{name}, processor time, s"] = float(np.median([whole for _, _, whole in runs]))
        found, _, _ = race(name, LONG * tries, SEEDS)
        figures[f"{name}, condition with unit columns of a long search"] = found.after.scaled
    return figures


def run() -> dict[str, float]:
    """Condition numbers, with all 34 columns, of the examples, with their strokes and rates, and of what is sought."""
    model, figures = haptid.DynamicModel(haptid.read_device("cea_medical_branch")), {}
    for name in ("experiment", "excite", "excite-wide"):
        experiment = bench.read_experiment(EXAMPLES / f"{name}.toml")
        beta = model.base.of(experiment.setup(model).chi)
        rng = np.random.default_rng(np.random.SeedSequence(experiment.seed).spawn(2)[0])
        made = bench.plan(experiment.kind, model, 1e-3, rng)
        found = quality(observed_motion(model, made), tuple(range(len(beta))), beta, np.full(3, 0.01))
        tau = haptid.inverse_dynamics(model, beta, made.q.T, made.qd.T, made.qdd.T)
        figures[f"{name}, condition raw"] = found.raw
        figures[f"{name}, condition with unit columns"] = found.scaled
        figures[f"{name}, half stroke, deg"] = float(np.degrees(np.ptp(made.q, axis=0) / 2).max())
        figures[f"{name}, speed, rad/s"] = float(np.abs(made.qd).max())
        figures[f"{name}, acceleration, rad/s^2"] = float(np.abs(made.qdd).max())
        figures[f"{name}, torque, N m"] = float(np.abs(tau).max())
        loops = loop_conditioning(model, model.device.closure.positions(made.q[::10].T).T)
        figures[f"{name}, least distance of a loop from flat"] = float(loops.min())
    return figures | races()
