"""Intervals of estimators that simulate the model: how often they hold the truth, and what a smooth friction does.

Two links with dry friction on the virtual bench, noise on the torque, encoders of 4000 counts behind a gear, 5 s at
250 Hz; a hundred motions. Once with dry friction that turns over within a wide band of speeds, and once
as these methods are. Of each: how many of the 95 % intervals hold the truth, over all parameters and of the worst;
the deviation an interval is made with over the true scatter; and the bias over that scatter, of the worst parameter.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy import stats

import bench_identification  # finds the tests' devices
import haptid
from haptid import estimation
from haptid.experiment import bench
from small_study import FRICTION, driven, log_of, two_links
from true_parameters import true_parameters

assert bench_identification
RUNS, SECONDS, RATE_HZ, NOISE, ENCODERS = 100, 5.0, 250.0, 0.02, bench.Encoders((4000.0,), (10.0,))
TREATMENT = haptid.Treatment(cutoff_hz=25, decimation=10, torque_delay_s=0.5 / RATE_HZ, reversal_speed=0.05)
# Widths, as shares of the root mean square speed, that are compared with those of the methods' own.
WIDE = {"OutputErrorMethod": 0.01, "EKF": 0.02}


def methods() -> Mapping[str, haptid.estimation.Method]:
    """What is compared."""
    made: dict[str, haptid.estimation.Method] = {}
    for name, width in WIDE.items():
        made[f"{name}, wide"] = getattr(estimation, name)(friction=width)
        made[name] = getattr(estimation, name)()
    return made


def reading(seed: int) -> dict[str, np.ndarray]:
    """Of one log, by method: estimates less the truth, deviations, and half-widths of intervals, (3, p)."""
    model = two_links()
    log = log_of(driven(seed, SECONDS, RATE_HZ, NOISE, ENCODERS))
    observation = haptid.observe(model, haptid.treat(log, TREATMENT))
    beta = model.base.of(true_parameters(model, **FRICTION))
    made = {}
    for name, method in methods().items():
        found = haptid.estimate(observation, method)
        se = np.sqrt(np.diag(found.covariance))  # also of a filter, which gives no intervals because of these figures
        made[name] = np.array([found.beta - beta, se, stats.t.ppf(0.975, found.dof) * se])
    return made


def run() -> dict[str, float]:
    """Per cent, and shares of the scatter."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(reading, range(RUNS)))
    figures: dict[str, float] = {}
    for name in made[0]:
        error, se, half = np.array([one[name] for one in made]).transpose(1, 0, 2)
        inside, scatter = np.abs(error) <= half, error.std(axis=0)
        figures[f"{name}: intervals that hold the truth, %"] = 100 * float(inside.mean())
        figures[f"{name}: of the worst parameter, %"] = 100 * float(inside.mean(axis=0).min())
        figures[f"{name}: deviation over scatter"] = float(np.median(np.sqrt((se**2).mean(axis=0)) / scatter))
        figures[f"{name}: largest bias over scatter"] = float((np.abs(error.mean(axis=0)) / scatter).max())
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:60s} {figure:.4g}")
