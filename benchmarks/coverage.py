"""Do 95 % intervals hold the truth 95 times in 100? Residuals white, and correlated as they are in practice.

Three devices with friction, 20 s of multisine at 1 kHz, exact motion, many draws of noise on the same columns: white,
AR(1) 0.95 and 0.99, and AR(1) 0.95 shared by the motors, as it is and with parallel filter and decimation by 10. Then
the PHANToM with encoders of 4000 counts, treated as proposed, a new motion in each run; and how often a Stribeck effect
that the model lacks is seen by the misfit test. Shares of intervals that hold the truth, per cent, over all parameters
and for the worst and best one: the default interval's, the classical one, and, of one device, the others'.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy import signal, stats

import haptid
from haptid.estimation import BlockJackknife, Bootstrap, ClusterRobust, FixedB, Intervals, Sandwich
from haptid.observation.filtering import decimate
from haptid.observation.rows import Rows

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from diagnosed import estimated, log, phantom
from haptid.inference.diagnosis import diagnose
from motions import multisine, truth

RUNS, FEW, SANDWICHES, LOGS = 2400, 150, 60, 200
ENCODER_RUNS = 600
SECONDS = 20.0
DEVICES = ("phantom_premium_15", "arm3", "cea_medical_branch")
# AR(1) coefficient, and correlation between motors.
NOISES = {
    "white": (0.0, 0.0),
    "AR(1) 0.95": (0.95, 0.0),
    "AR(1) 0.99": (0.99, 0.0),
    "AR(1) 0.95 shared by motors": (0.95, 0.7),
}
TREATMENTS = {
    "as it is": haptid.Treatment(cutoff_hz=None),
    "filtered and decimated by 10": haptid.Treatment(cutoff_hz=None, decimation=10),
}
# Of each torque's own deviation.
NOISE = 0.1


def clean_motion(name: str, seconds: float, treatment: haptid.Treatment) -> tuple[haptid.Motion, np.ndarray]:
    """A multisine with exact rates and exact torque, and the parameters."""
    model = haptid.DynamicModel(haptid.read_device(name))
    beta = truth(model)
    q, qd, qdd = multisine(len(model.device.active), seconds, 1e-3, 1)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)[list(model.device.measured)]
    return haptid.Motion(1e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T)), beta


def noise(shape: tuple[int, int], phi: float, shared: float, rng: np.random.Generator) -> np.ndarray:
    """Autoregressive noise of unit variance, (motors, samples)."""
    burn = 3000 if phi else 0
    white = rng.standard_normal((shape[0], shape[1] + burn)) * np.sqrt(1 - phi**2)
    mixed = np.linalg.cholesky((1 - shared) * np.eye(shape[0]) + shared) @ white
    return np.asarray(signal.lfilter([1.0], [1.0, -phi], mixed, axis=1))[:, burn:]


@dataclass(frozen=True, eq=False)
class Bed:
    """Rows whose columns stay and whose torque is drawn anew: only z and the rest of each triangle change.

    Attributes:
        observation: of the clean motion.
        beta: true parameters.
        Q: by motor and block, (rows, columns); the r_factors' R belongs to them.
        clean: torque of the clean rows, (motors, rows), and the deviation of each motor's.
        edges: first row of each block, and one past the last.
    """

    observation: haptid.Observation
    beta: np.ndarray
    Q: list[list[np.ndarray]]
    R: list[np.ndarray]
    clean: np.ndarray
    edges: np.ndarray

    @staticmethod
    def of(name: str, seconds: float, treatment: haptid.Treatment) -> Bed:
        """All rows of a clean motion."""
        motion, beta = clean_motion(name, seconds, treatment)
        observation = haptid.observe(haptid.DynamicModel(haptid.read_device(name)), motion)
        (rows,) = Rows(observation)
        Q, R = [], []
        for motor, W in zip(observation.motors, rows.W, strict=True):
            parts = [np.linalg.qr(part[:, motor.columns]) for part in np.split(W, rows.edges[1:-1])]
            Q.append([part[0] for part in parts])
            R.append(np.array([part[1] for part in parts]))
        return Bed(observation, beta, Q, R, rows.y, rows.edges)

    def drawn(self, phi: float, shared: float, rng: np.random.Generator) -> haptid.Observation:
        """The same rows, with noise on their torque."""
        motion = self.observation.motions[0]
        made = noise((len(self.clean), len(motion)), phi, shared, rng)
        taps, d = motion.treatment.taps(motion.dt), motion.treatment.decimation
        y = self.clean + NOISE * motion.tau.std(axis=0)[:, None] * decimate(made, taps, d)
        motors = []
        for k, motor in enumerate(self.observation.motors):
            parts = np.split(y[k], self.edges[1:-1])
            T = np.zeros_like(motor.r_factors)
            T[:, :-1, :-1] = self.R[k]
            for block, (Q, part) in enumerate(zip(self.Q[k], parts, strict=True)):
                z = Q.T @ part
                T[block, :-1, -1], T[block, -1, -1] = z, np.sqrt(max(part @ part - z @ z, 0.0))
            motors.append(replace(motor, r_factors=T))
        return replace(self.observation, motors=tuple(motors))


def holds(found: haptid.Estimate, beta: np.ndarray) -> np.ndarray:
    """Whether each interval holds the truth."""
    low, high = found.conf_int().T
    return np.asarray((low <= beta) & (beta <= high))


def classical_holds(found: haptid.Estimate, beta: np.ndarray) -> np.ndarray:
    """The same of the classical interval."""
    wide = stats.norm.ppf(0.975) * np.sqrt(np.diag(found.classical_covariance))
    return np.asarray(np.abs(found.beta - beta) <= wide)


def shares(
    bed: Bed, phi: float, shared: float, runs: int, others: tuple[Intervals, ...] = ()
) -> tuple[np.ndarray, ...]:
    """Share of runs whose interval holds the truth, by parameter: default, classical and each other kind."""
    rng = np.random.default_rng(1)
    made = np.zeros((2 + len(others), len(bed.beta)))
    for _ in range(runs):
        found = haptid.estimate(bed.drawn(phi, shared, rng), haptid.WLS())
        made[0] += holds(found, bed.beta)
        made[1] += classical_holds(found, bed.beta)
        for k, intervals in enumerate(others):
            spread = intervals.spread(found.fit)
            half = stats.t.ppf(0.975, spread.dof) * np.sqrt(np.diag(spread.covariance))
            made[2 + k] += np.abs(found.beta - bed.beta) <= half
    return tuple(made / runs)


def coverage_of(what: str, default: np.ndarray, classical: np.ndarray) -> Iterator[tuple[str, float]]:
    """Figures of one case, per cent."""
    yield f"{what}: default, mean", 100 * float(default.mean())
    yield f"{what}: default, worst", 100 * float(default.min())
    yield f"{what}: default, best", 100 * float(default.max())
    yield f"{what}: classical, mean", 100 * float(classical.mean())


def other_kinds() -> Iterator[tuple[str, float]]:
    """Other intervals, of the first device."""
    kinds = {"jackknife": BlockJackknife(), "fixed-b": FixedB(), "block bootstrap": Bootstrap(99)}
    for (treated, treatment), (sort, (phi, shared)) in product(TREATMENTS.items(), NOISES.items()):
        bed = Bed.of(DEVICES[0], SECONDS, treatment)
        _, _, *found = shares(bed, phi, shared, FEW, tuple(kinds.values()))
        for name, share in zip(kinds, found, strict=True):
            yield f"{sort}, {treated}: {name}, mean", 100 * float(share.mean())
            yield f"{sort}, {treated}: {name}, worst", 100 * float(share.min())


def sandwiched() -> Iterator[tuple[str, float]]:
    """The AR(bic) sandwich relative to the default, of the first device: it walks through the rows of each run."""
    motion, beta = clean_motion(DEVICES[0], SECONDS, TREATMENTS["as it is"])
    rng, model = np.random.default_rng(2), haptid.DynamicModel(haptid.read_device(DEVICES[0]))
    for sort in ("AR(1) 0.95", "AR(1) 0.99"):
        inside, width = np.zeros(len(beta)), []
        for _ in range(SANDWICHES):
            made = noise((motion.tau.shape[1], len(motion)), *NOISES[sort], rng).T
            noisy = replace(motion, tau=motion.tau + NOISE * motion.tau.std(axis=0) * made)
            found = haptid.estimate(haptid.observe(model, noisy), haptid.WLS(), Sandwich())
            inside += holds(found, beta)
            wide = ClusterRobust().spread(found.fit)
            half = stats.t.ppf(0.975, wide.dof) * np.sqrt(np.diag(wide.covariance))
            width.append(np.median((found.conf_int()[:, 1] - found.beta) / half))
        yield f"{sort}, as it is: AR(bic) sandwich, mean", 100 * float(inside.mean()) / SANDWICHES
        yield f"{sort}, as it is: AR(bic) sandwich, width relative to the default's", float(np.median(width))


def quantised(runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Encoders of 4000 counts, each run its own motion: share of default and classical intervals with the truth."""
    beta = truth(phantom())
    made = np.zeros((2, len(beta)))
    for seed in range(runs):
        found = estimated(log(seed))
        made += [holds(found, beta), classical_holds(found, beta)]
    return made[0] / runs, made[1] / runs


def run() -> dict[str, float]:
    """Shares in per cent."""
    figures: dict[str, float] = {}
    for name, (treated, treatment) in product(DEVICES, TREATMENTS.items()):
        bed = Bed.of(name, SECONDS, treatment)
        for sort, (phi, shared) in NOISES.items():
            default, classical = shares(bed, phi, shared, RUNS)
            figures |= coverage_of(f"{name}, {sort}, {treated}", default, classical)
    figures |= coverage_of("encoders of 4000 counts, treated as proposed", *quantised(ENCODER_RUNS))
    figures |= {**dict(other_kinds()), **dict(sandwiched())}
    seen = [diagnose(estimated(log(k, stribeck=0.25)))["friction near standstill"].status != "ok" for k in range(LOGS)]
    figures["Stribeck effect that the model lacks: seen"] = 100 * float(np.mean(seen))
    return figures
