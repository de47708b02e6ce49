"""Stiffness and damping of elastic motors: how often 95 % intervals hold them, and how far off they are.

An axis in closed form, without dry friction; the arm with three joints, the PHANToM with cables that stretch and a CEA
branch on the virtual bench, with dry friction of the motors: 15 s of multisine at 1 kHz, torque noise, encoders of 12
bits on both sides or of 4000 counts on geared shafts, a new motion in each run, treated as proposed. A run that haptid
refuses counts as refused. With `--motors-alone` the links' positions are left out, and nothing else is given. With
`--minutes M` no run begins later than that; those that were done are counted, and the next call goes on behind them.
`--device NAME` takes one device alone, `--encoders NAME` one kind of encoder, `--first N` seeds from N on. Figures of
cases without a run stay as they were recorded.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import haptid
from haptid.device.toml.reader import checked_tables, device_of
from haptid.errors import HaptidError
from haptid.estimation.methods.motor_noise import with_noise_uncertainty
from haptid.experiment import bench
from haptid.motion.channels import position_channels
from haptid.treatment_choice.elasticity import expect_elasticity
from haptid.treatment_choice.hidden_joints import complete_logs
from haptid.treatment_choice.motor_delays import with_motor_delays
from haptid.treatment_choice.uncertainty import with_treatment_uncertainty
from true_parameters import true_parameters

RESULT = Path(__file__).parent / "results/elastic-coverage.json"
SECONDS, RUNS = 15.0, 200
# Of the simulator: positions are within 1e-5 of those with a fifth of it, and torques within 2e-4, of their rms.
STEP_S = 2.5e-4
ENCODERS, ALONE = ("12 bits", "4000 counts"), ", motors alone"
COUNTS = {"12 bits": 4096.0, "4000 counts": 4000.0, "exact": 1e9}
# Tables of device files that name parameters which the elastic device does not have.
_LEFT_OUT = ("prior", "targets", "symmetry", "base_parameters", "published", "counterweights")
ELASTIC = [{"kind": "elastic", "motors": "all"}]
AXIS = {
    "schema": 1,
    "name": "axis",
    "gravity": [0.0, 0.0, -9.81],
    "joints": [{"name": "1"}],
    "terms": [
        {"kind": "rotor-inertia", "motors": "all"},
        {"kind": "viscous", "motors": "all", "prefix": "FV"},
        {"kind": "coulomb", "motors": "all", "prefix": "FC"},
    ],
}


@dataclass(frozen=True)
class Plant:
    """An elastic device on the bench.

    Attributes:
        stiffness, damping, rotor: of each motor, at the joint: N m/rad, N m s/rad, kg m^2.
        kp, kd: of the controller.
        centre, amplitude: of the motion, rad; up to this frequency, Hz.
        gear: of the motors' shafts.
        noise: of the torque, N m.
        friction: Coulomb, N m, and viscous, N m s/rad.
    """

    stiffness: tuple[float, ...]
    damping: tuple[float, ...]
    rotor: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    centre: tuple[float, ...]
    amplitude: tuple[float, ...]
    highest: float
    gear: tuple[float, ...]
    noise: float
    friction: tuple[float, float]


PLANTS = {
    "axis": Plant((600.0,), (0.5,), (0.05,), (60.0,), (2.0,), (0.0,), (1.0,), 10.0, (50.0,), 0.05, (0.3, 0.1)),
    "arm3": Plant(
        (500.0, 500.0, 250.0),
        (0.8, 0.8, 0.4),
        (0.02, 0.02, 0.01),
        (80.0, 80.0, 40.0),
        (2.0, 2.0, 1.0),
        (0.0, 0.7, -1.0),
        (0.7, 0.5, 0.7),
        8.0,
        (50.0,) * 3,
        0.05,
        (0.2, 0.05),
    ),
    "phantom_premium_15": Plant(
        (30.0, 30.0, 15.0),
        (0.02, 0.02, 0.01),
        (4e-4, 4e-4, 2e-4),
        (12.0, 10.0, 5.0),
        (0.12, 0.1, 0.05),
        (0.0, 0.0, 0.0),
        (0.7, 0.45, 0.46),
        8.0,
        (13.3, 11.2, 11.2),
        2e-3,
        (0.02, 1e-3),
    ),
    "cea_medical_branch": Plant(
        (300.0, 200.0, 60.0),
        (0.4, 0.3, 0.1),
        (0.012, 0.012, 0.004),
        (100.0, 50.0, 25.0),
        (2.0, 0.8, 0.4),
        (0.1, -1.2, 3.5),
        (1.0, 0.4, 0.4),
        6.0,
        (20.0,) * 3,
        0.02,
        (0.1, 0.02),
    ),
}


@cache
def model_of(name: str) -> haptid.DynamicModel:
    """The device with springs behind all its motors and friction, and no other terms, which the bench would hold."""
    whole = AXIS if name == "axis" else haptid.read_device(name).tables.model_dump(by_alias=True, exclude_unset=True)
    tables = {key: value for key, value in whole.items() if key not in _LEFT_OUT}
    friction = [t for t in tables["terms"] if t["kind"] == "viscous" or (t["kind"] == "coulomb" and "motors" in t)]
    tables["terms"] = [*ELASTIC, {"kind": "rotor-inertia", "motors": "all", "prefix": "IROTOR"}, *friction]
    return haptid.DynamicModel(device_of(*checked_tables(tables, name)))


def parameters(name: str) -> np.ndarray:
    """True standard parameters, (p,)."""
    model, plant = model_of(name), PLANTS[name]
    original = None if name == "axis" else haptid.DynamicModel(haptid.read_device(name))
    chi = np.zeros(len(model.device.parameters))
    index = model.device.parameters.index
    if original is None:
        chi[[index[n] for n in ("XX1", "YY1", "ZZ1", "M1")]] = 0.1, 0.1, 0.1, 1.0
        plant = replace(plant, friction=(0.0, plant.friction[1]))
    else:
        bodies = true_parameters(original)
        S = original.device.parameters.S @ bodies
        raw = dict(zip(original.device.parameters.raw, S, strict=True))
        for k, n in enumerate(model.device.parameters.names):
            chi[k] = raw.get(n, 0.0)
    for k, motor in enumerate(model.device.motors):
        values = {"KE": plant.stiffness, "DE": plant.damping, "IROTOR": plant.rotor}
        for prefix, each in values.items():
            chi[index[f"{prefix}{motor.name}"]] = each[k]
    for k, kind in enumerate(model.device.parameters.kinds):
        if kind.startswith("FC"):
            chi[k] = plant.friction[0]
        elif kind.startswith("FV"):
            chi[k] = plant.friction[1]
    return chi


def recorded(name: str, encoders: str, seed: int) -> haptid.Log:
    """A log of both sides."""
    if name == "axis":
        return in_closed_form(encoders, seed)
    model, plant = model_of(name), PLANTS[name]
    drives, motors = model.device.drives, len(model.device.motors)
    gear = (*plant.gear, *(1.0,) * (len(drives) - motors)) if encoders == "4000 counts" else (1.0,)
    counts = COUNTS[encoders]
    setup = bench.Setup(
        model,
        parameters(name),
        bench.Controller(plant.kp, plant.kd, gravity=True),
        bench.Encoders((counts,), gear),
        bench.Amplifiers(noise=(plant.noise,)),
        bench.Physics(STEP_S),
    )
    kind = bench.Multisine(SECONDS, plant.centre, plant.amplitude, frequencies_hz=(0.3, plant.highest), count=8)
    made = bench.simulate(
        setup, bench.plan(kind, model, setup.dt, np.random.default_rng(seed)), np.random.default_rng(10_000 + seed)
    )
    channels = haptid.Channels(
        haptid.Signal(tuple(f"q{k}" for k in range(made.position.shape[1])), "rad"),
        haptid.Signal(tuple(f"u{k}" for k in range(motors)), "N m", side="motor"),
        "t",
    )
    return haptid.Log(
        Path("bench"),
        str(seed),
        made.t,
        np.ascontiguousarray(made.position),
        np.ascontiguousarray(made.command),
        channels,
    )


def in_closed_form(encoders: str, seed: int) -> haptid.Log:
    """A log of the axis without dry friction: sines from 0.4 to 10 Hz of the link, both sides, noise of the torque."""
    plant, J, dt = PLANTS["axis"], 0.1, 1e-3
    rng, t = np.random.default_rng(seed), dt * np.arange(round(SECONDS / dt))
    K, D, IA, FV = plant.stiffness[0], plant.damping[0], plant.rotor[0], plant.friction[1]
    s = 2j * np.pi * np.geomspace(0.4, plant.highest, 16) * rng.uniform(0.97, 1.03, 16)
    Q = (1.5 / np.abs(s)) * np.exp(1j * rng.uniform(0, 2 * np.pi, 16))
    motor = Q * (J * s**2 + D * s + K) / (D * s + K)
    torque = motor * (IA * s**2 + FV * s) + (K + D * s) * (motor - Q)
    q, theta, tau = ((x[:, None] * np.exp(s[:, None] * t)).real.sum(axis=0) for x in (Q, motor, torque))
    counts = COUNTS[encoders]
    steps = 2 * np.pi / np.array([counts, counts * plant.gear[0] if encoders == "4000 counts" else counts])
    seen = steps * np.round(np.column_stack([q, theta]) / steps)
    tau = tau + plant.noise * rng.standard_normal(len(t))
    channels = haptid.Channels(haptid.Signal(("q", "theta"), "rad"), haptid.Signal(("u",), "N m", side="motor"), "t")
    return haptid.Log(Path("made"), str(seed), t, seen, tau[:, None], channels)


def identified(model: haptid.DynamicModel, log: haptid.Log) -> haptid.Estimate:
    """As `haptid identify` does it."""
    proposal = haptid.propose(model, log)
    found = haptid.estimate(haptid.observe(model, haptid.treat(log, proposal.treatment)), haptid.WLS())
    expect_elasticity(found, proposal.bandwidth_hz)
    return with_treatment_uncertainty(found, proposal.delays, proposal.effects, proposal.rounding)


def of_motors(model: haptid.DynamicModel, log: haptid.Log) -> haptid.Log:
    """The log without positions of the links."""
    names = position_channels(model.device, log.channels.position.side)
    idle = {model.device.joints[drive.first].name for drive in model.device.drives if drive.unloaded}
    kept = [k for k, name in enumerate(names) if name not in idle]
    channels = tuple(log.channels.position.channels[k] for k in kept)
    position = replace(log.channels.position, channels=channels, gain=(), offset=())
    seen = np.ascontiguousarray(log.position[:, kept])
    return replace(log, position=seen, channels=replace(log.channels, position=position))


def identified_from_motors(model: haptid.DynamicModel, log: haptid.Log) -> haptid.Estimate:
    """As `haptid identify` does it without the links."""
    return with_noise_uncertainty(with_motor_delays(complete_logs(model, [of_motors(model, log)], [True])[1]))


def reading(run: tuple[str, str, int]) -> dict[str, list[float]] | str:
    """By parameter: estimate over truth less one, standard error over truth, half-width over truth; or why refused."""
    name, encoders, seed = run
    model = model_of(name)
    truth = model.base.of(parameters(name))
    try:
        log = recorded(name, encoders.removesuffix(ALONE), seed)
        found = identified_from_motors(model, log) if encoders.endswith(ALONE) else identified(model, log)
    except HaptidError as error:
        return f"{type(error).__name__}: {error}"[:200]
    half = stats.t.ppf(0.975, found.dof) * found.se
    return {
        n: [float(b / t - 1), float(s / t), float(h / t)]
        for n, b, t, s, h in zip(found.names, found.beta, truth, found.se, half, strict=True)
        if t
    }


def summary(lines: Sequence[tuple[tuple[str, str, int], dict[str, list[float]] | str]]) -> dict[str, float]:
    """By device and encoders: runs, refused ones, and of stiffness and damping errors and intervals, per cent."""
    figures: dict[str, float] = {}
    for name, encoders in dict.fromkeys((run[0], run[1]) for run, _ in lines):
        own = [found for run, found in lines if (run[0], run[1]) == (name, encoders)]
        made = [found for found in own if not isinstance(found, str)]
        label = f"{name}, {encoders}"
        figures |= {f"{label}: runs": len(own), f"{label}: refused": len(own) - len(made)}
        beyond = [any(abs(e) > 3 * s for n, (e, s, _) in found.items() if n.startswith(("KE", "DE"))) for found in made]
        figures[f"{label}: logs with stiffness or damping beyond three standard errors"] = sum(beyond)
        for what, kind in (
            ("stiffness", "KE"),
            ("damping", "DE"),
            ("rotor inertia", "IROTOR"),
            ("friction", "F"),
            ("all parameters", ""),
        ):
            errors = np.array([values for found in made for n, values in found.items() if n.startswith(kind)])
            if len(errors):
                inside = np.abs(errors[:, 0]) <= np.abs(errors[:, 2])
                figures[f"{label}: {what}, inside their intervals, %"] = 100 * float(inside.mean())
            if len(errors) and kind:
                figures[f"{label}: {what}, error, rms, %"] = 100 * float(np.sqrt((errors[:, 0] ** 2).mean()))
    return figures


def main() -> None:
    """Measure, print, store; runs are kept in the file of the first argument, from which a study goes on."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kept", type=Path)
    parser.add_argument("--motors-alone", action="store_true")
    parser.add_argument("--minutes", type=float, default=np.inf)
    parser.add_argument("--device", choices=PLANTS)
    parser.add_argument("--encoders", choices=ENCODERS)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    kept, end = options.kept, time.monotonic() + 60 * options.minutes
    encoders = [name + ALONE * options.motors_alone for name in ENCODERS if options.encoders in (None, name)]
    devices = [options.device] if options.device else list(PLANTS)
    lines = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {tuple(line[0]) for line in lines}
    runs = [(n, e, k) for k in range(options.first, options.first + RUNS) for n in devices for e in encoders]
    left = iter([run for run in runs if run not in done])
    with kept.open("a") as out, ProcessPoolExecutor(processes := int(os.environ.get("PROCESSES", "1"))) as pool:
        while time.monotonic() < end and (some := list(islice(left, processes))):
            for run, found in zip(some, pool.map(reading, some), strict=True):
                lines.append((run, found))
                out.write(json.dumps([run, found]) + "\n")
                out.flush()
    figures = (json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {}) | summary(lines)
    for name, value in figures.items():
        print(f"{name}: {value:.3g}")
    RESULT.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
