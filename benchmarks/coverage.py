"""Do 95 % intervals hold the truth 95 times in 100? Residuals white, and correlated as they are in practice.

The PHANToM with friction, 20 s of multisine at 1 kHz, exact motion, many draws of the noise. Printed for each kind of
noise: the share of intervals that hold the true parameter, over all parameters and for the worst and best one, of the
default intervals and of the textbook's.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import signal, stats

import haptid

RUNS = 300
SECONDS = 20.0
NOISE = np.array([6e-3, 3e-3, 3e-3])
CASES = {
    "white": (0.0, haptid.Treatment(cutoff_hz=None)),
    "AR(1) 0.95": (0.95, haptid.Treatment(cutoff_hz=None)),
    "AR(1) 0.99": (0.99, haptid.Treatment(cutoff_hz=None)),
    "white, filtered and decimated by 10": (0.0, haptid.Treatment(cutoff_hz=None, decimation=10)),
    "AR(1) 0.95, filtered and decimated by 10": (0.95, haptid.Treatment(cutoff_hz=None, decimation=10)),
}


def exact_motion(device: haptid.Device, beta: np.ndarray, seconds: float, treatment: haptid.Treatment) -> haptid.Motion:
    """A multisine with exact rates and exact torque."""
    t = np.arange(0.0, seconds, 1e-3)
    rng = np.random.default_rng(0)
    omega = 2 * np.pi * np.array([[0.31, 0.83, 1.49, 2.27], [0.37, 0.97, 1.61, 2.39], [0.29, 0.89, 1.37, 2.11]])
    angle = omega[..., None] * t + rng.uniform(0, 2 * np.pi, omega.shape)[..., None]
    size = np.array([0.6, 0.4, 0.45])[:, None] / (omega / 2 / np.pi) ** 0.7 / 2
    q = np.einsum("jk,jkn->jn", size, np.sin(angle)) + np.array([0.0, 0.2, 0.3])[:, None]
    qd = np.einsum("jk,jkn->jn", size * omega, np.cos(angle))
    qdd = -np.einsum("jk,jkn->jn", size * omega**2, np.sin(angle))
    tau = haptid.inverse_dynamics(device, beta, q, qd, qdd)
    return haptid.Motion(1e-3, q.T, tau.T, treatment, rates=(qd.T, qdd.T))


def noise(samples: int, phi: float, rng: np.random.Generator) -> np.ndarray:
    """Autoregressive noise of unit variance, (samples, 3)."""
    burn = 3000 if phi else 0
    white = rng.standard_normal((samples + burn, 3)) * np.sqrt(1 - phi**2)
    return np.asarray(signal.lfilter([1.0], [1.0, -phi], white, axis=0))[burn:]


def shares(
    phi: float, treatment: haptid.Treatment, runs: int, seconds: float = SECONDS
) -> tuple[np.ndarray, np.ndarray]:
    """Share of runs whose interval holds the truth, by parameter: the default interval's, and the textbook's."""
    device = haptid.read_device("phantom_premium_15")
    rng = np.random.default_rng(1)
    beta = device.base.of(np.nan_to_num(device.chi_prior))
    friction = [k for k, name in enumerate(device.base.names) if name.startswith(("FV", "FC"))]
    beta[friction] = np.where([device.base.names[k].startswith("FC") for k in friction], 0.02, 6e-4)
    clean = exact_motion(device, beta, seconds, treatment)
    honest, textbook = np.zeros(len(beta)), np.zeros(len(beta))
    for _ in range(runs):
        motion = replace(clean, tau=clean.tau + NOISE * noise(len(clean), phi, rng))
        found = haptid.estimate(haptid.observe(device, motion), haptid.WLS())
        low, high = found.interval95.T
        honest += (low <= beta) & (beta <= high)
        wide = stats.norm.ppf(0.975) * np.sqrt(np.diag(found.textbook_covariance))
        textbook += np.abs(found.beta - beta) <= wide
    return honest / runs, textbook / runs


def run() -> dict[str, float]:
    """Shares in per cent."""
    figures = {}
    for name, (phi, treatment) in CASES.items():
        honest, textbook = shares(phi, treatment, RUNS)
        figures[f"{name}: default, mean"] = 100 * honest.mean()
        figures[f"{name}: default, worst"] = 100 * honest.min()
        figures[f"{name}: default, best"] = 100 * honest.max()
        figures[f"{name}: textbook, mean"] = 100 * textbook.mean()
    return figures
