"""What the bench leaves: the log as the controller writes it and, on request, the truth beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.experiment.bench.experiment import Experiment
from haptid.experiment.bench.setup import Recording, Setup
from haptid.experiment.bench.simulation import load_mujoco

# Columns of a log: name -> (values, unit).
Columns = dict[str, tuple[Array, str]]


def truth_paths(log: Path) -> tuple[Path, Path]:
    """Where the truth of a log goes: parameters, and exact states."""
    return log.with_suffix(".truth.json"), log.with_suffix(".truth.parquet")


def write_log(path: Path, experiment: Experiment, setup: Setup, made: Recording, seed: int) -> None:
    """Write the log: Parquet, units with every channel, the experiment in the file's metadata.

    The same experiment, device and seed give the same bytes.
    """
    model, columns = setup.model, {"t": (made.t, "s")}
    units = [joint_unit(model, j) for j in model.device.active]
    commands = [drive.unit for drive in model.device.motors]
    for k, unit in enumerate(units):
        columns[f"q{k + 1}"] = (made.position[:, k], unit)
    for k, unit in enumerate(commands):
        columns[f"command{k + 1}"] = (made.command[:, k], unit)
    for k, unit in enumerate(units):
        columns[f"velocity{k + 1}"] = (made.velocity[:, k], f"{unit}/s")
    for k, unit in enumerate(units):
        columns[f"target{k + 1}"] = (made.target[:, k], unit)
    if made.wrench is not None:
        for k, axis in enumerate("xyz"):
            columns[f"force_{axis}"] = (made.wrench[:, k], "N")
            columns[f"moment_{axis}"] = (made.wrench[:, 3 + k], "N m")
    _write(path, columns, description(experiment, model, seed))


def write_truth(path: Path, experiment: Experiment, setup: Setup, made: Recording, seed: int) -> None:
    """Write what is true beside a log: parameters as JSON, exact states and torques as Parquet."""
    model, (parameters, states) = setup.model, truth_paths(path)
    beta = model.base.of(setup.chi)
    values = {
        **description(experiment, model, seed),
        "base": dict(zip(model.base.names, beta.tolist(), strict=True)),
        "standard": dict(zip(model.device.parameters.names, setup.chi.tolist(), strict=True)),
        "widest_gap": made.gap,
    }
    parameters.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    columns: Columns = {"t": (made.t, "s")}
    for letter, block, per in (("q", made.q, ""), ("qd", made.qd, "/s"), ("qdd", made.qdd, "/s^2")):
        for j, joint in enumerate(model.device.joints):
            columns[f"{letter}_{joint.name}"] = (block[:, j], joint_unit(model, j) + per)
    for k, drive in enumerate(model.device.motors):
        unit = "N" if joint_unit(model, model.device.active[int(np.argmax(drive.row != 0))]) == "m" else "N m"
        columns[f"torque_{drive.name}"] = (made.torque[:, k], unit)
    for k, axis in enumerate("xyz"):
        columns[f"hand_{axis}"] = (made.hand[:, k], "N")
    _write(states, columns, description(experiment, model, seed))


def description(experiment: Experiment, model: DynamicModel, seed: int) -> dict[str, Any]:
    """What made a log: enough to make it again."""
    import haptid

    return {
        "haptid": haptid.__version__,
        "mujoco": str(load_mujoco().__version__),
        "device": model.device.name,
        "experiment": experiment.table.model_dump(mode="json", by_alias=True, exclude_none=True),
        "seed": seed,
    }


def joint_unit(model: DynamicModel, j: int) -> str:
    """Unit of a joint's position: rad or m."""
    return "m" if model.device.joints[j].prismatic else "rad"


def _write(path: Path, columns: Mapping[str, tuple[Array, str]], about: Mapping[str, Any]) -> None:
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, (_, unit) in columns.items()]
    schema = pa.schema(fields, metadata={"haptid": json.dumps(about)})
    arrays = [pa.array(np.ascontiguousarray(values)) for values, _ in columns.values()]
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), path)
