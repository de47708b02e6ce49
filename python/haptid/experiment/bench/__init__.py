"""The virtual bench: closed-loop MuJoCo simulation of a device with controller, encoders and amplifiers, giving logs.

It may import everything below it: device, dynamics, motion, end effector; nothing of estimation results.
"""

from haptid.experiment.bench.bodies import SimulatedBody, bodies
from haptid.experiment.bench.compiled_code import Compiled
from haptid.experiment.bench.controllers import Assistance, Tracking
from haptid.experiment.bench.experiment import Experiment, experiment_schema, read_experiment
from haptid.experiment.bench.hand import GUIDE, HandleImpedance, Stroke, impedance_curve, measure_impedance
from haptid.experiment.bench.in_the_loop import InTheLoopResult, simulate_in_the_loop
from haptid.experiment.bench.limits import check_trajectory, loop_conditioning
from haptid.experiment.bench.mjcf import Physics, SimulatedPayload, mjcf
from haptid.experiment.bench.picture import draw_strip, render_strip
from haptid.experiment.bench.run import Job, make_log, make_logs, perform
from haptid.experiment.bench.setup import (
    Amplifiers,
    Controller,
    Encoders,
    ForceSensor,
    Hand,
    Push,
    Recording,
    Setup,
    TorqueLaw,
)
from haptid.experiment.bench.simulation import simulate
from haptid.experiment.bench.trajectories import (
    Fourier,
    Grid,
    HeldPoses,
    Multisine,
    Sweep,
    Trajectory,
    Triangles,
    TrianglesAndSines,
    plan,
)

__all__ = [
    "GUIDE",
    "Amplifiers",
    "Assistance",
    "Compiled",
    "Controller",
    "Encoders",
    "Experiment",
    "ForceSensor",
    "Fourier",
    "Grid",
    "Hand",
    "HandleImpedance",
    "HeldPoses",
    "InTheLoopResult",
    "Job",
    "Multisine",
    "Physics",
    "Push",
    "Recording",
    "Setup",
    "SimulatedBody",
    "SimulatedPayload",
    "Stroke",
    "Sweep",
    "TorqueLaw",
    "Tracking",
    "Trajectory",
    "Triangles",
    "TrianglesAndSines",
    "bodies",
    "check_trajectory",
    "draw_strip",
    "experiment_schema",
    "impedance_curve",
    "loop_conditioning",
    "make_log",
    "make_logs",
    "measure_impedance",
    "mjcf",
    "perform",
    "plan",
    "read_experiment",
    "render_strip",
    "simulate",
    "simulate_in_the_loop",
]
