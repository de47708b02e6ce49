"""Motions of a device from formulas: multisines with exact rates, and the torque of known parameters."""

from __future__ import annotations

import numpy as np
from scipy import signal

import haptid


def multisine(joints: int, seconds: float, dt: float, seed: int, size: float = 0.5):
    """Positions, velocities, accelerations, each (joints, n): four sines a joint."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / dt)) * dt
    omega = 2 * np.pi * rng.uniform(0.2, 2.4, (joints, 4))
    angle = omega[..., None] * t + rng.uniform(0, 2 * np.pi, (joints, 4))[..., None]
    amplitude = size / (omega / 6) ** 0.7 / 2
    q = np.einsum("jk,jkn->jn", amplitude, np.sin(angle))
    qd = np.einsum("jk,jkn->jn", amplitude * omega, np.cos(angle))
    qdd = -np.einsum("jk,jkn->jn", amplitude * omega**2, np.sin(angle))
    return q, qd, qdd


def truth(model: haptid.Device, seed: int = 0) -> np.ndarray:
    """Base parameters of about the size of the device's own, none of them zero."""
    rng = np.random.default_rng(seed)
    chi = np.nan_to_num(model.device.chi_prior)
    friction = {"FV": 6e-4, "FC": 0.02}
    for k, kind in enumerate(model.device.parameters.kinds):
        chi[k] = friction.get(kind, chi[k]) * rng.uniform(0.8, 1.2)
    return model.base.of(chi)


def motion(
    model: haptid.Device,
    beta: np.ndarray,
    *,
    seconds: float = 10.0,
    dt: float = 1e-3,
    seed: int = 1,
    noise: float = 0.0,
    phi: float = 0.0,
    treatment: haptid.Treatment | None = None,
) -> haptid.Motion:
    """A motion with exact rates, and torque with autoregressive noise of a share `noise` of its own size."""
    q, qd, qdd = multisine(len(model.device.active), seconds, dt, seed)
    tau = haptid.inverse_dynamics(model, beta, q, qd, qdd)
    white = np.random.default_rng(1000 + seed).standard_normal((tau.shape[1] + 2000, len(tau))) * np.sqrt(1 - phi**2)
    rough = signal.lfilter([1.0], [1.0, -phi], white, axis=0)[2000:]
    tau = tau + noise * tau.std(axis=1, keepdims=True) * rough.T
    return haptid.Motion(dt, q.T, tau.T, treatment or haptid.Treatment(cutoff_hz=None), rates=(qd.T, qdd.T))
