"""True parameters of the devices that the tests of the bench simulate."""

from __future__ import annotations

import numpy as np

import haptid
from haptid.device import INERTIAL

# Central bodies of the CEA branch: mass, com, moments, products xy xz yz; of the size of the identified ones.
CEA = {
    "1": (1.0, (0.0065, 0.027, 0.01), (0.004, 0.004, 0.0055), (1e-4, 2e-4, -1e-4)),
    "2": (2.5, (-0.0454, 0.0020, 0.003), (0.0026, 0.0020, 0.00265), (3e-4, -2e-4, 1.5e-4)),
    "3": (0.20, (0.0803, 0.0020, -0.004), (6e-5, 0.0012, 0.0012), (4e-5, 3e-5, -2e-5)),
    "4": (0.06, (0.012, 0.003, 0.002), (2e-5, 2e-5, 3e-5), (2e-6, 1e-6, 1e-6)),
    "5": (1.6, (0.0414, -0.0030, 0.002), (0.0009, 0.0012, 0.0016), (2e-4, -1e-4, 1e-4)),
    "6": (0.06, (0.1125, 0.002, 0.001), (3e-6, 0.000253, 0.000253), (2e-6, 1e-6, 0)),
    "7": (0.06, (0.1125, -0.002, 0.0015), (3e-6, 0.000253, 0.000253), (-2e-6, 1e-6, 0)),
    "8": (0.04, (0.010, 0.022, -0.002), (2e-5, 1.5e-5, 2e-5), (2e-6, 1e-6, 0)),
    "9": (0.06, (0.1375, 0.002, 0.002), (4e-6, 0.000378, 0.000378), (-3e-6, 2e-6, 0)),
}
SIZES = {"FV": 6e-4, "FC": 0.01, "IA": 1e-3, "OFF": 0.01}


def true_parameters(model: haptid.Device, **sizes: float) -> np.ndarray:
    """Free standard parameters, (p,): the prior where it makes bodies, else drawn bodies; `sizes` are of kinds."""
    sizes = {**SIZES, **sizes}
    chi = np.nan_to_num(model.device.chi_prior)
    if not model.device.name.startswith("PHANToM"):
        rng = np.random.default_rng(3)
        known = CEA if model.device.name.startswith("CEA") else {}
        for joint in model.device.joints:
            put(model, chi, joint.name, *(known.get(joint.name) or drawn(rng)))
    for k, kind in enumerate(model.device.parameters.kinds):
        if kind in sizes:
            chi[k] = sizes[kind]
        elif len(kind) > 2 or kind[0] == "K":
            chi[k] = 0.0  # a counterbalance or a spring
    return chi


def drawn(rng: np.random.Generator) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Mass, centre of mass, moments and products of a body that can exist."""
    spread = rng.normal(size=(3, 3))
    half = 0.01 * np.eye(3) + 0.01 * spread @ spread.T
    J = np.trace(half) * np.eye(3) - half
    return rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1, 3), np.diag(J), np.array([J[0, 1], J[0, 2], J[1, 2]])


def put(model, chi, name, mass, com, moments, products):
    """A central body as the ten parameters of a link."""
    (xy, xz, yz), com = products, np.asarray(com, dtype=float)
    J = np.diag(np.asarray(moments, dtype=float)) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    J += mass * (com @ com * np.eye(3) - np.outer(com, com))
    values = [J[0, 0], J[0, 1], J[0, 2], J[1, 1], J[1, 2], J[2, 2], *(mass * com), mass]
    for kind, value in zip(INERTIAL, values, strict=True):
        if kind + name in model.device.parameters.index:
            chi[model.device.parameters.index[kind + name]] = value
