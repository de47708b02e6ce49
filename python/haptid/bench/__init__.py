"""The virtual bench: a device in MuJoCo with its controller, encoders and amplifiers, and the logs that it gives."""

from haptid.bench.bodies import Body, bodies
from haptid.bench.limits import check_trajectory, loop_openness
from haptid.bench.mjcf import Payload, Physics, mjcf
from haptid.bench.simulation import (
    Amplifiers,
    Controller,
    Encoders,
    ForceSensor,
    Push,
    Recording,
    Setup,
    simulate,
)
from haptid.bench.trajectories import Grid, Multisine, Sweep, Trajectory, Triangles, TrianglesAndSines, plan

__all__ = [
    "Amplifiers",
    "Body",
    "Controller",
    "Encoders",
    "ForceSensor",
    "Grid",
    "Multisine",
    "Payload",
    "Physics",
    "Push",
    "Recording",
    "Setup",
    "Sweep",
    "Trajectory",
    "Triangles",
    "TrianglesAndSines",
    "bodies",
    "check_trajectory",
    "loop_openness",
    "mjcf",
    "plan",
    "simulate",
]
