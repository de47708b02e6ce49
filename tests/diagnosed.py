"""Logs with one known fault each, as a small haptic device with encoders would write them, and their estimates."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy import signal

import haptid
from haptid.motion.streaming import delayed
from motions import multisine, truth

# 4000 counts a turn behind a gear of 12.
STEP = 2 * np.pi / 4000 / 12
CENTRE = np.array([0.0, 0.5, 0.8])
CHANNELS = haptid.Channels(
    haptid.Signal(("q1", "q2", "q3"), "rad"), haptid.Signal(("u1", "u2", "u3"), "N m", side="motor"), time="t"
)


@cache
def phantom() -> haptid.Device:
    return haptid.DynamicModel(haptid.read_device("phantom_premium_15"))


def coulomb() -> np.ndarray:
    """Dry friction of the three motors, (3,), N m."""
    names = phantom().base.names
    return truth(phantom())[[names.index(f"FC{k}") for k in (1, 2, 3)]]


def log(
    seed: int,
    *,
    seconds: float = 20.0,
    noise: float = 0.01,
    phi: float = 0.0,
    stribeck: float = 0.0,
    offset: float = 0.0,
    warming: float = 0.0,
    late: float = 0.0,
    gains: tuple[float, ...] = (1.0, 1.0, 1.0),
) -> haptid.Log:
    """A recorded multisine.

    Args:
        seed: of motion and noise.
        seconds: length.
        noise: deviation of the torque's noise, as a share of the torque's own; `phi` makes it autoregressive.
        stribeck: friction added towards standstill, decaying at 0.15 rad/s, as a share of dry friction.
        offset: constant torque, as a share of dry friction.
        warming: share of dry friction that is gone at the end.
        late: samples that the torque acts late.
        gains: factors of the torque channels.
    """
    model = phantom()
    q, qd, qdd = multisine(3, seconds, 1e-3, seed, 0.35)
    q = q + CENTRE[:, None]
    dry = coulomb()[:, None] * np.sign(qd)
    tau = haptid.inverse_dynamics(model, truth(model), q, qd, qdd)
    tau = tau + stribeck * dry * np.exp(-np.abs(qd) / 0.15) + offset * coulomb()[:, None]
    tau = (tau - warming * dry * np.linspace(0.0, 1.0, q.shape[1])).T
    tau = np.asarray(delayed(tau, -late)) if late else tau
    white = np.random.default_rng(seed).standard_normal((len(tau) + 2000, 3)) * np.sqrt(1 - phi**2)
    tau = tau + noise * tau.std(axis=0) * signal.lfilter([1.0], [1.0, -phi], white, axis=0)[2000:]
    drives = [motor.gear_ratio * motor.torque_constant for motor in model.device.motors]
    position = STEP * np.round(q.T / STEP)
    return haptid.Log(Path("made"), str(seed), 1e-3 * np.arange(len(tau)), position, tau / drives * gains, CHANNELS)


def estimated(made: haptid.Log, **asked) -> haptid.Estimate:
    """Treated as proposed, but for what is asked."""
    treatment = haptid.propose(phantom(), made, **{"torque_delay_s": 0.0, **asked}).treatment
    return haptid.estimate(haptid.observe(phantom(), haptid.treat(made, treatment)), haptid.WLS())
