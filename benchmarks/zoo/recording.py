"""What a recorder makes of a plant's motion and torque: noise, quantisation, delays, jitter, repeats and gaps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
from scipy import signal

import haptid
from haptid.experiment import bench
from zoo.case import Array, Case
from zoo.kept import kept
from zoo.plant import Plant, device_text

# Pole of coloured encoder noise, Hz; the lowest one of coloured torque noise; waves of ripple in a turn, over 2^bits.
ENCODER_HZ, TORQUE_HZ, FINER = 10.0, 2.0, 16
# Mean length of a gap, rows.
GAP = 6
# Points of the unseen motion, over five of its periods.
UNSEEN = 3000
# Natural frequency of the control loop over that of the motion, its least in Hz, its damping ratio, its rate, and
# how often its gains are lowered by 0.7.
STIFF, LEAST_HZ, DAMPING, CONTROL_HZ, SOFTER = 2.5, 6.0, 0.8, 1000.0, 8


@dataclass(frozen=True)
class Recorded:
    """A log's columns and what is true of it.

    Attributes:
        t: stamps, (n,), s.
        q: positions at the encoders' side, (joints, n), rad.
        command: in the motors' unit, (motors, n).
        delays: true ones of each motor, s.
    """

    t: Array
    q: Array
    command: Array
    delays: Array

    @property
    def columns(self) -> dict[str, Array]:
        named = {f"q{k + 1}": row for k, row in enumerate(self.q)}
        return {"t": self.t} | named | {f"u{k + 1}": row for k, row in enumerate(self.command)}


def undisturbed(case: Case) -> Case:
    """The case with a perfect time base and without delay, unless a control loop has it; its noise is the same."""
    time = replace(case, jitter=0.0, stale=0.0, gaps=0.0)
    return time if case.loop else replace(time, delay=0.0, spread=0.0)


def record(plant: Plant) -> Recorded:
    """The log of a case."""
    case = plant.case
    t, at = _times(case)
    q, tau, delays = _bench_log(plant) if case.loop else _computed(plant, at)
    n = min(len(t), q.shape[1])
    t, q, tau = t[:n], case.gear * q[:, :n], tau[:, :n]
    command = tau / plant.scales[:, None]
    q, command = _repeated(case, q, command)
    there = _there(case, len(t))
    return Recorded(t[there], q[:, there], command[:, there], delays)


def _times(case: Case) -> tuple[Array, Array]:
    """Stamps, whole microseconds of which no two are equal, and the instants of the samples, each (n,), s."""
    regular = np.arange(round(case.rate * case.seconds)) / case.rate
    t = np.sort(regular + case.jitter / case.rate * case.random("jitter").normal(size=len(regular)))
    counted = np.arange(len(t))
    stamps = np.maximum.accumulate(np.round(1e6 * t).astype(int) - counted) + counted
    return 1e-6 * stamps, t if case.stamps == "true" else regular


def _computed(plant: Plant, at: Array) -> tuple[Array, Array, Array]:
    """Positions, torques and delays along the analytic motion; noise is outside any loop."""
    case, n = plant.case, len(at)
    joints = len(plant.motion.centre)
    delays = np.clip(case.delay + case.spread * case.random("delays").uniform(-1, 1, joints), 0, None) / case.rate
    (q, _, _), tau = plant.act(plant.motion, at)
    if delays.any():
        late = {d: plant.act(plant.motion, at + d)[1] for d in set(delays.tolist())}
        tau = np.stack([late[d][k] for k, d in enumerate(delays.tolist())])
    noise, encoder = case.random("torque"), case.random("encoder")
    tau = tau + [case.level * rms(row) * coloured(noise, n, case.noise, case.rate, case.motion_hz) for row in tau]
    step = 2 * np.pi / 2**case.bits / case.gear
    if case.encoder == "AR":
        q = q + [case.steps * step * _ar(encoder, n, ENCODER_HZ / case.rate) for _ in q]
    elif case.encoder == "ripple":
        phase = encoder.uniform(0, 2 * np.pi, (joints, 1))
        q = q + np.sqrt(2) * case.steps * step * np.sin(2 * np.pi * q / (FINER * step) + phase)
    return step * np.round(q / step), tau, delays


def rms(row: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(row**2)))


def coloured(rng: np.random.Generator, n: int, kind: str, rate: float, motion_hz: float) -> Array:
    """Noise of unit variance, (n,)."""
    if kind == "AR":
        return _ar(rng, n, max(TORQUE_HZ, 2 * motion_hz) / rate)
    e = rng.normal(size=n)
    if kind == "walk":
        e = np.cumsum(e)
        e = e - e.mean()
    return e / e.std()


def _ar(rng: np.random.Generator, n: int, pole: float) -> Array:
    """AR(1) noise with its pole at a share of the rate."""
    rho = np.exp(-2 * np.pi * pole)
    e = signal.lfilter([1.0], [1.0, -rho], rng.normal(size=n))
    return np.asarray(e / e.std())


class _Disturbance:
    """The generator of the bench's amplifier noise, coloured."""

    def __init__(self, case: Case) -> None:
        self.case, self.rng = case, case.random("torque")

    def standard_normal(self, shape: tuple[int, int]) -> Array:
        n, motors = shape
        made = [coloured(self.rng, n, self.case.noise, CONTROL_HZ, self.case.motion_hz) for _ in range(motors)]
        return np.stack(made, axis=1)


def _bench_log(plant: Plant) -> tuple[Array, Array, Array]:
    """What the bench recorded; it is simulated once for all that a recorder does to it, because it takes seconds."""
    case = undisturbed(plant.case)

    def simulate() -> dict[str, Any]:
        return dict(zip(("q", "tau", "delays"), (x.tolist() for x in _on_the_bench(Plant(case))), strict=True))

    made = kept("bench", case, ("plant.py", "recording.py"), simulate)
    return np.array(made["q"]), np.array(made["tau"]), np.array(made["delays"])


def _on_the_bench(plant: Plant) -> tuple[Array, Array, Array]:
    """Positions, recorded torques and delays of the closed loop, at the log's rate; noise acts unrecorded.

    Delays are of control periods, not of the log's samples. Where the loop is not stable its gains are lowered.
    """
    case, model, dt = plant.case, plant.model, 1 / CONTROL_HZ
    grid = dt * np.arange(round(case.seconds * CONTROL_HZ))
    trajectory = bench.Trajectory(dt, *(x.T.copy() for x in plant.motion.states(grid)))
    inertia = np.diag(haptid.dynamics.mass_matrix(model, plant.beta, plant.motion.centre[:, None])[0])
    noise = tuple(case.level * rms(row) for row in plant.act(plant.motion, grid)[1])
    w, late = 2 * np.pi * max(LEAST_HZ, STIFF * case.motion_hz), case.delay * dt
    for _ in range(SOFTER):
        gains = tuple(inertia * w**2), tuple(2 * DAMPING * w * inertia)
        controller = bench.Controller(*gains, gravity=True, rate_hz=CONTROL_HZ, tracking_limit=2.0)
        encoders, amplifiers = bench.Encoders((float(2**case.bits),)), bench.Amplifiers(noise=noise, delay=late)
        setup = bench.Setup(model, plant.chi, controller, encoders, amplifiers)
        try:
            made = bench.simulate(setup, trajectory, _Disturbance(case))  # type: ignore[arg-type]
        except haptid.errors.SimulationError:
            w *= 0.7
            continue
        every = round(CONTROL_HZ / case.rate)
        delays = np.full(len(noise), late + 0.5 * dt)  # the command is constant over a control period
        return made.position[::every].T, (made.command * plant.scales)[::every].T, delays
    raise RuntimeError(f"no gains keep the loop of {case} stable")


def _repeated(case: Case, q: Array, command: Array) -> tuple[Array, Array]:
    """Both with rows that repeat the one before."""
    if not case.stale:
        return q, command
    rows = np.arange(q.shape[1])
    rows[np.flatnonzero(case.random("stale").random(len(rows)) < case.stale)] = 0
    rows = np.maximum.accumulate(rows)
    return q[:, rows] if case.repeats != "torques" else q, command[:, rows] if case.repeats != "positions" else command


def _there(case: Case, n: int) -> Array:
    """Rows that are not missing, (n,)."""
    rows, rng = np.ones(n, dtype=bool), case.random("gaps")
    if case.gaps:
        for start in rng.integers(1, n - 1, max(1, round(case.gaps * n / GAP))):
            rows[start : start + rng.geometric(1 / GAP)] = False
    rows[[0, -1]] = True
    return rows


def unseen(plant: Plant) -> tuple[tuple[Array, Array, Array], Array]:
    """States and torque of the unseen motion, without noise."""
    t = np.linspace(0, 5 * plant.case.harmonics / plant.case.motion_hz, UNSEEN)
    return plant.act(plant.unseen, t)


def write(plant: Plant, made: Recorded, folder: Path) -> Path:
    """The study file of a recorded log, with its device file and log; nothing of the treatment is given."""
    (folder / "device.toml").write_text(device_text(plant.case), encoding="utf-8")
    pyarrow.csv.write_csv(pa.table(made.columns), folder / "log.csv")
    q = ", ".join(f'"q{k + 1}"' for k in range(len(made.q)))
    u = ", ".join(f'"u{k + 1}"' for k in range(len(made.command)))
    side = "joint" if plant.case.gear == 1.0 else "motor"
    study = f"""
schema = 1
name = "zoo"
device = "device.toml"
[channels]
time = "t"
position = {{ channels = [{q}], unit = "rad", side = "{side}" }}
torque = {{ channels = [{u}], unit = "N m", side = "motor" }}
[[logs]]
path = "log.csv"
[validation]
cross_validation = "blocks"
"""
    (folder / "study.toml").write_text(study, encoding="utf-8")
    return folder / "study.toml"
