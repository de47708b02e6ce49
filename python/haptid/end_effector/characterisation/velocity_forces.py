"""Velocity-dependent forces at the handle, and weight: the part that a mass-friction-stiffness model neglects."""

from __future__ import annotations

import itertools

import numpy as np

from haptid._internal.arrays import Array, cross_product
from haptid.dynamics.inverse import core_torque, raw_parameters, rigid
from haptid.dynamics.kinematics import handle_of, link_poses
from haptid.dynamics.model import DynamicModel
from haptid.end_effector.characterisation.friction import force_at_handle
from haptid.end_effector.characterisation.jacobian import HandleJacobian

# Directions of the grid search for a largest force, and steps from the best of them: within 0.1 % of a search over
# thousands of directions.
DIRECTIONS, STEPS = 256, 20


def velocity_product_acceleration(model: DynamicModel, qa: Array, qda: Array) -> Array:
    """Jdot qd: linear and angular acceleration of the handle at zero joint acceleration, (samples, 6).

    Forward recursion in the base frame (Siciliano et al. 2009, section 7.5.1, with all joint accelerations zero).

    Args:
        qa: positions of the active joints, (active, samples), rad or m.
        qda: their velocities.
    """
    handle, at = handle_of(model), link_poses(model, qa)
    _, rates, accelerations = model.tree(qa, qda, np.zeros_like(qda))
    chain, link = list[int](), handle.link
    while link >= 0:
        chain.append(link)
        link = model.device.joints[link].parent
    w, wd, a, origin = list[Array](np.zeros((4, qa.shape[1], 3)))
    for i in reversed(chain):
        here, z = at[:, i, :3, 3], at[:, i, :3, 2]
        rate, change = rates[i][:, None], accelerations[i][:, None]
        arm = here - origin
        a = a + cross_product(wd, arm) + cross_product(w, cross_product(w, arm))
        if model.device.joints[i].prismatic:
            a = a + 2 * cross_product(w, z * rate) + z * change
        else:
            wd = wd + cross_product(w, z * rate) + z * change
            w = w + z * rate
        origin = here
    arm = at[:, handle.link, :3, :3] @ handle.translation
    a = a + cross_product(wd, arm) + cross_product(w, cross_product(w, arm))
    return np.concatenate([a, wd], axis=1)


def neglected_force(handle: HandleJacobian, inverse: Array, beta: Array, velocity: Array) -> Array:
    """F_d = J^-T (H - A J^-1 Jdot qd), (poses, m): Janot et al. (2007), eq. (19), with its missing inverse added.

    It includes weight, as H in the paper.

    Args:
        handle: the poses.
        inverse: of the Jacobian, (poses, n, m).
        beta: base parameters, (p,), SI.
        velocity: of the handle, (poses, m).
    """
    model, to_joints = handle.model, np.linalg.inv(handle.model.device.row_map)
    cd = handle.all_rates(np.einsum("pnm,pm->pn", inverse, velocity))
    usable = handle.usable
    cd = np.where(usable, cd, 0.0)
    bias = velocity_product_acceleration(model, handle.qa, to_joints @ cd)[:, list(handle.rows)]
    cdd = -handle.all_rates(np.einsum("pnm,pm->pn", np.where(usable[:, None, None], inverse, 0.0), bias))
    chi = rigid(model, raw_parameters(model, beta))
    return force_at_handle(handle, inverse, core_torque(model, chi, model.device.row_map @ handle.qa, cd, cdd))


def worst_directions(handle: HandleJacobian, inverse: Array, beta: Array, speed: float) -> Array:
    """Directions of motion at a handle speed in which F_d is largest, (poses, m).

    F_d is weight plus a quadratic form of the velocity, so a few velocities determine it. Starting from the best
    direction of a grid, two alternating steps never lower |F_d|: f along F_d; then the direction in which f' F_d is
    largest, an eigenvector.

    Args:
        handle, inverse, beta: as for `neglected_force`.
        speed: of the handle, m/s.
    """
    weight, form = _by_velocity(handle, inverse, beta, speed)
    grid = unit_directions(len(handle.rows))
    sizes = [np.linalg.norm(_force(weight, form, np.broadcast_to(d, weight.shape)), axis=1) for d in grid]
    worst = grid[np.argmax(sizes, axis=0)]
    for _ in range(STEPS):
        force = _force(weight, form, worst)
        worst = np.linalg.eigh(np.einsum("pk,pkij->pij", force, form))[1][:, :, -1]
    return np.asarray(worst)


def _by_velocity(handle: HandleJacobian, inverse: Array, beta: Array, speed: float) -> tuple[Array, Array]:
    """F_d as weight (poses, m) and a quadratic form of the direction at this speed, (poses, m, m, m), N."""
    m = len(handle.rows)
    shape, axes = (len(handle), m), speed * np.eye(m)

    def force(velocity: Array) -> Array:
        return np.nan_to_num(neglected_force(handle, inverse, beta, np.broadcast_to(velocity, shape)))

    weight, form = force(np.zeros(m)), np.zeros((*shape, m, m))
    for i in range(m):
        form[:, :, i, i] = force(axes[i]) - weight
    for i, j in itertools.combinations(range(m), 2):
        both = force(axes[i] + axes[j]) - weight
        form[:, :, i, j] = form[:, :, j, i] = (both - form[:, :, i, i] - form[:, :, j, j]) / 2
    return weight, form


def _force(weight: Array, form: Array, direction: Array) -> Array:
    return np.asarray(weight + np.einsum("pkij,pi,pj->pk", form, direction, direction))


def unit_directions(m: int, count: int = DIRECTIONS) -> Array:
    """Nearly uniform directions over a half sphere, (count, m); F_d is the same for opposite directions."""
    if m == 1:
        return np.ones((1, 1))
    if m == 2:
        angle = np.pi * np.arange(count) / count
        return np.column_stack([np.cos(angle), np.sin(angle)])
    if m == 3:
        place = np.arange(count) + 0.5
        z, turned = place / count, np.pi * (1 + 5**0.5) * place
        across = np.sqrt(1 - z**2)
        return np.column_stack([across * np.cos(turned), across * np.sin(turned), z])
    drawn = np.random.default_rng(0).normal(size=(count, m))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
