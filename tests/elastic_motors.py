"""An axis and an arm with elastic motors, their true parameters, and a log of both sides in closed form."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

import haptid
from haptid.device.toml.reader import checked_tables, device_of

TERMS = [
    {"kind": "elastic", "motors": "all"},
    {"kind": "rotor-inertia", "motors": "all"},
    {"kind": "viscous", "joints": "all"},
    {"kind": "viscous", "motors": "all"},
]
# Link, spring, rotor, friction of both sides; the link on its spring has its resonance at 12.3 Hz.
J, K, D, IA, FV, FVM = 0.1, 600.0, 1.5, 0.05, 0.05, 0.1
TRUTH = {"ZZ1": J, "KE1": K, "DE1": D, "IAM1": IA, "FV1": FV, "FVM1": FVM}
DT, STEP = 1e-3, 2 * np.pi / 4000 / 50


def axis(**changes: object) -> haptid.DynamicModel:
    """One axis about the vertical, its motor behind a spring."""
    data = {"schema": 1, "name": "axis", "gravity": [0.0, 0.0, -9.81], "joints": [{"name": "1"}], "terms": TERMS}
    return haptid.DynamicModel(device_of(*checked_tables({**data, **changes}, "axis.toml")))


def arm() -> haptid.DynamicModel:
    """Two links in a vertical plane; the second motor drives both joints."""
    joints = [{"name": "1"}, {"name": "2", "d": 0.3}]
    motors = [{"name": "a", "drives": {"1": 1.0}}, {"name": "b", "drives": {"1": 0.5, "2": 1.0}, "gear_ratio": 20.0}]
    return axis(gravity=[0.0, -9.81, 0.0], joints=joints, motors=motors)


@cache
def recorded(seed: int = 1, seconds: float = 20.0, offset: float | None = None) -> haptid.Log:
    """Both sides of the axis along a multisine of the link, in closed form, with encoders and torque noise.

    With an offset, a torque sensor behind the spring as well, whose noise is a third of the motor's.
    """
    rng, t = np.random.default_rng(seed), DT * np.arange(round(seconds / DT))
    f = np.geomspace(0.4, 11.0, 16) * rng.uniform(0.97, 1.03, 16)
    s = 2j * np.pi * f
    Q = (1.5 / np.abs(s)) * np.exp(1j * rng.uniform(0, 2 * np.pi, 16))
    motor = Q * (J * s**2 + (FV + D) * s + K) / (D * s + K)
    spring = (K + D * s) * (motor - Q)
    torque = motor * (IA * s**2 + FVM * s) + spring
    wave = np.exp(s[:, None] * t)
    q, theta, tau, carried = ((x[:, None] * wave).real.sum(axis=0) for x in (Q, motor, torque, spring))
    tau = tau + 0.01 * tau.std() * rng.standard_normal(len(t))
    seen, names, torques = STEP * np.round(np.column_stack([q, theta]) / STEP), ("u",), tau[:, None]
    if offset is not None:
        sensed = carried + offset + 0.003 * carried.std() * rng.standard_normal(len(t))
        names, torques = ("u", "sensor"), np.column_stack([tau, sensed])
    channels = haptid.Channels(haptid.Signal(("q", "theta"), "rad"), haptid.Signal(names, "N m", side="motor"), "t")
    return haptid.Log(Path("made"), "", t, seen, torques, channels)


def quasi_static(noise: float, stiffness: float = 6000.0, seconds: float = 6.0) -> haptid.Log:
    """Both sides of the axis far below the resonance of its stiff spring, with white noise of the positions, rad."""
    rng, t = np.random.default_rng(5), DT * np.arange(round(seconds / DT))
    s = 2j * np.pi * np.array([0.5, 1.1, 1.9, 2.8, 3.7])
    Q = (1.5 / np.abs(s)) * np.exp(1j * rng.uniform(0, 2 * np.pi, 5))
    motor = Q * (J * s**2 + (FV + D) * s + stiffness) / (D * s + stiffness)
    torque = motor * (IA * s**2 + FVM * s) + (stiffness + D * s) * (motor - Q)
    q, theta, tau = ((x[:, None] * np.exp(s[:, None] * t)).real.sum(axis=0) for x in (Q, motor, torque))
    seen = np.column_stack([q, theta]) + noise * rng.standard_normal((len(t), 2))
    return haptid.Log(Path("made"), "", t, seen, tau[:, None], recorded().channels)


def treated(log: haptid.Log, cutoff_hz: float = 80.0, parallel_cutoff_hz: float = 25.0) -> haptid.Motion:
    settings = haptid.Treatment(cutoff_hz=cutoff_hz, decimation=10, parallel_cutoff_hz=parallel_cutoff_hz)
    return haptid.treat(log, settings)


def assert_within(found: haptid.Estimate, times: float = 3.5) -> None:
    for name, value, se in zip(found.names, found.beta, found.se, strict=True):
        assert abs(value - TRUTH[name]) < times * se, (name, value, se)
