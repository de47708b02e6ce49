"""How near methods come to the least deviation that is possible, and what wild rows do to them.

The PHANToM with friction, 10 s of multisine at 1 kHz, exact motion. Efficiency: root mean square error over all
parameters and runs, each in units of its Cramer-Rao bound for normal noise of the known covariance; 1 is the bound.
Outliers: a fifth of the torque's samples are off by ten times the noise, both ways or all one way; root mean square
error beside that of OLS.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import haptid
from haptid.estimation import GLS, IRLS, SUR, Huber, Method, StudentT, Tukey
from haptid.estimation.intervals.model_based import Autoregression
from haptid.estimation.least_squares import solve
from haptid.estimation.methods.gls import Whitening
from haptid.observation.rows import Rows

sys.path.insert(0, str(Path(__file__).resolve().parent))
from coverage import NOISE, clean_motion, noise

# Of the method that a noise is meant for, of others, and of those with wild rows; a worst parameter is to be told
# from the bound.
MANY, RUNS, FEW = 1500, 150, 30
SECONDS = 10.0
OUTLIERS, SIZE = 0.2, 10.0


def bound(observation: haptid.Observation, se: np.ndarray, phi: float) -> np.ndarray:
    """Least deviation of every parameter for AR(1) noise of known deviation and coefficient, (p,)."""
    filters = (np.ones(1), np.array([1.0, -phi]))
    models = [Autoregression(filters, s**2 * np.array([1.0, 1.0 - phi**2])) for s in se]
    seen = Rows(observation).folded(Whitening(models))
    return np.asarray(np.linalg.norm(solve(seen, np.ones(len(se))).root, axis=1))


def errors(method: Method, phi: float, runs: int, shared: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Errors of every run and parameter in units of the bound, (runs, p), and stated deviations in the same."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    motion, beta = clean_motion("phantom_premium_15", SECONDS, haptid.Treatment(cutoff_hz=None))
    se, rng = NOISE * motion.tau.std(axis=0), np.random.default_rng(3)
    least = bound(haptid.observe(model, motion), se, phi)
    found, stated = [], []
    for _ in range(runs):
        made = noise((len(se), len(motion)), phi, shared, rng).T
        estimate = haptid.estimate(haptid.observe(model, replace(motion, tau=motion.tau + se * made)), method)
        found.append((estimate.beta - beta) / least)
        stated.append(estimate.se / least)
    return np.array(found), np.array(stated)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def wild(method: Method, one_way: bool) -> float:
    """Root mean square error with outliers, in units of the bound without."""
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    motion, beta = clean_motion("phantom_premium_15", SECONDS, haptid.Treatment(cutoff_hz=None))
    se, rng, found = NOISE * motion.tau.std(axis=0), np.random.default_rng(4), []
    least = bound(haptid.observe(model, motion), se, 0.0)
    for _ in range(FEW):
        made = rng.standard_normal(motion.tau.shape)
        sign = 1.0 if one_way else rng.choice([-1.0, 1.0], made.shape)
        made = np.where(rng.random(made.shape) < OUTLIERS, SIZE * sign * (1 + rng.random(made.shape)), made)
        estimate = haptid.estimate(haptid.observe(model, replace(motion, tau=motion.tau + se * made)), method)
        found.append((estimate.beta - beta) / least)
    return rms(np.array(found))


def run() -> dict[str, float]:
    """Ratios."""
    figures = {}
    for name, phi in (("white", 0.0), ("AR(1) 0.95", 0.95), ("AR(1) 0.99", 0.99)):
        for method in (haptid.WLS(), GLS()):
            found, stated = errors(method, phi, MANY if isinstance(method, GLS) == bool(phi) else RUNS)
            figures[f"{name}: {method.name}, error relative to the Cramer-Rao bound"] = rms(found)
            figures[f"{name}: {method.name}, worst parameter"] = float(np.sqrt((found**2).mean(axis=0)).max())
            figures[f"{name}: {method.name}, stated standard error relative to its error"] = rms(stated) / rms(found)
    alone, _ = errors(haptid.WLS(), 0.0, FEW, 0.9)
    together, _ = errors(SUR(), 0.0, FEW, 0.9)
    figures["white, motors correlated by 0.9: SUR error relative to WLS"] = rms(together) / rms(alone)
    for way, one_way in (("both ways", False), ("one way", True)):
        plain = wild(haptid.OLS(), one_way)
        figures[f"a fifth outliers, {way}: OLS, error relative to the bound without"] = plain
        for robust in (IRLS(Huber()), IRLS(Tukey()), IRLS(StudentT())):
            figures[f"a fifth outliers, {way}: OLS error relative to {robust.name}"] = plain / wild(robust, one_way)
    return figures
