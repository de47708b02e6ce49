"""An exciting motion for itself: an experiment with a controller that follows it, and samples for a real controller."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import mass_matrix
from haptid.experiment.bench.experiment import Experiment
from haptid.experiment.bench.schema import ExperimentTable
from haptid.experiment.excitation.search import Excitation
from haptid.experiment.excitation.writing import trajectory_table

# Bandwidth, rad/s, and damping ratio of the controller, with the largest inertia that a motor has along the motion.
OMEGA, DAMPING = 2 * np.pi * 6.0, 0.8
# Step at which inertias are looked at, s.
LOOK = 0.05


def plain_experiment(found: Excitation) -> Experiment:
    """An experiment with this motion: the device's prior is true, and a controller follows the motion at about 6 Hz.

    Where the prior knows nothing of a coordinate's inertia, its gains are zero: the experiment then needs a controller.
    """
    inertia = largest_inertia(found)
    gains = {"kp": (OMEGA**2 * inertia).tolist(), "kd": (2 * DAMPING * OMEGA * inertia).tolist()}
    table: dict[str, Any] = {
        "schema": 1,
        "name": f"{found.model.device.name}, exciting motion",
        "seed": found.seed,
        "trajectory": _lists(trajectory_table(found.kind)),
        "controller": gains,
    }
    made = ExperimentTable.model_validate(table)
    return Experiment(made.name, made.seed, found.kind, made)


def largest_inertia(found: Excitation) -> Array:
    """Of every motor's coordinate along the motion, others free, by the parameters of the search, (motors,)."""
    model = found.model
    M = mass_matrix(model, found.bounds.beta, found.trajectory(LOOK).q.T)
    to_rows = model.device.row_map @ np.linalg.inv(model.device.coupling)
    on_drives = np.einsum("ik,nij,jk->nk", to_rows, M, to_rows)
    motors = [k for k, drive in enumerate(model.device.drives) if drive.motorised]
    return np.asarray(np.maximum(on_drives.max(axis=0)[motors], 0.0))


def write_samples(found: Excitation, path: Path, rate_hz: float) -> None:
    """Write the motion as CSV for a real controller: t in s, then position, velocity, acceleration of active joints."""
    made = found.trajectory(1.0 / rate_hz)
    names = [found.model.device.joint_names[j] for j in found.model.device.active]
    heads = ["t", *(f"{prefix}{name}" for prefix in ("q", "qd", "qdd") for name in names)]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(heads)
        table.writerows(np.column_stack([made.t, made.q, made.qd, made.qdd]).tolist())


def _lists(value: Any) -> Any:
    """The same with lists where there are tuples, as a file has them."""
    if isinstance(value, dict):
        return {key: _lists(one) for key, one in value.items() if one is not None}
    return [_lists(one) for one in value] if isinstance(value, (list, tuple)) else value
