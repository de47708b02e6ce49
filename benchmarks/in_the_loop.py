"""Exported C in the loop of the virtual bench: what it does for the hand, and what it costs.

A log of the bench is identified as a user would do it, the model is written as C, compiled, and called once every
control period. The code never sees a true parameter.
"""

from __future__ import annotations

import tempfile

import numpy as np

from bench_identification import CASES, PHYSICS, Case, device_of, identify, log_of, record, truth_of
from haptid.experiment import bench
from haptid.export import CCode, export_c

# The sign of a velocity is smoothed below this, rad/s: some counts of the encoders in a period of the differentiator.
SPEED = 0.05
COUNTS, SECONDS, TRACKED = 4000, 20.0, 6.0
# Of the hand, N, and where it feels beside the middle, as shares of the amplitude.
PUSHES = {"phantom_premium_15": (0.6, 0.4, -0.5), "cea_medical_branch": (4.0, 3.0, -5.0)}
PLACES = ((0.0, 0.0, 0.0), (0.3, 0.5, 0.6))
DEVICES = ("PHANToM, one parallelogram", "CEA branch, single and double parallelogram")


def setup_of(case: Case, physics: bench.Physics = PHYSICS) -> bench.Setup:
    """The device with its encoders, on the bench."""
    encoders = bench.Encoders((float(COUNTS),), case.gear)
    controller = bench.Controller(case.kp, case.kd)
    return bench.Setup(device_of(case), truth_of(case), controller, encoders=encoders, physics=physics)


def code_of(case: Case, seconds: float = SECONDS, physics: bench.Physics = PHYSICS) -> bench.Compiled:
    """C of the model that a log of the bench gives."""
    estimate = identify(case, log_of(case, record(case, 1, COUNTS, seconds, physics)))
    with tempfile.TemporaryDirectory() as folder:
        export_c(estimate, folder, CCode("model", reversal_speed=SPEED))
        return bench.Compiled.of(folder)


def rehearsed(
    name: str,
    seconds: float = SECONDS,
    places: tuple[tuple[float, ...], ...] = PLACES,
    physics: bench.Physics = PHYSICS,
    tracked: float = TRACKED,
    stroke: bench.Stroke | None = None,
) -> bench.InTheLoopResult:
    """Everything that is measured of one device."""
    case = CASES[name]
    setup, code = setup_of(case, physics), code_of(case, seconds, physics)
    kind = bench.Multisine(tracked, case.centre, case.amplitude, speed=case.speed)
    trajectory = bench.plan(kind, setup.model, setup.dt, np.random.default_rng(7))
    poses = [np.array(case.centre) + np.array(place) * case.amplitude for place in places]
    return bench.simulate_in_the_loop(setup, code, trajectory, poses, PUSHES[case.name], stroke=stroke)


def figures_of(made: bench.InTheLoopResult) -> dict[str, float]:
    """By name; felt figures are means over poses and axes."""
    felt = {
        f"{what} felt, {when}, {unit}": float(np.mean(np.abs([getattr(each, what) for each in side])))
        for what, unit in (("mass", "kg"), ("damping", "N s/m"), ("friction", "N"), ("weight", "N"))
        for when, side in (("before", made.bare), ("after", made.assisted))
    }
    return felt | {
        "weight left, %": 100 * made.weight_left,
        "dry friction taken off, %": 100 * made.friction_taken,
        "vibration, % of the dry friction": 100 * made.roughness,
        "tracking by PD, mm": 1e3 * made.tracking_pd,
        "tracking with the model, mm": 1e3 * made.tracking_model,
        "tracking better, times": made.better_tracking,
        "force without the model, N": made.force_bare,
        "force with the model, N": made.force_model,
        "force better, times": made.better_force,
        "speed left after a tap, rad/s": made.restless,
    }


def run() -> dict[str, float]:
    """All figures by device."""
    return {f"{name}: {what}": value for name in DEVICES for what, value in figures_of(rehearsed(name)).items()}


if __name__ == "__main__":
    for what, figure in run().items():
        print(f"{what:80s} {figure:.4g}")
