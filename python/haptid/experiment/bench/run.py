"""Running bench experiments, one or many in parallel processes, and writing their logs and ground truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.atomic_folder import publishing_files
from haptid._internal.extras import needing
from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.device.elastic import rotors, torsion_places
from haptid.dynamics.inverse import core_torque
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.errors import OutputFolderError
from haptid.executors import Executor, ProcessExecutor
from haptid.experiment.bench.experiment import Experiment, read_experiment
from haptid.experiment.bench.picture import draw_strip
from haptid.experiment.bench.setup import Recording, Setup
from haptid.experiment.bench.simulation import Progress, load_mujoco, simulate
from haptid.experiment.bench.trajectories import per_coordinate, plan

# Random stream of the torque sensors' noise.
_SENSORS = 1
# Columns of a log: name -> (values, unit).
_Columns = dict[str, tuple[Array, str]]


def truth_paths(log: Path) -> tuple[Path, Path]:
    """Paths of the ground truth of a log: parameters (JSON) and exact states (Parquet)."""
    return log.with_suffix(".truth.json"), log.with_suffix(".truth.parquet")


def write_log(path: Path, experiment: Experiment, setup: Setup, made: Recording, seed: int) -> None:
    """Write the log as Parquet, with the unit of every channel and the experiment in the file's metadata.

    The same experiment, device and seed give the same bytes.
    """
    model, columns = setup.model, {"t": (made.t, "s")}
    units = [joint_unit(model, j) for j in model.device.active]
    commands = [drive.command_unit for drive in model.device.motors]
    names = active_names(model)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        columns[f"q{name}"] = (made.position[:, k], unit)
    for k, unit in enumerate(commands):
        columns[f"command{k + 1}"] = (made.command[:, k], unit)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        columns[f"velocity{name}"] = (made.velocity[:, k], f"{unit}/s")
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        columns[f"target{name}"] = (made.target[:, k], unit)
    sensed = _sensed_torque(setup, made, np.random.default_rng((seed, _SENSORS)))
    for name, values in sensed.items():
        drive = next(drive for drive in model.device.elastic if drive.name == name)
        columns[f"sensor_{name}"] = (values, "N" if joint_unit(model, drive.first) == "m" else "N m")
    if made.wrench is not None:
        for k, axis in enumerate("xyz"):
            columns[f"force_{axis}"] = (made.wrench[:, k], "N")
            columns[f"moment_{axis}"] = (made.wrench[:, 3 + k], "N m")
    _write(path, columns, description(experiment, model, seed))


def _sensed_torque(setup: Setup, made: Recording, rng: np.random.Generator) -> dict[str, Array]:
    """What the torque sensors behind springs measure, by the name of the motor, each (samples,), N m or N."""
    sensors, model = setup.torque_sensors, setup.model
    if sensors is None:
        return {}
    active = list(model.device.active)
    c, cd = (model.device.row_map @ x[:, active].T for x in (made.q, made.qd))
    raw = model.device.parameters.S @ setup.chi
    for k, term in enumerate(model.terms, 10 * len(model.device.joints)):
        raw[k] *= term.on.startswith("elastic ")
    raw[: 10 * len(model.device.joints)] = 0.0
    still = np.zeros_like(c)
    rows = core_torque(model, raw, c, cd, still, external(model, c, cd, still))
    noise, offset = (per_coordinate(name, getattr(sensors, name), list(sensors.motors)) for name in ("noise", "offset"))
    carried = dict(zip((drive.name for drive in model.device.elastic), rows[torsion_places(model.device)], strict=True))
    return {
        name: carried[name] + zero + size * rng.standard_normal(c.shape[1])
        for name, size, zero in zip(sensors.motors, noise, offset, strict=True)
    }


def write_truth(path: Path, experiment: Experiment, setup: Setup, made: Recording, seed: int) -> None:
    """Write the ground truth of a log: parameters as JSON, exact states and torques as Parquet."""
    model, (parameters, states) = setup.model, truth_paths(path)
    beta = model.base.of(setup.chi)
    values = {
        **description(experiment, model, seed),
        "base": dict(zip(model.base.names, beta.tolist(), strict=True)),
        "standard": dict(zip(model.device.parameters.names, setup.chi.tolist(), strict=True)),
        "widest_gap": made.gap,
    }
    parameters.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    columns: _Columns = {"t": (made.t, "s")}
    for letter, block, per in (("q", made.q, ""), ("qd", made.qd, "/s"), ("qdd", made.qdd, "/s^2")):
        for j, joint in enumerate(model.device.joints):
            columns[f"{letter}_{joint.name}"] = (block[:, j], joint_unit(model, j) + per)
    for k, drive in enumerate(model.device.motors):
        unit = "N" if joint_unit(model, drive.first) == "m" else "N m"
        columns[f"torque_{drive.name}"] = (made.torque[:, k], unit)
    for k, axis in enumerate("xyz"):
        columns[f"hand_{axis}"] = (made.hand[:, k], "N")
    _write(states, columns, description(experiment, model, seed))


def description(experiment: Experiment, model: DynamicModel, seed: int) -> dict[str, Any]:
    """Provenance of a log: versions, device, experiment and seed, enough to reproduce it."""
    import haptid

    return {
        "haptid": haptid.__version__,
        "mujoco": str(load_mujoco().__version__),
        "device": model.device.name,
        "experiment": experiment.table.model_dump(mode="json", by_alias=True, exclude_none=True),
        "seed": seed,
    }


def active_names(model: DynamicModel) -> list[str]:
    """The active joints' names in columns: 1, 2, ..., and _rotor1, ... of the elastic motors' rotors."""
    own, made = rotors(model.device), [str(k + 1) for k in range(len(model.device.active))]
    for k, place in enumerate(own, 1):
        made[place] = f"_rotor{k}"
    return made


def joint_unit(model: DynamicModel, j: int) -> str:
    """Unit of a joint's position: rad or m."""
    return "m" if model.device.joints[j].prismatic else "rad"


def _write(path: Path, columns: Mapping[str, tuple[Array, str]], about: Mapping[str, Any]) -> None:
    with needing("a log of the bench"):
        import pyarrow as pa
        from pyarrow import parquet
    fields = [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, (_, unit) in columns.items()]
    schema = pa.schema(fields, metadata={"haptid": json.dumps(about)})
    arrays = [pa.array(np.ascontiguousarray(values)) for values, _ in columns.values()]
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


@dataclass(frozen=True)
class Job:
    """One log to simulate.

    Attributes:
        device: name of a shipped device, or path of a device file.
        experiment: path of an experiment file.
        out: path of the log, a Parquet file.
        truth: whether to write the true parameters and exact states next to it.
        seed: in place of the experiment's; None for that.
        picture: whether to write a strip of pictures of the moving device next to it.
    """

    device: str | Path
    experiment: Path
    out: Path
    truth: bool = False
    seed: int | None = None
    picture: bool = False

    @property
    def strip(self) -> Path:
        """Path of that strip."""
        return self.out.with_suffix(".png")


def repeated(job: Job, count: int) -> tuple[Job, ...]:
    """Jobs for several logs of one experiment with consecutive seeds: LOG itself, or LOG-1, LOG-2, ..."""
    if count == 1:
        return (job,)
    first = read_experiment(job.experiment).seed if job.seed is None else job.seed
    names = (job.out.with_name(f"{job.out.stem}-{k + 1}{job.out.suffix}") for k in range(count))
    return tuple(replace(job, out=name, seed=first + k) for k, name in enumerate(names))


def perform(experiment: Experiment, setup: Setup, seed: int, progress: Progress | None = None) -> Recording:
    """Plan the motion and simulate it. Phases and noise have independent random streams, both from the seed."""
    phases, noise = (np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(2))
    return simulate(setup, plan(experiment.kind, setup.model, setup.dt, phases), noise, progress)


def make_log(job: Job, progress: Progress | None = None) -> Path:
    """Simulate and write one log, atomically: on an error no file is left. Returns its path.

    Raises:
        HaptidError: one class for each cause.
    """
    if job.out.suffix != ".parquet":
        raise OutputFolderError(
            f"cannot write {job.out}: a log of the bench is a Parquet file.",
            where=job.out,
            advice="Choose a name that ends in .parquet.",
        )
    experiment, model = read_experiment(job.experiment), DynamicModel(read_device(job.device))
    setup = experiment.setup(model)
    seed = experiment.seed if job.seed is None else job.seed
    with publishing_files(job.out, *truth_paths(job.out), *((job.strip,) if job.picture else ())) as folder:
        made = perform(experiment, setup, seed, progress)
        write_log(folder / job.out.name, experiment, setup, made, seed)
        if job.truth:
            write_truth(folder / job.out.name, experiment, setup, made, seed)
        if job.picture:
            draw_strip(setup.model, made.q[:, list(model.device.active)], made.t, folder / job.strip.name)
    return job.out


def make_logs(
    jobs: Sequence[Job], workers: Executor | None = None, progress: Callable[[Path, float], None] | None = None
) -> tuple[Path, ...]:
    """Simulate and write many logs in parallel.

    Args:
        jobs: the logs.
        workers: the executor; one process per processor where None.
        progress: called after each log with its path and the share of logs that is done.

    Raises:
        HaptidError: the first that a job raised; logs that were made before stay.
    """
    for count, (_, path) in enumerate((workers or ProcessExecutor()).map(make_log, jobs), 1):
        if progress is not None:
            progress(path, count / len(jobs))
    return tuple(job.out for job in jobs)
