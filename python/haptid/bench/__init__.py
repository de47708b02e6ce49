"""The virtual bench: a device in MuJoCo with its controller, encoders and amplifiers, and the logs that it gives."""

from haptid.bench.bodies import Body, bodies
from haptid.bench.compiled import Compiled
from haptid.bench.experiment import Experiment, read_experiment
from haptid.bench.felt import Felt, Stroke, feel
from haptid.bench.laws import Assistance, Tracking
from haptid.bench.limits import check_trajectory, loop_openness
from haptid.bench.mjcf import Payload, Physics, mjcf
from haptid.bench.picture import draw_strip, render_strip
from haptid.bench.rehearsal import Rehearsal, rehearse
from haptid.bench.run import Job, make_log, make_logs, perform
from haptid.bench.schema import experiment_schema
from haptid.bench.setup import Amplifiers, Controller, Encoders, ForceSensor, Push, Recording, Setup, TorqueLaw
from haptid.bench.simulation import simulate
from haptid.bench.trajectories import Fourier, Grid, Multisine, Sweep, Trajectory, Triangles, TrianglesAndSines, plan

__all__ = [
    "Amplifiers",
    "Assistance",
    "Body",
    "Compiled",
    "Controller",
    "Encoders",
    "Experiment",
    "Felt",
    "ForceSensor",
    "Fourier",
    "Grid",
    "Job",
    "Multisine",
    "Payload",
    "Physics",
    "Push",
    "Recording",
    "Rehearsal",
    "Setup",
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
    "feel",
    "loop_openness",
    "make_log",
    "make_logs",
    "mjcf",
    "perform",
    "plan",
    "read_experiment",
    "rehearse",
    "render_strip",
    "simulate",
]
