"""How much noise in W biases estimates: encoders at half the rate, differentiated far above the motion.

The PHANToM on the virtual bench, exact states of one motion; its log read 20 times at 500 Hz through encoders of 4000
counts, each time from another zero, with noise on the torque. Positions below 90 Hz, no filter for torque and columns:
a poor treatment. Bias: the mean error over all readings, every parameter weighted with the torque that it carries, and
beside it the scatter.
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np

import haptid
from bench_identification import CASES, ENDS, device_of, log_of, record, truth_of
from haptid import estimation
from haptid.experiment import bench
from haptid.simulation import PID

CASE, COUNTS, SECONDS, READINGS, EVERY = CASES["PHANToM, one parallelogram"], 4000.0, 10.0, 20, 2
NOISE, TREATMENT = 5e-3, haptid.Treatment(cutoff_hz=90.0, torque_delay_s=5e-4)
NAMES = ("OLS", "IV", "DIDIM", "CLIE")
# With so much noise in the columns the simulated motion settles slowly, and IV not below a tenth of a deviation.
PASSES, SETTLED = 40, 0.3


@cache
def exact() -> bench.Recording:
    """One motion."""
    return record(CASE, 1, None, SECONDS)


def methods() -> dict[str, haptid.estimation.Method]:
    """What is compared."""
    target = exact().target[ENDS:-ENDS:EVERY]
    law = PID(CASE.kp, CASE.kd, reference=(target,), velocity_cutoff_hz=100.0, rate_hz=1000.0)
    simulated = {name: getattr(estimation, name)(law, most=PASSES, tolerance=SETTLED) for name in NAMES[1:]}
    return {"OLS": haptid.OLS(), **simulated}


def errors(reading: int) -> dict[str, np.ndarray]:
    """Of one reading, errors by method, each in units of torque: (p,), N m."""
    model, rng = device_of(CASE), np.random.default_rng(reading)
    whole = log_of(CASE, exact())
    step = 2 * np.pi / (COUNTS * np.array(CASE.gear))
    zero = rng.uniform(0, 1, len(step))
    position = step * (np.round(whole.position[::EVERY] / step + zero) - zero)
    gain = np.array([motor.gear_ratio * motor.torque_constant for motor in model.device.motors])
    torque = whole.torque[::EVERY] + NOISE / gain * rng.standard_normal(position.shape)
    log = haptid.Log(Path("bench"), "", whole.t[::EVERY], position, torque, whole.channels)
    observation = haptid.observe(model, haptid.treat(log, TREATMENT))
    carried = np.sqrt((observation.stack()[:-1, :-1] ** 2).sum(axis=0) / observation.rows)
    beta = model.base.of(truth_of(CASE))
    return {name: carried * (haptid.estimate(observation, how).beta - beta) for name, how in methods().items()}


def run() -> dict[str, float]:
    """Bias and scatter of every method, and how much less biased than OLS it is."""
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(errors, range(READINGS)))
    figures: dict[str, float] = {}
    for name in NAMES:
        found = np.array([one[name] for one in made])
        figures[f"{name}: bias, N m"] = float(np.linalg.norm(found.mean(axis=0)))
        figures[f"{name}: scatter, N m"] = float(np.linalg.norm(found.std(axis=0)))
    for name in NAMES[1:]:
        figures[f"{name}: times less biased than OLS"] = figures["OLS: bias, N m"] / figures[f"{name}: bias, N m"]
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:45s} {figure:.4g}")
