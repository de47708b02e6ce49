"""Every estimator on one arm of six joints under one noise: what BIRDy compares, done with what haptid has.

The TX40 on the virtual bench with the bodies of its device file, friction, and a coupled wrist: PD at 500 Hz, encoders
of 4096 counts a turn behind the gears, noise on every motor's torque; a multisine of 12 s, of which 10 are kept.
Positions below 40 Hz, torque and columns together below a share of what every tenth row carries. Printed for each
method: the median relative error of the base parameters, the error of the exact torque on another motion, the share of
95 % intervals that hold the truth, and the time. Means of SEEDS; the Kalman filters, which go sample by sample, of the
first seed.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np

import haptid
from haptid import estimation
from haptid.experiment import bench
from haptid.simulation import PID
from haptid.uncertainty.quantities import half_width

SEEDS, UNSEEN, SECONDS, RATE_HZ = (1, 2, 3), 99, 12.0, 500.0
KINDS = {"IA": 0.12, "IAM": 0.05, "FV": 3.0, "FC": 4.0, "OFF": 0.3, "FVM": 1.0, "FCM": 1.5}
# The URDF prints no moments of link 6: those of a small flange.
FLANGE = {"XX6": 6e-4, "YY6": 6e-4, "ZZ6": 2e-4}
KP, KD = (1500.0, 1500.0, 500.0, 200.0, 200.0, 90.0), (60.0, 60.0, 20.0, 8.0, 8.0, 3.5)
GEAR, COUNTS = (32.0, 32.0, 45.0, 48.0, 45.0, 32.0), 4096.0
NOISE = (0.5, 0.5, 0.3, 0.1, 0.1, 0.1)
# The motion is below 3 Hz; a command is held from one sample to the next.
TREATMENT = haptid.Treatment(cutoff_hz=40.0, decimation=10, reversal_speed=0.05, torque_delay_s=0.5 / RATE_HZ)
# Simulated dry friction turns over within this share of the speed: less would cost time, for little.
FRICTION = 0.02
# Controller's velocity filter on the bench, Hz.
VELOCITY_HZ = 100.0
# Samples at either end that are left out: the fall into the controller's arms, and rest.
ENDS = 500
# Joints slower than this may stick, rad/s.
STICKS = 0.02
Makes = Callable[[PID], haptid.estimation.Method]
METHODS: dict[str, Makes] = {
    "OLS": lambda _: estimation.OLS(),
    "WLS": lambda _: estimation.WLS(),
    "SUR": lambda _: estimation.SUR(),
    "GLS": lambda _: estimation.GLS(),
    "IRLS": lambda _: estimation.IRLS(),
    "TLS": lambda _: estimation.TLS(),
    "maximum likelihood": lambda _: estimation.Heteroscedastic(),
    "consistent OLS": lambda _: estimation.PhysicallyConsistent(estimation.OLS()),
    "consistent WLS": lambda _: estimation.PhysicallyConsistent(),
    "consistent IRLS": lambda _: estimation.PhysicallyConsistent(estimation.IRLS()),
    "IV": lambda law: estimation.IV(law, friction=FRICTION),
    "consistent IV": lambda law: estimation.PhysicallyConsistent(estimation.IV(law, friction=FRICTION)),
    "DIDIM": lambda law: estimation.DIDIM(law, friction=FRICTION),
    "consistent DIDIM": lambda law: estimation.PhysicallyConsistent(estimation.DIDIM(law, friction=FRICTION)),
    "CLIE": lambda law: estimation.CLIE(law, friction=FRICTION),
    "CLOE": lambda law: estimation.CLOE(law, friction=FRICTION),
    "OutputError": lambda _: estimation.OutputErrorMethod(friction=FRICTION),
    "EKF": lambda _: estimation.EKF(),
    "UKF": lambda _: estimation.UKF(),
}
SLOW = ("EKF", "UKF")


@cache
def model() -> haptid.Device:
    """The arm."""
    return haptid.DynamicModel(haptid.read_device("staubli_tx40"))


def truth() -> np.ndarray:
    """Its true free standard parameters, (p,)."""
    chi = np.nan_to_num(model().chi_prior)
    for k, (name, kind) in enumerate(zip(model().parameters.names, model().parameters.kinds, strict=True)):
        chi[k] = FLANGE.get(name, KINDS.get(kind, chi[k]))
    return chi


@cache
def record(seed: int, read: bool = True) -> bench.Recording:
    """A multisine under control; with encoders and noise, or exact."""
    encoders = bench.Encoders((COUNTS,), GEAR) if read else bench.Encoders()
    amplifiers = bench.Amplifiers(noise=NOISE) if read else bench.Amplifiers()
    setup = bench.Setup(
        model(), truth(), bench.Controller(KP, KD, rate_hz=RATE_HZ, tracking_limit=0.6), encoders, amplifiers
    )
    reach, speed = (1.2, 0.9, 0.9, 1.5, 1.2, 1.5), (3.0, 2.5, 3.0, 4.0, 4.0, 5.0)
    kind = bench.Multisine(SECONDS, (0.0, 0.0, 0.5, 0.0, 0.0, 0.0), reach, speed=speed)
    planned = bench.plan(kind, model(), setup.dt, np.random.default_rng(seed))
    return bench.simulate(setup, planned, np.random.default_rng(1000 + seed))


def log_of(made: bench.Recording) -> haptid.Log:
    """As the controller would have it."""
    joints, motors = (tuple(f"{what}{k}" for k in range(1, 7)) for what in ("q", "command"))
    unit = model().motors[0].command_unit
    channels = haptid.Channels(haptid.Signal(joints, "rad"), haptid.Signal(motors, unit, side="motor"), time="t")
    inner = slice(ENDS, len(made) - ENDS)
    return haptid.Log(Path("bench"), "", made.t[inner], made.position[inner], made.command[inner], channels)


def torque_error(beta: np.ndarray, unseen: bench.Recording) -> float:
    """Of the exact torque on unseen motion where no joint may stick, per cent."""
    active, moving = list(model().active), (np.abs(unseen.qd) > STICKS).all(axis=1)
    states = [x[moving][:, active].T for x in (unseen.q, unseen.qd, unseen.qdd)]
    exact, found = (haptid.inverse_dynamics(model(), b, *states) for b in (model().base.of(truth()), beta))
    return 100 * float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def study(seed: int, names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """Figures of some methods with one seed's noise."""
    made, unseen, beta = record(seed), record(UNSEEN, read=False), model().base.of(truth())
    target, log = made.target[ENDS:-ENDS], log_of(made)
    law = PID(KP, KD, reference=(target,), velocity_cutoff_hz=VELOCITY_HZ)
    observation = haptid.observe(model(), haptid.treat(log, TREATMENT))
    figures, known = {}, beta != 0
    for name in names:
        begin = time.perf_counter()
        found = haptid.estimate(observation, METHODS[name](law))
        half = half_width(np.sqrt(np.diag(found.covariance)), found.dof)  # also of a filter, which gives no intervals
        low, high = (found.free - half, found.free + half) if found.single_block else found.conf_int().T
        figures[name] = {
            "parameters, median, %": 100 * float(np.median(np.abs(found.beta - beta)[known] / np.abs(beta)[known])),
            "unseen torque, %": torque_error(found.beta, unseen),
            "intervals that hold the truth, %": 100 * float(np.mean((low <= beta) & (beta <= high))),
            "time, s": time.perf_counter() - begin,
        }
    return figures


def run() -> dict[str, float]:
    """Means of all seeds."""
    quick = tuple(name for name in METHODS if name not in SLOW)
    jobs = [(seed, quick) for seed in SEEDS] + [(SEEDS[0], (name,)) for name in SLOW]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(study, *zip(*jobs, strict=True)))
    figures: dict[str, float] = {}
    for name in METHODS:
        own = [found[name] for found in made if name in found]
        figures |= {f"{name}: {what}": float(np.mean([one[what] for one in own])) for what in own[0]}
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:60s} {figure:.4g}")
