"""What is known of a device's parameters beforehand: CAD bodies and named values as standard parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, expect, read_only
from haptid.device.device import Device, Joint, Prior
from haptid.device.parameters import INERTIAL

# Rows and columns of XX XY XZ YY YZ ZZ in a tensor.
TENSOR = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in the link frame of the file's convention.

    Attributes:
        mass: kg.
        com: centre of mass, (3,), m.
        inertia: tensor about the centre of mass, (3, 3), kg m^2; None if unknown.
    """

    mass: float
    com: Array
    inertia: Array | None

    def __post_init__(self) -> None:
        expect("com", self.com.shape, (3,))
        object.__setattr__(self, "com", read_only(self.com))
        if self.inertia is not None:
            expect("inertia", self.inertia.shape, (3, 3))
            object.__setattr__(self, "inertia", read_only(self.inertia))


def tensor(entries: Array) -> Array:
    """The symmetric tensor, (3, 3), of entries in the order XX YY ZZ XY XZ YZ, (6,)."""
    xx, yy, zz, xy, xz, yz = entries
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertial_parameters(body: Body, joint: Joint) -> Array:
    """The ten parameters of a body, (10,), in the joint's link frame of the normal form; NaN where unknown.

    The tensor is moved from the centre of mass to the frame's origin (Huygens-Steiner).
    """
    R, p = joint.frame_rotation, joint.frame_translation
    com = R @ body.com + p
    chi = np.full(10, np.nan)
    if body.inertia is not None:
        J = R @ body.inertia @ R.T + body.mass * (com @ com * np.eye(3) - np.outer(com, com))
        chi[:6] = [J[i, k] for i, k in TENSOR]
    chi[6:9] = body.mass * com
    chi[9] = body.mass
    return chi


def body_prior(body: Body, joint: Joint, sd_percent: float | None) -> dict[str, Prior]:
    """Priors of a link's ten parameters, without those that are unknown.

    With `sd_percent`, the deviation of the mass is that share of the mass; of a first moment, that share of
    the greatest first moment, or of mass times radius of gyration; of a tensor entry, that share of the
    largest entry.
    """
    chi = inertial_parameters(body, joint)
    scale = np.empty(10)
    scale[:6] = np.max(np.abs(chi[:6]))
    gyration = 0.0 if body.inertia is None else np.sqrt(body.mass * np.trace(body.inertia) / 2)
    scale[6:9] = max(float(np.max(np.abs(chi[6:9]))), float(gyration))
    scale[9] = body.mass
    deviations = scale * (0.0 if sd_percent is None else sd_percent / 100)
    return {
        kind + joint.name: Prior(float(value), float(std) if std > 0 else None)
        for kind, value, std in zip(INERTIAL, chi, deviations, strict=True)
        if np.isfinite(value)
    }


def combined_prior(device: Device, rows: Array) -> tuple[tuple[float, float | None] | None, ...]:
    """Value and deviation of combinations of the free standard parameters, (k, p); None where one is not known."""
    parameters = device.parameters
    std = [_deviation(device, members) for members in parameters.members]
    made: list[tuple[float, float | None] | None] = []
    for row in rows:
        used = np.flatnonzero(row)
        if np.isnan(device.chi_prior[used]).any():
            made.append(None)
            continue
        known = [std[k] for k in used]
        spread = None if None in known else float(np.hypot.reduce([row[k] * (std[k] or 0.0) for k in used]))
        made.append((float(row[used] @ device.chi_prior[used]), spread))
    return tuple(made)


def _deviation(device: Device, members: tuple[str, ...]) -> float | None:
    """Deviation of the mean of the members that have a prior, taken as wholly correlated."""
    known = [device.prior[name].std for name in members if name in device.prior]
    given = [std for std in known if std is not None]
    return float(np.mean(given)) if given and len(given) == len(known) else None
