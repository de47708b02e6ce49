"""A map of the handle's dynamics over a million poses: mass matrix, Jacobian, apparent masses with standard errors.

Agreement with the plain method, unit accelerations through the inverse dynamics and NumPy's eigenvalues, is checked
before any time is taken. One thread is a process of its own, since threads are counted once; its time, and the
plain method's, is the processor's, which others on the machine disturb less.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

import haptid
from haptid import _core
from haptid.dynamics.inverse import mass_matrix
from haptid.dynamics.kinematics import handle_motion
from haptid.end_effector.characterisation import GivenParameters, apparent_mass
from haptid.end_effector.characterisation.apparent_mass import core_arguments

POSES = 1_000_000
DEVICES: dict[str, tuple[str, tuple[float, ...], float]] = {
    "CEA branch": ("cea_medical_branch", (-0.5, -0.9, 4.0), 0.5),
    "PHANToM": ("phantom_premium_15", (0.0, 0.3, 0.4), 0.5),
    "CEA interface": ("cea_medical_interface", (0.0, -1.0, 4.0, 0.0, -1.0, 4.0), 0.15),
}


def model_of(name: str) -> GivenParameters:
    """The device with parameters of some size, and a covariance of one per cent."""
    model = haptid.DynamicModel(haptid.read_device(name))
    chi = np.nan_to_num(model.device.chi_prior)
    if not chi.any():
        kinds = {"ZZ": 0.02, "XX": 0.015, "YY": 0.015, "M": 0.3, "MX": 0.01, "IA": 0.001, "FV": 1e-3, "FC": 0.05}
        chi = np.array([kinds.get(kind, 0.0) for kind in model.device.parameters.kinds])
    beta = model.base.of(chi)
    rng = np.random.default_rng(0)
    L = 0.01 * np.abs(beta)[:, None] * rng.normal(size=(len(beta),) * 2) / np.sqrt(len(beta))
    return GivenParameters(model, beta, L @ L.T)


def poses_of(centre: tuple[float, ...], spread: float, count: int) -> np.ndarray:
    """Positions of the active joints, (active, poses), rad; neighbours are near each other, as cells of a map are."""
    phase = np.linspace(0, 2 * np.pi, count) * (101.0 * np.arange(1, len(centre) + 1))[:, None] ** 0.5
    return np.array(centre)[:, None] + spread * np.sin(phase + np.random.default_rng(1).uniform(0, 6, (len(centre), 1)))


def best_of(work: Callable[[], object], times: int = 3) -> float:
    """Seconds of the fastest of a few runs."""
    clock = time.perf_counter if int(os.environ.get("RAYON_NUM_THREADS", "1")) > 1 else time.process_time
    taken = []
    for _ in range(times):
        begin = clock()
        work()
        taken.append(clock() - begin)
    return min(taken)


def check(identified: GivenParameters, qa: np.ndarray) -> None:
    """The kernel's masses are those of the plain method."""
    A, J = mass_matrix(identified.model, identified.beta, qa), handle_motion(identified.model, qa).row_jacobian[:, :3]
    wanted = np.linalg.eigvalsh(np.linalg.inv(J @ np.linalg.solve(A, J.mT)))[:, ::-1]
    found = apparent_mass(identified, qa)
    np.testing.assert_allclose(found.mass.values[found.definite], wanted[found.definite], rtol=1e-8)


def timed() -> dict[str, float]:
    """Seconds for a million poses, with the threads this process has."""
    made = {}
    for label, (name, *about) in DEVICES.items():
        identified = model_of(name)
        check(identified, poses_of(*about, 2000))
        qa = poses_of(*about, POSES)
        at = core_arguments(identified, qa)
        made[f"{label}: Jacobian and mass matrix"] = best_of(
            lambda at=at: _core.end_effector_dynamics(*at, rows=[0, 1, 2])
        )
        made[f"{label}: masses with deviations"] = best_of(lambda m=identified, qa=qa: apparent_mass(m, qa))
    return made


def run() -> dict[str, float]:
    """Seconds for a million poses on one thread and on all, and the plain method's, scaled from fewer poses."""
    found = {}
    for threads in ("1", str(os.cpu_count())):
        environment = {**os.environ, "RAYON_NUM_THREADS": threads}
        out = subprocess.run([sys.executable, __file__], capture_output=True, text=True, check=True, env=environment)
        for what, seconds in json.loads(out.stdout).items():
            found[f"{what}, {threads} thread{'s' * (threads != '1')}, s per million"] = seconds
    for label, (name, *about) in DEVICES.items():
        identified, few = model_of(name), 20_000
        qa = poses_of(*about, few)
        plain = best_of(
            lambda m=identified, qa=qa: (mass_matrix(m.model, m.beta, qa), handle_motion(m.model, qa).row_jacobian)
        )
        found[f"{label}: Jacobian and mass matrix, plain method, s per million"] = plain * POSES / few
    return found


if __name__ == "__main__":
    print(json.dumps(timed()))
