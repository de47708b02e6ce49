"""Logs of the virtual bench with their ground truth: exact states, true base parameters and the hand's true force."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.extras import needing
from haptid._internal.late import dataclass
from haptid.device import read_device
from haptid.device.elastic import without_torsion
from haptid.dynamics.inverse import core_torque, inverse_dynamics, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.errors import IdentifiabilityError
from haptid.executors import ProcessExecutor
from haptid.experiment.bench.elastic import planned_torque
from haptid.experiment.bench.experiment import read_experiment
from haptid.experiment.bench.run import perform, truth_paths, write_log, write_truth
from haptid.experiment.bench.setup import Encoders
from haptid.log import Channels, Log, Signal, read_log
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment

with needing("a log of the bench"):
    from pyarrow import parquet

# Largest relative torque residual of a mounting expressed in the device's own base parameters: rounding.
LARGEST_RESIDUAL = 1e-9
# States per parameter at which the torques are compared.
_STATES = 20


@dataclass(frozen=True)
class Take:
    """A log to be recorded.

    Attributes:
        device: name of a shipped device.
        experiment: path of the experiment file.
        out: path of the log.
        exact: exact sensors in place of the experiment's encoders.
        seed: in place of the experiment's; None keeps that one.
        step: of the simulator, in place of the experiment's, s; None keeps that one.
        quiet: amplifiers without noise.
    """

    device: str
    experiment: Path
    out: Path
    exact: bool = False
    seed: int | None = None
    step: float | None = None
    quiet: bool = False


def record(take: Take) -> Path:
    """Simulate, and write the log and its ground truth; returns the path of the log."""
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
    """Record logs in parallel; yields the path of each as it is done."""
    for _, path in ProcessExecutor(processes).map(record, takes):
        yield path


@dataclass(frozen=True, eq=False)
class BenchRecording:
    """A log of the virtual bench with its ground truth.

    Attributes:
        model: with the gravity of its file, however the device was mounted.
        path: of the log.
        beta: true base parameters of `model`, (p,), SI.
        t: of all samples, (n,), s.
        q, qd, qdd: exact, of the active joints, each (active, n), SI.
        positions: channels of the active joints' positions: those of the motors where these are elastic.
        hand: exact force of the hand in the base frame, (n, 3), N.
        sensor: force measured by the force sensor in the handle's frame, (n, 3), N; NaN without a sensor.
    """

    model: DynamicModel
    path: Path
    beta: Array
    t: Array
    q: Array
    qd: Array
    qdd: Array
    positions: tuple[str, ...]
    hand: Array
    sensor: Array

    def __post_init__(self) -> None:
        states = (len(self.model.device.active), len(self.t))
        freeze_fields(self, "t", "hand", "sensor", beta=(len(self.model.base),), q=states, qd=states, qdd=states)

    @property
    def dt(self) -> float:
        """Sampling period, s."""
        return float(self.t[1] - self.t[0])

    def log(self, time_range: tuple[float, float]) -> Log:
        """Positions and commands between two times, s: the channels that an identification uses."""
        motors = self.model.device.motors
        channels = Channels(
            Signal(self.positions, "rad"),
            Signal(tuple(f"command{k + 1}" for k in range(len(motors))), motors[0].command_unit, side="motor"),
            time="t",
        )
        return read_log(self.path, channels, time_range=time_range)

    def motion(self, time_range: tuple[float, float], treatment: Treatment) -> Motion:
        """The log between two times, s, treated."""
        return treat(self.log(time_range), treatment)

    def exact(self, time_range: tuple[float, float], treatment: Treatment) -> Motion:
        """The same with exact positions, velocities and accelerations in place of the sensors'."""
        motion = self.motion(time_range, replace(treatment, cutoff_hz=None))
        at = self.index(motion.t)
        edge = motion.treatment.lost_to_delay(motion.dt)
        inner = slice(edge, len(at) - edge)
        q, qd, qdd = (x[:, at[inner]].T for x in (self.q, self.qd, self.qdd))
        assert motion.log is not None
        log = motion.log.between(inner.start, inner.stop)
        return replace(motion, q=q, tau=motion.tau[inner], log=log, t0=float(motion.t[edge]), rates=(qd, qdd))

    def index(self, t: Array) -> np.ndarray:
        """Index of the samples at these times, (times,)."""
        return np.asarray(np.rint((t - self.t[0]) / self.dt).astype(int))

    def during(self, time_range: tuple[float, float]) -> np.ndarray:
        """Whether each sample is between two times, s, (n,)."""
        return np.asarray((self.t >= time_range[0]) & (self.t <= time_range[1]))


def read_recording(model: DynamicModel, experiment: Path, path: Path) -> BenchRecording:
    """A log that `record` wrote, with its ground truth.

    Args:
        model: with the gravity of its file.
        experiment: path of the experiment file.
        path: of the log.

    Raises:
        IdentifiabilityError: the torques of the mounting cannot be expressed in the device's own base parameters.
    """
    parameters, states = truth_paths(path)
    mounted = read_experiment(experiment).setup(model).model
    written, table = json.loads(parameters.read_text(encoding="utf-8")), parquet.read_table(states)
    truth = np.array([written["base"][name] for name in mounted.base.names])
    rotors = "_rotor" if mounted.device.elastic else ""
    names = [model.device.joint_names[j] for j in model.device.active]
    q, qd, qdd = (_columns(table, [f"{kind}_{name}" for name in names]) for kind in ("q", "qd", "qdd"))
    forces = [f"force_{axis}" for axis in "xyz"]
    measured = set(forces) <= set(parquet.read_schema(path).names)
    unmeasured = np.full((len(table), 3), np.nan)
    return BenchRecording(
        model=model,
        path=path,
        beta=truth if mounted is model else as_in_file(model, mounted, truth),
        positions=tuple(f"q{rotors}{k + 1}" for k in range(len(names))),
        t=_columns(table, ["t"])[0],
        q=q,
        qd=qd,
        qdd=qdd,
        hand=_columns(table, [f"hand_{axis}" for axis in "xyz"]).T,
        sensor=_columns(parquet.read_table(path, columns=forces), forces).T if measured else unmeasured,
    )


def as_in_file(model: DynamicModel, mounted: DynamicModel, beta: Array) -> Array:
    """Base parameters of a device file that give the torques of the device as it was mounted, (p,), SI.

    Without torsion, and without the terms that only the mounted device has; rotors behind springs are part of it.

    Args:
        model: of the file.
        mounted: the same with another gravity and further terms.
        beta: base parameters of the mounted one, (p,), SI.

    Raises:
        IdentifiabilityError: there are none.
    """
    p, rng, device = len(model.base), np.random.default_rng(0), mounted.device
    q, qd, qdd = rng.uniform(-1, 1, (3, len(model.device.active), _STATES * p))
    states = [without_torsion(device, x.T, position=x is q).T for x in (q, qd, qdd)]
    known = {term.name for term in model.terms}
    raw = raw_parameters(mounted, beta)
    for k, term in enumerate(mounted.terms, 10 * len(device.joints)):
        raw[k] *= term.name in known or term.nature == "rotor"
    c, cd, cdd = (device.row_map @ x for x in states)
    wanted = core_torque(mounted, raw, c, cd, cdd, external(mounted, c, cd, cdd))
    if device.elastic:
        wanted = planned_torque(device, c, wanted)
    columns = np.array([inverse_dynamics(model, unit, q, qd, qdd).ravel() for unit in np.eye(p)]).T
    found, *_ = np.linalg.lstsq(columns, wanted.ravel(), rcond=None)
    residual = float(np.linalg.norm(columns @ found - wanted.ravel()) / np.linalg.norm(wanted))
    if residual > LARGEST_RESIDUAL:
        raise IdentifiabilityError(
            f"the torques of {model.device.name} as mounted cannot be expressed in the base parameters of its device "
            f"file: relative residual {residual:.1e}, limit {LARGEST_RESIDUAL:.1e}.",
            where=model.device.name,
            found=residual,
            limit=LARGEST_RESIDUAL,
            advice="Identify it with the gravity of its mounting.",
        )
    return np.asarray(found)


def _columns(table: Any, names: list[str]) -> Array:
    """Columns of a table, (names, n)."""
    return np.array([table[name].to_numpy() for name in names])
