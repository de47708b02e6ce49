"""A small study: a device of two links, two logs of noisy torque, and what the bench records of it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

import haptid
from haptid.experiment import bench
from motions import multisine, truth
from true_parameters import true_parameters

DEVICE = """
schema = 1
name = "two links"
gravity = [0.0, -9.81, 0.0]
convention = "modified-dh"
[[joints]]
name = "1"
limits = { position = [-2.0, 2.0] }
[[joints]]
name = "2"
d = 0.3
limits = { position = [-2.5, 2.5] }
[[terms]]
kind = "viscous"
joints = "all"
[[terms]]
kind = "coulomb"
joints = "all"
"""
HEAD = """
schema = 1
name = "two links"
device = "device.toml"
[channels]
time = "t"
position = { channels = ["q1", "q2"], unit = "rad" }
torque = { channels = ["tau1", "tau2"], unit = "N m" }
"""
STUDY = f"""{HEAD}
[[logs]]
path = "log.csv"
[[logs]]
path = "check.csv"
role = "validate"
[treatment]
cutoff_hz = 30
decimation = 5
"""
# Of the device on the bench, and of its controller.
FRICTION = {"FV": 0.05, "FC": 0.2}
KP, KD = (60.0, 30.0), (4.0, 2.0)
# Left out of what the bench records at either end: the smooth start and stop, s.
ENDS = 0.5


def columns(seed: int, seconds: float = 6.0) -> dict[str, np.ndarray]:
    """A log's columns, as an instrument would give them."""
    model = two_links()
    q, qd, qdd = multisine(2, seconds, 2e-3, seed)
    tau = haptid.inverse_dynamics(model, truth(model) + 0.1, q, qd, qdd)
    tau += 0.02 * np.random.default_rng(seed).standard_normal(tau.shape)
    t = 2e-3 * np.arange(q.shape[1])
    return {"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}


def two_links() -> haptid.Device:
    """The device of the study."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.toml"
        path.write_text(DEVICE)
        return haptid.DynamicModel(haptid.read_device(path))


def write_study(folder: Path) -> Path:
    """The study file in a folder, with its device file and logs."""
    (folder / "device.toml").write_text(DEVICE)
    (folder / "study.toml").write_text(STUDY)
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        pyarrow.csv.write_csv(pa.table(columns(seed)), folder / name)
    return folder / "study.toml"


def driven(
    seed: int, seconds: float, rate_hz: float = 250.0, noise: float = 0.02, encoders: bench.Encoders | None = None
) -> bench.Recording:
    """The two links under control along a multisine, so many seconds and the ends; without encoders as it is."""
    model, controller = two_links(), bench.Controller(KP, KD, rate_hz=rate_hz)
    chi, amplifiers = true_parameters(model, **FRICTION), bench.Amplifiers(noise=(noise,))
    setup = bench.Setup(model, chi, controller, encoders or bench.Encoders(), amplifiers)
    kind = bench.Multisine(seconds + 2 * ENDS, (0.0, 0.5), (0.9, 0.8), speed=(2.5, 2.5))
    trajectory = bench.plan(kind, model, setup.dt, np.random.default_rng(seed))
    return bench.simulate(setup, trajectory, np.random.default_rng(1000 + seed))


def between(made: bench.Recording) -> slice:
    """All samples but the ends."""
    end = round(ENDS / made.dt)
    return slice(end, len(made) - end)


def log_of(made: bench.Recording) -> haptid.Log:
    """What the controller would have recorded between the ends."""
    inner, unit = between(made), two_links().device.motors[0].command_unit
    torque = haptid.Signal(("command1", "command2"), unit, side="motor")
    channels = haptid.Channels(haptid.Signal(("q1", "q2"), "rad"), torque, time="t")
    return haptid.Log(Path("bench"), "", made.t[inner], made.position[inner], made.command[inner], channels)
