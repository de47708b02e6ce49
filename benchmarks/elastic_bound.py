"""Cramer-Rao bounds of stiffness and damping from the motors alone, for the devices of `elastic_coverage`.

From the true parameters along the motion that exact encoders see: the torque's derivatives at every sample, against its
own noise and what the encoders' rounding adds to the error, frequency by frequency, with the torque's delay known and
with a delay of each motor to be found. Up to 45 Hz, where the harmonics of dry friction at reversals tell most, and up
to 1.5 times the motion's highest frequency, as rows are filtered.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

import haptid
from elastic_coverage import ENCODERS, PLANTS, in_closed_form, model_of, of_motors, parameters, recorded
from haptid.dynamics.forward import ForwardDynamics
from haptid.estimation.methods.simulation_based import base_columns
from haptid.log.lattice import rounding_density
from haptid.motion.channels import coordinates, position_map
from haptid.simulation import smooth
from haptid.simulation.driven import DrivenJoints, unloaded_joints
from haptid.treatment_choice.hidden_joints import lacks_links

RESULT = Path(__file__).parent / "results/elastic-bound.json"
HIGHEST_HZ, POSES, LENGTH = 45.0, 24, 250


def bounds(name: str, seed: int) -> dict[str, float]:
    """By encoders, band and parameter: one standard error at least, per cent."""
    model, plant = model_of(name), PLANTS[name]
    log = recorded(name, "exact", seed) if name != "axis" else in_closed_form("exact", seed)
    assert lacks_links(model, of_motors(model, log))
    delay = 0.0 if name == "axis" else 0.5 * float(log.dt)
    motion = haptid.treat(log, haptid.Treatment(cutoff_hz=150.0, parallel_cutoff_hz=12.0, torque_delay_s=delay))
    beta, base, device = model.base.of(parameters(name)), base_columns(model), model.device
    joints = DrivenJoints(smooth(model, [motion], 1e-3), motion, LENGTH, base)
    course, rows, n, dt = joints.met(beta), joints.motors, len(motion), float(motion.dt)
    rates = np.gradient(course.torque[rows], dt, axis=1)
    late = np.eye(len(rows))[:, :, None] * rates[:, None]
    window = np.hanning(n)
    f = np.fft.rfftfreq(n, dt)
    J = np.fft.rfft(np.concatenate([course.slope, late], axis=1) * np.sqrt(window / window.mean()), axis=2)
    # The motors' torque by their positions, at poses of the motion.
    low, high = motion.usable
    poses = np.linspace(low, high - 1, POSES + 2).astype(int)[1:-1]
    c, cd, cdd = (np.ascontiguousarray(x[:, poses - low]) for x in coordinates(device, motion, low, high))
    B, unknown = np.asarray(device.row_map), unloaded_joints(model)
    known = np.delete(np.arange(len(B)), unknown)
    parts = ForwardDynamics(model, base @ beta).slopes(c, cd, cdd).transpose(1, 3, 0, 2) @ B
    own = B[:, unknown].T
    to_joints = (np.linalg.inv(B) @ position_map(device, motion)(np.eye(motion.q.shape[1])))[known]
    made = {}
    for encoders in ENCODERS:
        step = (
            2 * np.pi / 4000 / np.array(plant.gear)
            if encoders == "4000 counts"
            else np.full(len(rows), 2 * np.pi / 4096)
        )
        moved = to_joints[:, to_joints.any(axis=0)]
        g, density = rounding_density(np.asarray(motion.q[:])[:, to_joints.any(axis=0)], step, dt)
        info = np.zeros((2, J.shape[1], J.shape[1]))
        for k in np.flatnonzero((f > 0) & (f < HIGHEST_HZ)):
            A = sum(part * (2j * np.pi * f[k]) ** i for i, part in enumerate(parts))
            back = np.linalg.inv(own @ A[..., unknown]) @ own
            through = np.eye(len(B))[rows] - A[:, rows][..., unknown] @ back
            Z = through @ A[..., known] @ moved
            S = ((Z * [np.interp(f[k], g, one) for one in density]) @ Z.conj().transpose(0, 2, 1)).mean(axis=0)
            S = S + 2 * dt * plant.noise**2 * np.eye(len(rows))
            own_info = 4 * dt / n * (J[:, :, k].conj().T @ np.linalg.solve(S, J[:, :, k])).real
            info[0] += own_info
            info[1] += own_info * (f[k] < 1.5 * plant.highest)
        for band, matrix in zip(("all", "filtered"), info, strict=True):
            for what, size in (("delay known", len(beta)), ("delay found", len(matrix))):
                se = np.sqrt(np.diag(np.linalg.inv(matrix[:size, :size])))
                for k, parameter in enumerate(model.base.names):
                    if parameter.startswith(("KE", "DE")):
                        made[f"{encoders}, {band}, {what}, {parameter}"] = 100 * float(se[k] / abs(beta[k]))
    return made


def main() -> None:
    """Measure, print, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=3)
    options = parser.parse_args()
    figures: dict[str, float] = {"logs of each device": options.logs}
    for name in PLANTS:
        found = [bounds(name, seed) for seed in range(200, 200 + options.logs)]
        for key in found[0]:
            figures[f"{name}, {key}, standard error, %"] = float(np.mean([one[key] for one in found]))
            print(f"{name}, {key}: {figures[f'{name}, {key}, standard error, %']:.2g}", flush=True)
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
