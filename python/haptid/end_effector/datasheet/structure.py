"""Lowest natural frequency of a device with elastic motors, without damping, from its identified parameters.

Of links on their springs with motors that are held, as under a stiff position controller, and with motors that are
free. Source: Siciliano et al. (2009), Robotics, section 7.3 (elastic joints), for the equations; of K v = w^2 M v the
derivative of w^2 is v' (dK - w^2 dM) v with v' M v = 1 (Fox and Kapoor 1968, AIAA Journal 6(12), (8)).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import mass_matrix, raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.model import IdentifiedModel, changing
from haptid.uncertainty.quantities import Field


def structural_frequency(known: IdentifiedModel, qa: Array, held: bool) -> Field:
    """Lowest natural frequency at every pose, (poses,), Hz; NaN where the mass matrix is not positive definite.

    Gravity's own stiffness and play are left out.

    Args:
        known: parameters of a device with elastic motors.
        qa: positions of the active joints, (active, poses).
        held: whether the motors are held, or free.
    """
    model = known.model
    moving = np.asarray(model.device.row_map)[:, _moving(model, held)]
    rigid = 0 if held else moving.shape[1] - len(model.device.elastic)

    def projected(beta: Array) -> tuple[Array, Array]:
        M = moving.T @ mass_matrix(model, beta, qa) @ moving
        return M, moving.T @ np.diag(_stiffness(model, beta)) @ moving

    M, K = projected(known.beta)
    squares, shapes = np.full(len(M), np.nan), np.zeros(M.shape[:2])
    definite = np.linalg.eigvalsh(M)[:, 0] > 0
    root = np.linalg.inv(np.linalg.cholesky(M[definite]))
    values, vectors = np.linalg.eigh(root @ K @ root.transpose(0, 2, 1))
    squares[definite] = values[:, rigid]
    shapes[definite] = np.einsum("pji,pj->pi", root, vectors[:, :, rigid])
    w = np.sqrt(np.where(squares > 0, squares, np.nan))
    return changing(known, w / (2 * np.pi), _slope(projected, squares, shapes, w), "Hz")


def _slope(
    projected: Callable[[Array], tuple[Array, Array]], squares: Array, shapes: Array, w: Array
) -> Callable[[Array], Array]:
    """Derivative of the frequency in a direction of the base parameters, in which both matrices are linear."""

    def slope(direction: Array) -> Array:
        dM, dK = projected(direction)
        change = np.einsum("pi,ij,pj->p", shapes, dK, shapes) - squares * np.einsum("pi,pij,pj->p", shapes, dM, shapes)
        return np.asarray(change / (4 * np.pi * w))

    return slope


def _moving(model: DynamicModel, held: bool) -> list[int]:
    """Active joints that move: all, or those that springs alone move."""
    if not held:
        return list(range(len(model.device.active)))
    return [model.device.active.index(drive.first) for drive in model.device.drives if drive.unloaded]


def _stiffness(model: DynamicModel, beta: Array) -> Array:
    """Stiffness of every torque row's coordinate, (rows,): of torsions, and zero of the others."""
    first, raw = 10 * len(model.device.joints), raw_parameters(model, beta)
    made = np.zeros(len(model.device.active))
    for k, term in enumerate(model.terms):
        if term.on.startswith("elastic ") and term.nature == "spring":
            made += raw[first + k] * np.abs(term.weights)
    return made
