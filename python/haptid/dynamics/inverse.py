"""The inverse dynamic model from base parameters, and its parts: mass matrix, velocity torques, gravity, momentum."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external


def inverse_dynamics(model: DynamicModel, beta: ArrayLike, qa: Array, qda: Array, qdda: Array) -> Array:
    """Torque of every row (motor or joint, as the device says), at the joint side, (rows, samples), N m or N.

    Args:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.
        qda: their velocities.
        qdda: their accelerations.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c, cd, cdd) = raw_parameters(model, beta), _coordinates(model, qa, qda, qdda)
    return core_torque(model, chi, c, cd, cdd, external(model, c, cd, cdd))


def mass_matrix(model: DynamicModel, beta: ArrayLike, qa: ArrayLike) -> Array:
    """M in tau = M cdd + h, rotors included, (samples, active, active), kg m^2 (or kg, kg m).

    Rows and columns are the coordinates that torque rows belong to: see `Device.frame`. Rows whose torque is not
    measured are only known as far as measured rows tell.

    Args:
        model: the dynamic model.
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.

    Raises:
        ShapeError: an array does not fit the device.
    """
    (c,) = _coordinates(model, qa)
    return core_mass(model, raw_parameters(model, beta), c)


def bias_torque(model: DynamicModel, beta: ArrayLike, qa: Array, qda: Array) -> Array:
    """h = C cd + g: torque of the bodies without acceleration, (rows, samples), N m or N; no friction, no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c, cd) = rigid(model, raw_parameters(model, beta)), _coordinates(model, qa, qda)
    return core_torque(model, chi, c, cd, np.zeros_like(c))


def gravity_torque(model: DynamicModel, beta: ArrayLike, qa: ArrayLike) -> Array:
    """g: torque that holds the bodies still, (rows, samples), N m or N; no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c,) = rigid(model, raw_parameters(model, beta)), _coordinates(model, qa)
    return core_torque(model, chi, c, np.zeros_like(c), np.zeros_like(c))


def momentum(model: DynamicModel, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
    """Generalised momentum p = M cd and the rest in tau = dp/dt + rest, rest = g - C' cd, each (rows, samples).

    The core makes both without accelerations: row k of C' cd is the kinetic energy's derivative along coordinate k.

    Args:
        model: the dynamic model.
        chi: parameters of the core's columns, (r,), SI; only those of bodies and rotors count.
        c: positions of the coordinates that torque rows belong to, (active, samples).
        cd: their velocities.
    """
    return core_momentum(model, rigid(model, chi), c, cd)


def raw_parameters(model: DynamicModel, beta: ArrayLike) -> Array:
    """Parameters of the core's columns that give these base parameters' torque, (r,), SI: all others are zero."""
    beta = np.asarray(beta, dtype=float)
    expect("beta", beta.shape, (len(model.base),))
    return np.asarray(model.device.parameters.S[:, list(model.base.independent_columns)] @ beta)


def rigid(model: DynamicModel, chi: Array) -> Array:
    """Only the parameters of bodies and rotors, (r,)."""
    links = 10 * len(model.device.joints)
    kept = [True] * links + [term.kind == "rotor" for term in model.terms]
    return np.where(kept, chi, 0.0)


def core_torque(model: DynamicModel, chi: Array, c: Array, cd: Array, cdd: Array, own: Array | None = None) -> Array:
    """Torque of the core's columns, (rows, samples); `own` are the columns that Python computes, none if left out."""
    if own is None:
        own = np.zeros((len(model.externals), c.shape[1]))
    c, cd, cdd, own, chi = (np.ascontiguousarray(x) for x in (c, cd, cdd, own, chi))
    return np.asarray(model.mechanism.torque(c, cd, cdd, own, chi, model.loops(c, cd)))


def core_mass(model: DynamicModel, chi: Array, c: Array) -> Array:
    """Mass matrix of the core's columns, (samples, rows, rows), kg m^2 (or kg, kg m).

    Args:
        model: the dynamic model.
        chi: parameters of the core's columns, (r,) or several sets (sets, r), SI; only those of bodies and rotors
            count.
        c: positions of the coordinates that torque rows belong to, (active, samples), of the first set, then of the
            second, ...
    """
    c, chi = np.ascontiguousarray(c), np.ascontiguousarray(chi)
    return np.asarray(model.mechanism.mass_matrix(c, chi, model.loops(c, np.zeros_like(c))))


def core_momentum(
    model: DynamicModel, chi: Array, c: Array, cd: Array, own: Array | None = None
) -> tuple[Array, Array]:
    """Momentum of the core's columns, and the rest of their torque, each (rows, samples); `own` as in `core_torque`."""
    if own is None:
        own = np.zeros((len(model.externals), c.shape[1]))
    c, cd, chi = np.ascontiguousarray(c), np.ascontiguousarray(cd), np.ascontiguousarray(chi)
    p, rest = model.mechanism.momentum(c, cd, own, chi, model.loops(c, cd))
    return p, rest


def _coordinates(model: DynamicModel, qa: ArrayLike, *rates: ArrayLike) -> list[Array]:
    """Of the torque rows, from the active joints': position and rates, each (active, samples)."""
    samples = np.shape(qa)[-1] if np.ndim(qa) else 0
    for name, array in zip(("qa", "qda", "qdda"), (qa, *rates), strict=False):
        expect(name, np.shape(array), (len(model.device.active), samples))
    return [np.ascontiguousarray(model.device.row_map @ np.asarray(x, dtype=float)) for x in (qa, *rates)]
