"""Devices whose loops are not linear, their motions and bodies."""

from __future__ import annotations

import numpy as np

import haptid

NAMES = ("four_bar", "slider_crank", "five_bar", "delta")


def poses(model: haptid.Device, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions at which the loops close, velocities and accelerations of the active joints, each (active, count)."""
    rng = np.random.default_rng(seed)
    qa = model.device.closure.draw(rng, count)
    qda, qdda = rng.uniform(-1, 1, (2, *qa.shape)) * np.array([3.0, 30.0])[:, None, None]
    return qa, qda, qdda


def path(model: haptid.Device, seconds: float, dt: float, size: float = 0.3, seed: int = 1) -> tuple[np.ndarray, ...]:
    """Position, velocity and acceleration of the active joints from two sines each about the start, (active, n)."""
    t = dt * np.arange(round(seconds / dt))
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * rng.uniform(0.4, 2.5, (len(model.device.active), 2, 1))
    phase = rng.uniform(0, 2 * np.pi, omega.shape)
    q = model.device.closure.at[:, None] + (size / 2 * np.sin(omega * t + phase)).sum(axis=1)
    qd = (size / 2 * omega * np.cos(omega * t + phase)).sum(axis=1)
    qdd = -(size / 2 * omega**2 * np.sin(omega * t + phase)).sum(axis=1)
    return q, qd, qdd


def bodies(model: haptid.Device) -> np.ndarray:
    """Free standard parameters, (p,): bars of some 10 cm and 50 g, rotors, friction."""
    rng, raw = np.random.default_rng(4), []
    for joint in model.device.joints:
        half = np.diag(rng.uniform(1e-5, 3e-5, 3)) + 1e-6
        m, com = rng.uniform(0.03, 0.06), np.array([0.04, 0.005, 0.003]) * rng.uniform(0.5, 1.5, 3)
        J = np.trace(half) * np.eye(3) - half + m * (com @ com * np.eye(3) - np.outer(com, com))
        raw += list(joint.body * np.array([*J[np.triu_indices(3)], *(m * com), m]))
    sizes = {"rotor": 2e-5, "viscous": 1e-3, "coulomb": 5e-3}
    raw += [sizes.get(term.kind, 0.0) for term in model.terms]
    return np.linalg.lstsq(model.device.parameters.S, np.array(raw), rcond=None)[0]


# Four joints in a plane, of which two follow by polynomials.
CAM = """
name = "cam"
gravity = [0.0, -9.81, 0.0]
[[joints]]
name = "1"
limits = { position = [-1.0, 1.2] }
[[joints]]
name = "2"
d = 0.25
[[joints]]
name = "3"
d = 0.2
limits = { position = [-1.0, 1.0] }
[[joints]]
name = "4"
d = 0.15
[[terms]]
kind = "viscous"
joints = "all"
[handle]
link = "4"
xyz = [0.0, 0.3, 0.0]
"""
RELATIONS = '[[loops]]\nrelations = ["q2 = 0.1 + 0.8*q1 - 0.3*q1**2 + 0.05*q1**3", "{}"]\n'
