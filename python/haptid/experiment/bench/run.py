"""Running experiments: one, or many at a time in processes of their own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from haptid._internal.atomic_folder import publishing
from haptid._internal.workers import Executor, ProcessExecutor
from haptid.device import read_device
from haptid.dynamics.model import DynamicModel
from haptid.errors import OutputError
from haptid.experiment.bench.experiment import Experiment, read_experiment
from haptid.experiment.bench.logs import write_log, write_truth
from haptid.experiment.bench.picture import draw_strip
from haptid.experiment.bench.setup import Recording, Setup
from haptid.experiment.bench.simulation import Tell, simulate
from haptid.experiment.bench.trajectories import plan


@dataclass(frozen=True)
class Job:
    """One log to be made.

    Attributes:
        device: name of a shipped device, or path of a device file.
        experiment: path of an experiment file.
        out: path of the log, a Parquet file.
        truth: whether parameters and exact states go beside it.
        seed: in place of the experiment's; None for that.
        picture: whether a strip of pictures of the moving device goes beside it.
    """

    device: str | Path
    experiment: Path
    out: Path
    truth: bool = False
    seed: int | None = None
    picture: bool = False

    @property
    def strip(self) -> Path:
        """Where that strip goes."""
        return self.out.with_suffix(".png")


def repeated(job: Job, count: int) -> tuple[Job, ...]:
    """Jobs for so many logs of one experiment: LOG itself, or LOG-1, LOG-2, .. with one seed after the other."""
    if count == 1:
        return (job,)
    first = read_experiment(job.experiment).seed if job.seed is None else job.seed
    names = (job.out.with_name(f"{job.out.stem}-{k + 1}{job.out.suffix}") for k in range(count))
    return tuple(replace(job, out=name, seed=first + k) for k, name in enumerate(names))


def perform(experiment: Experiment, setup: Setup, seed: int, tell: Tell | None = None) -> Recording:
    """Plan the motion and simulate it. Phases and noise have streams of their own, both from the seed."""
    phases, noise = (np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(2))
    return simulate(setup, plan(experiment.kind, setup.model, setup.dt, phases), noise, tell)


def make_log(job: Job, tell: Tell | None = None) -> Path:
    """Make one log; nothing is left where something goes wrong. Returns its path.

    Raises:
        HaptidError: one class for each cause.
    """
    if job.out.suffix != ".parquet":
        raise OutputError(job.out, "a log of the bench is a file that ends in .parquet")
    experiment, model = read_experiment(job.experiment), DynamicModel(read_device(job.device))
    setup = experiment.setup(model)
    seed = experiment.seed if job.seed is None else job.seed
    with publishing(job.out.parent) as folder:
        made = perform(experiment, setup, seed, tell)
        write_log(folder / job.out.name, experiment, setup, made, seed)
        if job.truth:
            write_truth(folder / job.out.name, experiment, setup, made, seed)
        if job.picture:
            draw_strip(setup.model, made.q[:, list(model.device.active)], made.t, folder / job.strip.name)
    return job.out


def make_logs(
    jobs: Sequence[Job], workers: Executor | None = None, tell: Callable[[Path, float], None] | None = None
) -> tuple[Path, ...]:
    """Make many logs, several at a time.

    Args:
        jobs: what to make.
        workers: who makes them; as many processes as there are processors where None.
        tell: called after each log with its path and the share of logs that is done.

    Raises:
        HaptidError: the first that a job raised; logs that were made before stay.
    """
    for count, (_, path) in enumerate((workers or ProcessExecutor()).map(make_log, jobs), 1):
        if tell is not None:
            tell(path, count / len(jobs))
    return tuple(job.out for job in jobs)
