"""The virtual bench: does it keep loops closed and energy, how fast is it, and how exact is an identification from it?

Free motion: no friction, no motors, springs at the active joints that keep the mechanism clear of flat loops, 10 s.
Wall time: 40 s of the PHANToM under control at 1 kHz, on one core.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import mujoco
import numpy as np

import haptid
from haptid.experiment import bench
from haptid.experiment.bench.mjcf import closed, cut_sites, depth_first

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from true_parameters import true_parameters

# Of each device: centre of the motion, springs N m/rad, starting speeds rad/s.
FREE = {
    "phantom_premium_15": ((0.0, 0.2, 0.3), (1.0, 1.0, 0.6), (2.0, 1.0, -1.0)),
    "cea_medical_branch": ((0.1, -1.0, 0.65 + np.pi), (4.0, 6.0, 3.0), (1.5, 1.0, -1.0)),
}


def free_motion(name: str, seconds: float) -> tuple[float, float]:
    """Greatest opening of a loop, m, and greatest change of energy as a share of the greatest kinetic energy."""
    model = haptid.DynamicModel(haptid.read_device(name))
    mj_model = mujoco.MjModel.from_xml_string(bench.mjcf(model, true_parameters(model, FC=0.0, FV=0.0, OFF=0.0)))
    mj_model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, order = mujoco.MjData(mj_model), depth_first(model)
    centre, springs, speeds = (np.array(figures) for figures in FREE[name])
    for j, stiffness, rest in zip(model.device.active, springs, centre, strict=True):
        mj_model.jnt_stiffness[order.index(j)] = stiffness
        mj_model.qpos_spring[order.index(j)] = rest
    data.qpos[:], data.qvel[:] = closed(model, centre), model.device.closure.G[list(order)] @ speeds
    mujoco.mj_forward(mj_model, data)
    first, gap, drift, kinetic = data.energy.sum(), 0.0, 0.0, 0.0
    for _ in range(round(seconds / 1e-3)):
        mujoco.mj_step(mj_model, data, 10)
        mujoco.mj_forward(mj_model, data)
        drift, kinetic = max(drift, abs(data.energy.sum() - first)), max(kinetic, data.energy[1])
        for one, other in cut_sites(model):
            gap = max(gap, float(np.linalg.norm(data.site(one).xpos - data.site(other).xpos)))
    return gap, drift / kinetic


def phantom(seconds: float, model: haptid.Device, step: float = 1e-4) -> bench.Recording:
    """A multisine of the PHANToM."""
    kind = bench.Multisine(seconds, (0.0, 0.2, 0.3), (0.6, 0.35, 0.4), speed=(2.4,))
    controller = bench.Controller((40.0, 35.0, 14.0), (0.5, 0.4, 0.16))
    trajectory = bench.plan(kind, model, 1e-3, np.random.default_rng(1))
    setup = bench.Setup(model, true_parameters(model), controller, physics=bench.Physics(step))
    return bench.simulate(setup, trajectory, np.random.default_rng(2))


def run() -> dict[str, float]:
    """Closure, energy, wall time, and errors of an identification from exact states."""
    figures = {}
    for name in FREE:
        gap, drift = free_motion(name, 10.0)
        figures[f"{name}: loops open by, m, in 10 s"] = gap
        figures[f"{name}: energy drift, share of peak kinetic, in 10 s"] = drift
    model = haptid.DynamicModel(haptid.read_device("phantom_premium_15"))
    start, cpu = time.perf_counter(), time.process_time()
    made = phantom(40.0, model)
    figures["40 s of the PHANToM at 1 kHz: wall, s"] = time.perf_counter() - start
    figures["40 s of the PHANToM at 1 kHz: processor, s"] = time.process_time() - cpu
    errors = exact_identification(model, made)
    return figures | {f"exact states: {what}, %": error for what, error in errors.items()}


def exact_identification(model: haptid.Device, made: bench.Recording) -> dict[str, float]:
    """Errors of an identification from exact states, per cent: torque, and the worst parameter of each sort.

    Inertial parameters count where they carry 2 % of a motor's torque at least.
    """
    active = list(model.device.active)
    q, qd, qdd = made.q[:, active], made.qd[:, active], made.qdd[:, active]
    settled = slice(2000, None)
    treatment = haptid.Treatment(cutoff_hz=None, reversal_speed=0.01)
    motion = haptid.Motion(made.dt, q[settled], made.torque[settled], treatment, rates=(qd[settled], qdd[settled]))
    estimate = haptid.estimate(haptid.observe(model, motion), haptid.WLS())
    truth = model.base.of(true_parameters(model))
    off = 100 * np.abs(estimate.beta - truth) / np.abs(truth)
    carried = np.empty((len(truth), len(active)))
    for k, share in enumerate(carried):
        part = haptid.inverse_dynamics(model, np.eye(len(truth))[k] * truth, q.T, qd.T, qdd.T)
        share[:] = np.sqrt((part**2).mean(axis=1) / (made.torque**2).mean(axis=0))
    kinds = np.array([name[:2] for name in model.base.names])
    heavy = (carried.max(axis=1) >= 0.02) & ~np.isin(kinds, ("FV", "FC"))
    return {
        "torque": 100 * haptid.fit_errors(estimate).relative,
        "parameters": float(off[heavy].max()),
        "Coulomb": float(off[kinds == "FC"].max()),
        "viscous": float(off[kinds == "FV"].max()),
    }


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:70s} {figure:.3g}")
