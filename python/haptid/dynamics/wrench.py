"""The wrench at the handle from the torque rows, pose by pose: weighted pseudo-inverse of the transposed Jacobian."""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array, expect, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.kinematics import HandleMotion

# A component is determined where its part in the null space of the torques is smaller than this.
NULL_SPACE = 1e-6
# Lower limit of a row's noise, as a share of the noisiest row's.
_LEAST_NOISE = 1e-6


@dataclass(frozen=True, eq=False)
class Lever:
    """Map from measured torque rows to the wrench at the handle, in the base frame.

    Attributes:
        handle: its poses.
        unknown: unknown components: 3 where the moment is given or taken as zero, 6 for the whole wrench.
        inverse: torques to the unknown components, least squares weighted by the rows' noise, (samples, unknown, rows).
        condition: number of the Jacobian's part that is inverted, (samples,).
        usable: whether it is below the limit, (samples,).
        determined: whether torques alone determine a component, forces first, in the handle's own axes, at every
            usable pose, (6,).
        acting: number of measured rows on which the wrench acts.
        sure: directions of force that are determined whatever the moment; 0 where no pose is usable.
        leak: largest force error for a unit of unknown moment, N/(N m); NaN where no pose is usable.
    """

    handle: HandleMotion
    unknown: int
    inverse: Array
    condition: Array
    usable: np.ndarray
    determined: np.ndarray
    acting: int
    sure: int
    leak: float

    def wrench(self, torque: Array) -> Array:
        """The unknown components, (unknown, samples), from torques, (rows, samples)."""
        return np.asarray(np.einsum("num,mn->un", self.inverse, torque))


def acting_rows(handle: HandleMotion, rows: list[int]) -> np.ndarray:
    """Places among these rows of those on which a wrench at the handle acts at some pose; all where it acts on none."""
    found = np.flatnonzero(handle.row_jacobian[:, :, rows].any(axis=(0, 1)))
    return found if len(found) else np.arange(len(rows))


def lever(handle: HandleMotion, rows: list[int], noise: Array, unknown: int, worst: float) -> Lever:
    """Invert the transposed Jacobian at every pose.

    Rows on which the handle does not act, such as torsions of elastic motors, do not count. With fewer rows than
    unknown components the inverse gives the part of the force along the handle's own motion, and zero for the rest.

    Args:
        handle: poses.
        rows: torque rows that are measured.
        noise: of each of them, (rows,), N m or N.
        unknown: 3 or 6 components.
        worst: condition number beyond which a pose is not usable.
    """
    expect("noise", noise.shape, (len(rows),))
    acting = acting_rows(handle, rows)
    noise, count, rows = noise[acting], len(rows), [rows[k] for k in acting]
    J = handle.row_jacobian[:, :, rows]
    # Moments are scaled by the device's characteristic length, so that condition numbers have one unit.
    linear, angular = (float(np.linalg.norm(half)) for half in np.split(J, 2, axis=1))
    scale = np.repeat([1.0, linear / angular if angular > 1e-12 * linear else 1.0], 3)
    scaled = J * scale[:, None]
    rank = min(len(rows), unknown)
    singular = np.linalg.svd(scaled[:, :unknown], compute_uv=False)[:, :rank]
    condition = singular[:, 0] / np.maximum(singular[:, -1], np.finfo(float).tiny)
    usable = condition <= worst
    weights = 1 / np.maximum(noise, _LEAST_NOISE * noise.max()) if noise.any() else np.ones(len(rows))
    inverse = _inverse(scaled[:, :unknown].mT * weights[:, None], rank) * weights * scale[:unknown, None]
    whole = np.zeros((*inverse.shape[:2], count))
    whole[:, :, acting] = inverse
    leak = np.linalg.norm(inverse[usable, :3] @ J[usable, 3:].mT, axis=(1, 2), ord=2)
    return Lever(
        handle=handle,
        unknown=unknown,
        inverse=freeze(whole),
        condition=freeze(condition),
        usable=usable,
        determined=_determined(handle, scaled, usable),
        acting=len(rows),
        sure=len(rows) - _rank(scaled[usable, 3:]) if usable.any() else 0,
        leak=float(leak.max()) if usable.any() else float("nan"),
    )


def _inverse(A: Array, rank: int) -> Array:
    """Pseudo-inverses of a stack from its `rank` largest singular values, zero where one of them vanishes."""
    U, s, Vt = np.linalg.svd(A, full_matrices=False)
    tiny = np.finfo(float).tiny
    significant = (np.arange(s.shape[1]) < rank) & (s > 1e-14 * np.maximum(s[:, :1], tiny))
    return np.asarray(Vt.mT @ (np.where(significant, 1 / np.where(significant, s, 1.0), 0.0)[:, :, None] * U.mT))


def _determined(handle: HandleMotion, J: Array, usable: np.ndarray) -> np.ndarray:
    """Whether each component, in the handle's axes, lies in the range of the Jacobian at every usable pose, (6,)."""
    halves = np.split(J[usable], 2, axis=1)
    in_handle = np.concatenate([handle.rotation[usable].mT @ half for half in halves], axis=1)
    U, s, _ = np.linalg.svd(in_handle, full_matrices=False)
    U = U * (s > 1e-9 * np.maximum(s[:, :1], np.finfo(float).tiny))[:, None, :]
    in_range = np.square(U).sum(axis=2)
    return np.asarray((1 - in_range < NULL_SPACE**2).all(axis=0) & usable.any())


def _rank(A: Array) -> int:
    """Greatest rank in a stack."""
    s = np.linalg.svd(A, compute_uv=False)
    return int((s > 1e-9 * np.maximum(s[:, :1], np.finfo(float).tiny)).sum(axis=1).max(initial=0))
