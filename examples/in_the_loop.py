"""Let exported C control a device on the virtual bench, and print what it does for the hand.

    haptid export RESULT --to c --out MODEL
    python examples/in_the_loop.py DEVICE EXPERIMENT MODEL/c

EXPERIMENT says what is true, and how the device is controlled; the code only knows what was identified. Needs MuJoCo
and a C compiler.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import haptid
from haptid.experiment import bench

# Where the hand measures the device, as a share of the motion's amplitude from its centre.
PLACE = 0.4
# How much of the experiment's motion is tracked, s.
TRACKED = 3.0
# One period to begin, and one to measure, s.
STROKE = bench.Stroke(amplitude=0.02, frequency_hz=2.0, seconds=1.0)
# Of the simulator, s: long enough to be quick.
STEP = 2.5e-4


def simulated(device: str, path: str, folder: str) -> bench.InTheLoopResult:
    """All that is measured."""
    experiment = bench.read_experiment(path)
    setup = replace(experiment.setup(haptid.DynamicModel(haptid.read_device(device))), physics=bench.Physics(STEP))
    whole = bench.plan(experiment.kind, setup.model, setup.dt, np.random.default_rng(experiment.seed + 1000))
    first = slice(round(TRACKED / setup.dt))
    trajectory = bench.Trajectory(setup.dt, whole.q[first], whole.qd[first], whole.qdd[first])
    pose = whole.q.mean(axis=0) + PLACE * np.ptp(whole.q, axis=0) / 2
    return bench.simulate_in_the_loop(setup, bench.Compiled.of(folder), trajectory, [pose], stroke=STROKE)


def table(made: bench.InTheLoopResult) -> str:
    """The figures as text."""
    lines = ["impedance at handle   before    after"]
    for what, unit in (("mass", "kg"), ("weight", "N"), ("friction", "N"), ("damping", "N s/m")):
        before, after = (np.mean(np.abs([getattr(one, what) for one in side])) for side in (made.bare, made.assisted))
        lines.append(f"{what + ', ' + unit:20s}  {before:6.4f}   {after:6.4f}")
    lines += [
        f"weight left: {100 * made.weight_left:.1f} %",
        f"dry friction taken off: {100 * made.friction_taken:.0f} %",
        f"tracking error: {1e3 * made.tracking_pd:.3f} mm by PD, {1e3 * made.tracking_model:.3f} mm with the model",
        f"error of the hand's force: {made.force_bare:.3f} N without the model, {made.force_model:.3f} N with it",
        f"speed left after a tap on the free handle: {made.restless:.4f} rad/s",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("device", help="a device file, or the name of a shipped device")
    parser.add_argument("experiment", help="an experiment file of the bench")
    parser.add_argument("folder", help="with the exported C")
    given = parser.parse_args()
    print(table(simulated(given.device, given.experiment, given.folder)))


if __name__ == "__main__":
    main()
