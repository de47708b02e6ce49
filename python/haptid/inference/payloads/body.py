"""A payload as a rigid body: what is known of it, its ten inertial parameters, its figures, the nearest rigid body."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, positive, read_only
from haptid._internal.late import dataclass
from haptid.device.parts import Joint
from haptid.device.priors import TENSOR
from haptid.errors import ConvergenceError, PhysicalConsistencyError, SettingError
from haptid.estimation.feasibility.cone import PSEUDO, UPPER, pseudo_inertia
from haptid.estimation.feasibility.conic_program import ConeCondition, minimise
from haptid.inference.payloads.fit import RANK_TOLERANCE, JointFit

# Figures of a body, in the order of `PayloadEstimate.body`.
FIGURES = ("mass", "com x", "com y", "com z", "XX", "YY", "ZZ", "XY", "XZ", "YZ")
FIGURE_UNITS = ("kg", "m", "m", "m", *("kg m^2",) * 6)
_TENSOR_OF_FIGURES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# Weight of the penalty on directions without torque in the search for a consistent body, and the rounding of its cone.
_CONSISTENT_PENALTY, _PSD_ROUNDING = 1e-9, 1e-9
# Distance of the consistent from the free estimate, in standard errors, up to which they are the same.
_SAME = 1e-2
# Least mass and length that scale that search, kg and m.
_LEAST_MASS, _LEAST_LENGTH = 1e-3, 0.02


@dataclass(frozen=True, eq=False)
class AttachedBody:
    """A payload: a body fixed to a link, and what is known of it.

    Attributes:
        name: of the payload.
        link: name of the joint whose link carries it.
        mass: kg; None if unknown.
        com: centre of mass in the link frame of the device file's convention, (3,), m; None if unknown.
        inertia: tensor about the centre of mass, in that frame, (3, 3), kg m^2; known only together with mass and com.
    """

    name: str
    link: str
    mass: float | None = None
    com: Array | None = None
    inertia: Array | None = None

    def __post_init__(self) -> None:
        if self.mass is not None and not positive(float(self.mass)):
            raise SettingError(f"payload {self.name}: mass is {self.mass!r} kg; a number above zero is required.")
        for name, shape in (("com", (3,)), ("inertia", (3, 3))):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, read_only(value))
                expect(name, getattr(self, name).shape, shape)
        if self.inertia is not None and (self.mass is None or self.com is None):
            raise SettingError(
                f"payload {self.name}: its inertia is given, its mass or centre of mass is not.",
                where=self.name,
                advice="Give all three, or leave the inertia out: it is then estimated.",
            )

    def unknowns(self, joint: Joint) -> tuple[Array, Array]:
        """The ten inertial parameters at the link of the normal form as offset + basis u, (10,) and (10, unknowns)."""
        offset, basis = np.zeros(10), np.eye(10)
        if self.com is None:
            return (offset, basis) if self.mass is None else (self.mass * basis[9], basis[:, :9])
        R = joint.frame_rotation
        c = R @ self.com + joint.frame_translation
        if self.mass is None:  # inertia is free about any point, so only the moments are tied to the mass
            return offset, np.column_stack([basis[:, :6], np.concatenate([np.zeros(6), c, [1.0]])])
        offset[6:9], offset[9] = self.mass * c, self.mass
        if self.inertia is None:
            return offset, basis[:, :6]
        J = R @ self.inertia @ R.T + self.mass * (c @ c * np.eye(3) - np.outer(c, c))
        offset[:6] = [J[i, k] for i, k in TENSOR]
        return offset, basis[:, :0]


@dataclass(frozen=True, eq=False)
class ConsistentPayload:
    """The physically consistent payload that changes the torque least: mass and pseudo-inertia not negative.

    Attributes:
        changed: whether it differs from the free estimate, which is then not that of a rigid body.
        body: the figures of `FIGURES`, NaN where torque does not determine them, (10,), SI.
        pseudo_inertia: at the link frame of the normal form, (4, 4); arbitrary where torque does not determine it.
        worse: increase of the residual norm over the free estimate, per cent.
    """

    changed: bool
    body: Array
    pseudo_inertia: Array
    worse: float


def body_figures(joint: Joint, phi: ArrayLike) -> Array:
    """Mass, centre of mass and inertia about it in the file's link frame, in the order of `FIGURES`, (10,).

    Args:
        joint: whose link carries the body.
        phi: XX XY XZ YY YZ ZZ MX MY MZ M at the link frame of the normal form, (10,), SI.
    """
    phi = np.asarray(phi, dtype=float)
    mass, J = phi[9], np.zeros((3, 3))
    for value, (i, k) in zip(phi[:6], TENSOR, strict=True):
        J[i, k] = J[k, i] = value
    com = phi[6:9] / mass
    central = J - mass * (com @ com * np.eye(3) - np.outer(com, com))
    R = joint.frame_rotation
    turned = R.T @ central @ R
    return np.array([mass, *(R.T @ (com - joint.frame_translation)), *(turned[i, k] for i, k in _TENSOR_OF_FIGURES)])


def nearest_body(
    joint: Joint, phi: Array, offset: Array, basis: Array, fit: JointFit, columns: np.ndarray, determined: np.ndarray
) -> ConsistentPayload:
    """The rigid body nearest to the free estimate in the metric of the torque.

    Minimises |R (u - u_free)|, R the R factor of the payload's unknowns with all others fitted again, over positive
    semidefinite pseudo-inertias (Wensing, Kim and Slotine 2018).
    """
    figures = np.where(determined, body_figures(joint, phi), np.nan) if phi[9] else np.full(10, np.nan)
    least = float(np.linalg.eigvalsh(pseudo_inertia(phi))[0])
    if not basis.size or least >= -_PSD_ROUNDING * abs(phi[9]):
        return ConsistentPayload(False, figures, pseudo_inertia(phi), 0.0)
    others = np.setdiff1d(np.arange(len(fit.scale)), columns)
    seen, s, _ = np.linalg.svd(fit.solution.R[:, others] / fit.scale[others], full_matrices=False)
    seen = seen[:, s > RANK_TOLERANCE * s[0]]
    R = fit.solution.R[:, columns]
    R = R - seen @ (seen.T @ R)
    mass = max(abs(phi[9]), _LEAST_MASS)
    length = max(float(np.abs(phi[6:9]).max()) / mass, _LEAST_LENGTH)
    size = np.array([mass * length**2] * 6 + [mass * length] * 3 + [mass])
    scaled = np.linalg.norm(basis / size[:, None], axis=0)
    D = 1.0 / np.where(scaled > 0, scaled, 1.0)
    free, metric = fit.x[columns] / D, R * D
    P = metric.T @ metric
    top = max(float(np.abs(P).max()), 1e-300)
    P = P / top + _CONSISTENT_PENALTY * np.eye(len(D))
    root = np.array([length, length, length, 1.0]) * np.sqrt(mass)
    entries = np.array([root[i] * root[k] for i, k in UPPER])[:, None]
    F, f = PSEUDO @ (basis * D) / entries, (PSEUDO @ offset) / entries[:, 0]
    try:
        v, _ = minimise(P, -P @ free, [ConeCondition(F, f, True)])
    except ConvergenceError as error:
        raise PhysicalConsistencyError(
            "no rigid body has what is known of this payload.", advice="Check its mass and its centre of mass."
        ) from error
    parameters = offset + basis @ (D * v)
    extra = float(np.linalg.norm(metric @ (v - free)))
    if extra < _SAME:  # a rigid body has what is determined; the rest of the free estimate was arbitrary
        return ConsistentPayload(False, figures, pseudo_inertia(parameters), 0.0)
    worse = 100 * (np.hypot(fit.solution.rest, extra) / fit.solution.rest - 1) if fit.solution.rest else float("inf")
    body = (
        np.where(determined, body_figures(joint, parameters), np.nan)
        if parameters[9] > _PSD_ROUNDING * mass
        else np.full(10, np.nan)
    )
    if parameters[9] <= _PSD_ROUNDING * mass:
        body[0] = max(parameters[9], 0.0)
    return ConsistentPayload(True, body, pseudo_inertia(parameters), float(worse))
