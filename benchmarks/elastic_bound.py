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
from haptid.estimation.methods.simulation_based import base_columns
from haptid.log.lattice import rounding_density
from haptid.simulation import smooth
from haptid.simulation.driven import DrivenJoints, unloaded_joints
from haptid.simulation.information import fisher_information
from haptid.simulation.small_motion import SmallMotion
from haptid.treatment_choice.hidden_joints import lacks_links

RESULT = Path(__file__).parent / "results/elastic-bound.json"
HIGHEST_HZ, LENGTH = 45.0, 250


def bounds(name: str, seed: int) -> dict[str, float]:
    """By encoders, band and parameter: one standard error at least, per cent."""
    model, plant = model_of(name), PLANTS[name]
    log = recorded(name, "exact", seed) if name != "axis" else in_closed_form("exact", seed)
    assert lacks_links(model, of_motors(model, log))
    delay = 0.0 if name == "axis" else 0.5 * float(log.dt)
    motion = haptid.treat(log, haptid.Treatment(cutoff_hz=150.0, parallel_cutoff_hz=12.0, torque_delay_s=delay))
    beta, base = model.base.of(parameters(name)), base_columns(model)
    joints = DrivenJoints(smooth(model, [motion], 1e-3), motion, LENGTH, base)
    course, rows, dt = joints.met(beta), joints.motors, float(motion.dt)
    rates = np.gradient(course.torque[rows], dt, axis=1)
    late = np.eye(len(rows))[:, :, None] * rates[:, None]
    J = np.concatenate([course.slope, late], axis=1)
    linear = SmallMotion.along(model, base, beta, motion, unloaded_joints(model), rows)
    torque, seen = 2 * dt * plant.noise**2 * np.eye(len(rows)), linear.moved.any(axis=0)
    made = {}
    for encoders in ENCODERS:
        step = (
            2 * np.pi / 4000 / np.array(plant.gear)
            if encoders == "4000 counts"
            else np.full(len(rows), 2 * np.pi / 4096)
        )
        steps = np.zeros(len(seen))
        steps[seen] = step
        noise = rounding_density(np.asarray(motion.q[:]), steps, dt)
        for band, highest in (("all", HIGHEST_HZ), ("filtered", 1.5 * plant.highest)):
            matrix, _ = fisher_information(linear, J, dt, noise, torque, highest)
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
