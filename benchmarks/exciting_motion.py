"""Motions of one branch of the CEA interface that tell its 34 base parameters well: the examples, and one call's."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

import haptid
from haptid.experiment import bench
from haptid.experiment.bench.limits import loop_conditioning
from haptid.experiment.excitation import FourierSeries, Limits, Search, design_excitation, observed_motion, quality

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "cea"
# What is sought: positions about a centre, rad, to either side of it, degrees; speed, rad/s; acceleration, rad/s^2.
CENTRE, STROKE, SPEED, ACCELERATION = (-0.3757, -1.5968, 3.1288), 75.0, 13.0, 200.0
TRIES = 1600


def sought() -> dict[str, float]:
    """Condition numbers that one call reaches, one descent and a little, and how long it takes."""
    model, half = haptid.DynamicModel(haptid.read_device("cea_medical_branch")), float(np.radians(STROKE))
    within = Limits(tuple((x - half, x + half) for x in CENTRE), (SPEED,), (ACCELERATION,))
    start = time.process_time()
    found = design_excitation(model, FourierSeries(), within, search=Search(tries=TRIES))
    return {
        "design, condition raw": found.after.raw,
        "design, condition with unit columns": found.after.scaled,
        "design, processor time, s": time.process_time() - start,
    }


# Searches whose progress is recorded: device, limits, motions searched among. Limits of arm7 are made up, as it is.
RACES = {
    "phantom_premium_15": (Limits(((-0.8, 0.8), (-0.4, 0.8), (-0.3, 0.9)), (3.0,)), FourierSeries()),
    "arm7": (Limits(((-2.0, 2.0),) * 7, (2.0,), (10.0,)), FourierSeries(count=5)),
}
# Processor times at which the least condition number so far is recorded.
SECONDS = (1.0, 2.0, 5.0, 10.0)


def races() -> dict[str, float]:
    """Least condition number after some processor time: the curve of the best so far."""
    figures: dict[str, float] = {}
    for name, (within, family) in RACES.items():
        model, curve = haptid.DynamicModel(haptid.read_device(name)), list[tuple[float, float]]()
        start = time.process_time()

        def note(_: float, cost: float, curve: list[tuple[float, float]] = curve, start: float = start) -> None:
            curve.append((time.process_time() - start, cost))

        found = design_excitation(model, family, within, search=Search(tries=TRIES), progress=note)
        lasted = time.process_time() - start
        for seconds in SECONDS:
            so_far = [cost for at, cost in curve if at <= seconds]
            if seconds < lasted and so_far and np.isfinite(so_far[-1]):
                figures[f"{name}, condition with unit columns after {seconds:g} s"] = float(np.exp(so_far[-1]))
        figures[f"{name}, condition with unit columns"] = found.after.scaled
        figures[f"{name}, processor time, s"] = lasted
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
    return figures | sought() | races()
