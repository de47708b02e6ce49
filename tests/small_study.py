"""A small study: a device of two links, and two logs of noisy torque."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

import haptid
from motions import multisine, truth

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


def columns(seed: int, seconds: float = 6.0) -> dict[str, np.ndarray]:
    """A log's columns, as an instrument would give them."""
    device = two_links()
    q, qd, qdd = multisine(2, seconds, 2e-3, seed)
    tau = haptid.inverse_dynamics(device, truth(device) + 0.1, q, qd, qdd)
    tau += 0.02 * np.random.default_rng(seed).standard_normal(tau.shape)
    t = 2e-3 * np.arange(q.shape[1])
    return {"t": t, "q1": q[0], "q2": q[1], "tau1": tau[0], "tau2": tau[1]}


def two_links() -> haptid.Device:
    """The device of the study."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "device.toml"
        path.write_text(DEVICE)
        return haptid.read_device(path)


def write_study(folder: Path) -> Path:
    """The study file in a folder, with its device file and logs."""
    (folder / "device.toml").write_text(DEVICE)
    (folder / "study.toml").write_text(STUDY)
    for seed, name in ((1, "log.csv"), (2, "check.csv")):
        pyarrow.csv.write_csv(pa.table(columns(seed)), folder / name)
    return folder / "study.toml"
