"""Logs of the mountings on the bench: as encoders see them and with exact sensors, and what is true of each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyarrow import parquet

from haptid._internal.arrays import Array, expect, read_only
from haptid._internal.workers import ProcessExecutor
from haptid.device import read_device
from haptid.dynamics.inverse import inverse_dynamics
from haptid.dynamics.model import DynamicModel
from haptid.errors import MountingError
from haptid.experiment.bench.experiment import read_experiment
from haptid.experiment.bench.run import perform, truth_paths, write_log, write_truth
from haptid.experiment.bench.setup import Encoders
from haptid.log import Channels, Log, Signal, read_log
from haptid.motion.streaming import lost
from haptid.motion.treatment import Motion, Treatment, treat

# What of a mounting's torque the device's own base parameters may leave, as a share: rounding.
LEFT = 1e-9
# States at which torques are compared to find base parameters, per parameter.
STATES = 20


@dataclass(frozen=True)
class Take:
    """A log to be recorded.

    Attributes:
        model: name of a shipped device.
        experiment: path of an experiment file.
        out: path of the log.
        exact: whether sensors are exact, in place of the experiment's encoders.
        seed: in place of the experiment's; None for that.
        step: of the simulator, in place of the experiment's, s; None for that.
        quiet: whether amplifiers have no noise.
    """

    device: str
    experiment: Path
    out: Path
    exact: bool = False
    seed: int | None = None
    step: float | None = None
    quiet: bool = False


def record(take: Take) -> Path:
    """Simulate, and write the log with the truth beside it; returns its path."""
    experiment, model = read_experiment(take.experiment), DynamicModel(read_device(take.device))
    setup = experiment.setup(model)
    if take.exact:
        setup = replace(setup, encoders=Encoders())
    if take.quiet:
        setup = replace(setup, amplifiers=replace(setup.amplifiers, noise=(0.0,)))
    if take.step is not None:
        setup = replace(setup, physics=replace(setup.physics, step=take.step))
    seed = experiment.seed if take.seed is None else take.seed
    made = perform(experiment, setup, seed)
    write_log(take.out, experiment, setup, made, seed)
    write_truth(take.out, experiment, setup, made, seed)
    return take.out


def record_all(takes: Sequence[Take], processes: int | None = None) -> Iterator[Path]:
    """Record many, several at a time; the path of each as it is done."""
    for _, path in ProcessExecutor(processes).map(record, takes):
        yield path


@dataclass(frozen=True, eq=False)
class Recorded:
    """A log of the bench and what is true of it.

    Attributes:
        model: as in its file: how it was mounted is not told.
        path: of the log.
        beta: true base parameters of the device as in its file, (p,), SI.
        t: of all samples, (n,), s.
        q, qd, qdd: exact, of the active joints, each (active, n), SI.
        hand: exact force of the hand in the base frame, (n, 3), N.
        sensor: the same as a force sensor gives it, in the handle's frame, (n, 3), N; NaN without one.
    """

    model: DynamicModel
    path: Path
    beta: Array
    t: Array
    q: Array
    qd: Array
    qdd: Array
    hand: Array
    sensor: Array

    def __post_init__(self) -> None:
        for name in ("beta", "t", "q", "qd", "qdd", "hand", "sensor"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        expect("beta", self.beta.shape, (len(self.model.base),))
        for name in ("q", "qd", "qdd"):
            expect(name, getattr(self, name).shape, (len(self.model.device.active), len(self.t)))

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return float(self.t[1] - self.t[0])

    def log(self, stretch: tuple[float, float]) -> Log:
        """What the controller has of a stretch of the log, s: positions and commands."""
        unit = self.model.device.motors[0].unit
        channels = Channels(
            Signal(tuple(f"q{k + 1}" for k in range(len(self.model.device.active))), "rad"),
            Signal(tuple(f"command{k + 1}" for k in range(len(self.model.device.motors))), unit, side="motor"),
            time="t",
        )
        return read_log(self.path, channels, stretch=stretch)

    def motion(self, stretch: tuple[float, float], treatment: Treatment) -> Motion:
        """A stretch of the log, treated."""
        return treat(self.log(stretch), treatment)

    def exact(self, stretch: tuple[float, float], treatment: Treatment) -> Motion:
        """The same with exact positions, velocities and accelerations in place of what sensors give."""
        motion = self.motion(stretch, treatment)
        at = self.index(motion.t)
        edge = lost(treatment.torque_delay_s / motion.dt)
        inner = slice(edge, len(at) - edge)
        q, qd, qdd = (x[:, at[inner]].T for x in (self.q, self.qd, self.qdd))
        return replace(motion, q=q, tau=motion.tau[inner], t0=float(motion.t[edge]), rates=(qd, qdd))

    def index(self, t: Array) -> np.ndarray:
        """Index of the samples at these times, (times,)."""
        return np.asarray(np.rint((t - self.t[0]) / self.dt).astype(int))

    def during(self, stretch: tuple[float, float]) -> np.ndarray:
        """Whether each sample is inside a stretch, (n,)."""
        return np.asarray((self.t >= stretch[0]) & (self.t <= stretch[1]))


def read_recorded(model: DynamicModel, experiment: Path, path: Path) -> Recorded:
    """A log that `record` wrote, and its truth.

    Args:
        model: as in its file.
        experiment: what was recorded.
        path: of the log.

    Raises:
        MountingError: the mounting's torques are none that the device's own base parameters can make.
    """
    parameters, states = truth_paths(path)
    mounted = read_experiment(experiment).setup(model).model
    named = json.loads(parameters.read_text(encoding="utf-8"))["base"]
    truth, table = np.array([named[name] for name in mounted.base.names]), parquet.read_table(states)
    names = [model.device.joint_names[j] for j in model.device.active]
    q, qd, qdd = (_columns(table, [f"{kind}_{name}" for name in names]) for kind in ("q", "qd", "qdd"))
    return Recorded(
        model=model,
        path=path,
        beta=as_in_file(model, mounted, truth),
        t=_columns(table, ["t"])[0],
        q=q,
        qd=qd,
        qdd=qdd,
        hand=_columns(table, [f"hand_{axis}" for axis in "xyz"]).T,
        sensor=_sensor(path, len(table)),
    )


def as_in_file(model: DynamicModel, mounted: DynamicModel, beta: Array) -> Array:
    """Base parameters with which a device as in its file has the torques of a mounted one, (p,), SI.

    Args:
        model: with the gravity of its file.
        mounted: the same with another gravity.
        beta: base parameters of the mounted one, (p,), SI.

    Raises:
        MountingError: there are none.
    """
    p, rng = len(model.base), np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, len(model.device.active), STATES * p))
    wanted = inverse_dynamics(mounted, beta, q, qd, qdd).ravel()
    columns = np.array([inverse_dynamics(model, unit, q, qd, qdd).ravel() for unit in np.eye(p)]).T
    found, *_ = np.linalg.lstsq(columns, wanted, rcond=None)
    left = float(np.linalg.norm(columns @ found - wanted) / np.linalg.norm(wanted))
    if left > LEFT:
        raise MountingError(model.device.name, left, LEFT)
    return np.asarray(found)


def _sensor(path: Path, samples: int) -> Array:
    """The force sensor's channels of a log, NaN where it has none, (samples, 3), N."""
    names = [f"force_{axis}" for axis in "xyz"]
    if names[0] not in parquet.read_schema(path).names:
        return np.full((samples, 3), np.nan)
    return _columns(parquet.read_table(path, columns=names), names).T


def _columns(table: Any, names: list[str]) -> Array:
    """Columns of a table, (names, n)."""
    return np.array([table[name].to_numpy() for name in names])
