"""Logs of one axis moved by sines over a decade and a half of frequency, rigid or with a spring behind its rotor."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import haptid

DEVICE = """
name = "axis"
gravity = [0.0, 0.0, -9.81]
joints = [{ name = "1" }]
terms = [{ kind = "viscous", joints = "all" }, { kind = "coulomb", joints = "all" }]
"""
CHANNELS = haptid.Channels(haptid.Signal(("q",), "rad"), haptid.Signal(("u",), "N m", side="motor"), time="t")
INERTIA, ROTOR, STEP = 0.1, 0.3, 2 * np.pi / 4000 / 50


@cache
def axis():
    with TemporaryDirectory() as folder:
        path = Path(folder, "axis.toml")
        path.write_text(DEVICE, encoding="utf-8")
        return haptid.DynamicModel(haptid.read_device(path))


def estimated(seed, resonance=None, seconds=40.0, noise=0.01, phi=0.0, dt=2e-3, side="motor"):
    """An axis moved by sines from 0.3 to 8 Hz; with a resonance, a spring is between its rotor and its link.

    Args:
        seed: of motion and noise.
        resonance: of the link on its spring with the motor held, Hz.
        seconds: length of the log.
        noise: of the torque, over its rms; phi: its autoregression.
        dt: sampling period, s.
        side: where positions are measured.
    """
    rng, t = np.random.default_rng(seed), dt * np.arange(round(seconds / dt))
    f = np.geomspace(0.3, 8.0, 14) * rng.uniform(0.95, 1.05, 14)
    phase, w = rng.uniform(0, 2 * np.pi, 14)[:, None], 2 * np.pi * f[:, None]
    a = 6.0 / w**1.5
    link, rate = INERTIA * (1 - ROTOR), lambda n: a * w**n * np.sin(w * t + phase + 0.5 * np.pi * n)
    bend = 0.0 if resonance is None else 1 / (2 * np.pi * resonance) ** 2  # link inertia over stiffness
    q, motor, speed, load, drive = (
        sum(parts)
        for parts in (rate(0), rate(0) + bend * rate(2), rate(1) + bend * rate(3), rate(2), rate(2) + bend * rate(4))
    )
    tau = link * load + ROTOR * INERTIA * drive + 0.2 * speed + 0.5 * np.sign(speed)
    e = rng.standard_normal(len(t) + 500)
    for k in range(1, len(e)) if phi else ():
        e[k] += phi * e[k - 1]
    tau = tau + noise * tau.std() * (e / e.std())[500:]
    seen = STEP * np.round((motor if side == "motor" else q) / STEP)
    log = haptid.Log(Path("made"), str(seed), t, seen[:, None], tau[:, None], CHANNELS)
    treatment = haptid.propose(axis(), log, torque_delay_s=0.0).treatment
    return haptid.estimate(haptid.observe(axis(), haptid.treat(log, treatment)), haptid.WLS())
