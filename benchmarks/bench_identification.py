"""How exact an identification from logs of the virtual bench is: four devices, five motions, three sorts of data.

Exact states: the simulator's own positions, velocities, accelerations and torques. Differentiated: exact positions as
the log has them, and the command. Encoders: 4000 counts a turn behind a gear, through which the controller closes its
loop too. The last two are treated as `haptid.propose` says, with nothing given.

Errors in per cent: of the exact torque on a motion that the fit has not seen; of the inertial and gravity parameters
that carry 2 % of a motor's torque; of Coulomb and of viscous friction. The worst of five motions.
"""

from __future__ import annotations

import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import haptid
from haptid.experiment import bench

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from true_parameters import true_parameters

SEEDS, UNSEEN, SECONDS = (1, 2, 3, 4, 5), 99, 40.0
# Samples at either end that are left out: the smooth start and stop.
ENDS = 1000
PHYSICS = bench.Physics()
# A joint slower than this may stick, rad/s: its dry friction is then anything up to the Coulomb one.
STICKS = 0.02
CARRIES = 0.02
DRY_AND_VISCOUS = """
[[terms]]
kind = "viscous"
joints = "all"

[[terms]]
kind = "coulomb"
joints = "all"
"""
# Links 4, 6, 7 and 8 balanced about their joints: what they would add is told apart by one part in 10^4 of the torque.
BALANCED = """
[[symmetry]]
reason = "links 4, 6, 7 and 8 are balanced about their joints"
zero = ["MY4", "MY6", "MX7", "MY7", "MY8"]
"""


@dataclass(frozen=True)
class Case:
    """A device under its controller.

    Attributes:
        name: of a shipped device; `more` is added to its file, and `less` taken out of it.
        centre, amplitude, speed: of the motion, rad and rad/s.
        kp, kd: of the controller.
        gear: turns of the encoder for one of the joint.
        true: true parameters, by name or by kind.
    """

    name: str
    centre: tuple[float, ...]
    amplitude: tuple[float, ...]
    speed: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    gear: tuple[float, ...]
    true: tuple[tuple[str, float], ...]
    more: str = ""
    less: str = ""


CASES = {
    "open arm, 3 joints": Case(
        "arm3",
        centre=(0.0, 0.6, -1.0),
        amplitude=(0.9, 0.6, 0.7),
        speed=(2.5, 2.5, 3.0),
        kp=(300.0, 300.0, 120.0),
        kd=(9.0, 9.0, 3.5),
        gear=(10.0,),
        true=(("IA", 0.005), ("FV", 0.05), ("FC", 0.2)),
    ),
    "open arm, 7 joints": Case(
        "arm7",
        centre=(0.0, 0.5, 0.0, -1.2, 0.0, 0.6, 0.0),
        amplitude=(0.8, 0.6, 0.8, 0.6, 0.8, 0.7, 0.8),
        speed=(2.0,),
        kp=(4000.0, 4000.0, 2000.0, 2000.0, 600.0, 600.0, 200.0),
        kd=(120.0, 120.0, 60.0, 60.0, 18.0, 18.0, 6.0),
        gear=(50.0,),
        true=(("IA", 0.05), ("FV", 0.5), ("FC", 1.0)),
        more=DRY_AND_VISCOUS,
    ),
    "PHANToM, one parallelogram": Case(
        "phantom_premium_15",
        centre=(0.0, 0.2, 0.3),
        amplitude=(0.9, 0.45, 0.48),
        speed=(3.6, 2.4, 2.4),
        kp=(40.0, 35.0, 14.0),
        kd=(0.5, 0.4, 0.16),
        gear=(13.3, 11.2, 11.2),
        true=(("FV1", 7e-4), ("FV2", 5e-4), ("FV3", 4e-4), ("FC1", 0.026), ("FC2", 0.0092), ("FC3", 0.0091)),
    ),
    "CEA branch, single and double parallelogram": Case(
        "cea_medical_branch",
        centre=(0.1, -1.0, 0.65 + np.pi),
        amplitude=(1.0, 0.5, 0.5),
        speed=(3.0,),
        kp=(300.0, 150.0, 80.0),
        kd=(6.0, 3.0, 1.6),
        gear=(10.0,),
        true=(
            *(("IA1", 0.012), ("IA2", 0.001), ("IA5", 0.0008), ("OFF1", 0.01), ("OFF2", 0.02), ("OFF5", 0.03)),
            *(("FV", 6e-4), ("FV1", 0.01), ("FV2", 0.008), ("FV5", 0.006)),
            *(("FC", 0.01), ("FC1", 0.12), ("FC2", 0.11), ("FC5", 0.11)),
        ),
        more=BALANCED,
        less=', "MY4", "MY5", "MY6", "MY7", "MY8"',
    ),
}


@cache
def device_of(case: Case) -> haptid.Device:
    """The shipped device, with what the case adds to its file."""
    text = (Path(haptid.__file__).parent / "device/library" / f"{case.name}.toml").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.toml"
        path.write_text((text.replace(case.less, "") if case.less else text) + case.more, encoding="utf-8")
        return haptid.DynamicModel(haptid.read_device(path))


def truth_of(case: Case) -> np.ndarray:
    """Its true free standard parameters, (p,)."""
    model = device_of(case)
    chi = true_parameters(model)
    for name, value in case.true:
        for k, (kind, own) in enumerate(zip(model.device.parameters.kinds, model.device.parameters.names, strict=True)):
            if name in (kind, own):
                chi[k] = value
    return chi


def record(
    case: Case, seed: int, counts: int | None, seconds: float = SECONDS, physics: bench.Physics = PHYSICS
) -> bench.Recording:
    """A multisine of the device under control; positions are exact where there are no counts."""
    model = device_of(case)
    encoders = bench.Encoders((float(counts),), case.gear) if counts else bench.Encoders()
    controller = bench.Controller(case.kp, case.kd)
    setup = bench.Setup(model, truth_of(case), controller, encoders=encoders, physics=physics)
    kind = bench.Multisine(seconds, case.centre, case.amplitude, speed=case.speed)
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(seed))
    return bench.simulate(setup, trajectory, np.random.default_rng(1000 + seed))


def log_of(case: Case, made: bench.Recording) -> haptid.Log:
    """What the controller would have recorded: positions and commands."""
    model, inner = device_of(case), slice(ENDS, len(made) - ENDS)
    position = tuple(f"q{k}" for k in range(len(model.device.active)))
    command = tuple(f"command{k}" for k in range(len(model.device.motors)))
    unit = model.device.motors[0].command_unit
    channels = haptid.Channels(haptid.Signal(position, "rad"), haptid.Signal(command, unit, side="motor"), time="t")
    return haptid.Log(Path("bench"), "", made.t[inner], made.position[inner], made.command[inner], channels)


def exact_motion(case: Case, made: bench.Recording) -> haptid.Motion:
    """The simulator's own states and torques."""
    active, inner = list(device_of(case).device.active), slice(ENDS, len(made) - ENDS)
    q, qd, qdd = (x[inner][:, active] for x in (made.q, made.qd, made.qdd))
    treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=STICKS)
    return haptid.Motion(made.dt, q, made.torque[inner], treatment, rates=(qd, qdd))


def errors(case: Case, estimate: haptid.Estimate, unseen: bench.Recording) -> dict[str, float]:
    """Errors in per cent, against the truth; the torque's on an unseen motion, where no joint may stick."""
    model, beta = device_of(case), device_of(case).base.of(truth_of(case))
    active = list(model.device.active)
    moving = (np.abs(unseen.qd) > STICKS).all(axis=1)
    q, qd, qdd = (x[moving][:, active].T for x in (unseen.q, unseen.qd, unseen.qdd))
    tau = unseen.torque[moving].T
    size = np.linalg.norm(tau, axis=1)
    missed = np.linalg.norm(haptid.inverse_dynamics(model, estimate.beta, q, qd, qdd) - tau, axis=1)
    off = 100 * np.abs(estimate.beta - beta) / np.where(beta == 0, np.inf, np.abs(beta))
    shares = [
        np.linalg.norm(haptid.inverse_dynamics(model, row * beta, q, qd, qdd), axis=1) for row in np.eye(len(beta))
    ]
    carried = (np.array(shares) / size).max(axis=1)
    kinds = np.array([name[:2] for name in model.base.names])
    heavy = (carried >= CARRIES) & ~np.isin(kinds, ("FV", "FC"))
    return {
        "torque": float(100 * (missed / size).max()),
        "parameters": float(off[heavy].max()),
        "Coulomb": float(off[kinds == "FC"].max()),
        "viscous": float(off[kinds == "FV"].max()),
    }


def identify(case: Case, log: haptid.Log) -> haptid.Estimate:
    """As a user who gives no treatment gets it."""
    model = device_of(case)
    treatment = haptid.propose(model, log).treatment
    return haptid.estimate(haptid.observe(model, haptid.treat(log, treatment)), haptid.WLS())


def study(
    name: str, seed: int, seconds: float = SECONDS, physics: bench.Physics = PHYSICS
) -> dict[str, dict[str, float]]:
    """Errors of one device and motion, by sort of data."""
    case = CASES[name]
    unseen = record(case, UNSEEN, None, 0.4 * seconds, physics)
    exact, read = (record(case, seed, counts, seconds, physics) for counts in (None, 4000))
    states = haptid.estimate(haptid.observe(device_of(case), exact_motion(case, exact)), haptid.WLS())
    return {
        "exact states": errors(case, states, unseen),
        "differentiated": errors(case, identify(case, log_of(case, exact)), unseen),
        "encoders": errors(case, identify(case, log_of(case, read)), unseen),
    }


def run() -> dict[str, float]:
    """The worst of all motions, by device, sort of data and figure."""
    jobs = [(name, seed) for name in CASES for seed in SEEDS]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        made = list(pool.map(study, *zip(*jobs, strict=True)))
    figures: dict[str, float] = {}
    for (name, _), found in zip(jobs, made, strict=True):
        for sort, values in found.items():
            for what, value in values.items():
                key = f"{name}, {sort}: {what}, %"
                figures[key] = max(figures.get(key, 0.0), value)
    return figures


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:80s} {figure:.3g}")
