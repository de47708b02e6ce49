"""Inverse dynamics from base parameters, and its parts: mass matrix, bias torque, gravity torque, momentum."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external


def inverse_dynamics(model: DynamicModel, beta: ArrayLike, qa: Array, qda: Array, qdda: Array) -> Array:
    """Joint-side torque of every row (motor or joint, as the device defines), (rows, samples), N m or N.

    Args:
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
    """The mass matrix M in tau = M cdd + h, rotors included, (samples, active, active), kg m^2 (or kg, kg m).

    Rows and columns are the torque rows' coordinates: see `Device.frame`. Entries of rows without measured torque are
    identifiable only as far as measured rows contain them.

    Args:
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.

    Raises:
        ShapeError: an array does not fit the device.
    """
    (c,) = _coordinates(model, qa)
    return core_mass(model, raw_parameters(model, beta), c)


def bias_torque(model: DynamicModel, beta: ArrayLike, qa: Array, qda: Array) -> Array:
    """The bias torque h = C cd + g of the bodies, (rows, samples), N m or N; no friction, no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c, cd) = rigid(model, raw_parameters(model, beta)), _coordinates(model, qa, qda)
    return core_torque(model, chi, c, cd, np.zeros_like(c))


def gravity_torque(model: DynamicModel, beta: ArrayLike, qa: ArrayLike) -> Array:
    """The gravity torque g of the bodies, (rows, samples), N m or N; no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c,) = rigid(model, raw_parameters(model, beta)), _coordinates(model, qa)
    return core_torque(model, chi, c, np.zeros_like(c), np.zeros_like(c))


def momentum(model: DynamicModel, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
    """Generalised momentum p = M cd and rest = g - C' cd in tau = dp/dt + rest, each (rows, samples).

    Both without accelerations: row k of C' cd is the derivative of the kinetic energy along coordinate k.

    Args:
        chi: parameters of the core's columns, (r,), SI; only those of bodies and rotors count.
        c: positions of the torque rows' coordinates, (active, samples).
        cd: their velocities.
    """
    return core_momentum(model, rigid(model, chi), c, cd)


def raw_parameters(model: DynamicModel, beta: ArrayLike) -> Array:
    """Parameters of the core's columns with the torque of these base parameters, (r,), SI; those not kept are zero."""
    beta = np.asarray(beta, dtype=float)
    expect("beta", beta.shape, (len(model.base),))
    return np.asarray(model.device.parameters.S[:, list(model.base.independent_columns)] @ beta)


def rigid(model: DynamicModel, chi: Array) -> Array:
    """The parameters of bodies and rotors, all others zero, (r,)."""
    links = 10 * len(model.device.joints)
    is_rigid = [True] * links + [term.kind == "rotor" for term in model.terms]
    return np.where(is_rigid, chi, 0.0)


def core_torque(model: DynamicModel, chi: Array, c: Array, cd: Array, cdd: Array, own: Array | None = None) -> Array:
    """Torque from parameters of the core's columns, (rows, samples).

    `own` are the columns that Python computes, (externals, samples); zero if left out.
    """
    own = _no_external(model, c) if own is None else own
    c, cd, cdd, own, chi = (np.ascontiguousarray(x) for x in (c, cd, cdd, own, chi))
    return np.asarray(model.mechanism.torque(c, cd, cdd, own, chi, model.loops(c, cd)))


def core_mass(model: DynamicModel, chi: Array, c: Array) -> Array:
    """Mass matrix from parameters of the core's columns, (samples, rows, rows), kg m^2 (or kg, kg m).

    Args:
        chi: parameters of the core's columns, (r,) or several sets (sets, r), SI; only those of bodies and rotors
            count.
        c: positions of the torque rows' coordinates, (active, samples), of the first set, then of the second, ...
    """
    c, chi = np.ascontiguousarray(c), np.ascontiguousarray(chi)
    return np.asarray(model.mechanism.mass_matrix(c, chi, model.loops(c, np.zeros_like(c))))


def core_momentum(
    model: DynamicModel, chi: Array, c: Array, cd: Array, own: Array | None = None
) -> tuple[Array, Array]:
    """Momentum from parameters of the core's columns, and the rest of their torque, each (rows, samples)."""
    own = _no_external(model, c) if own is None else own
    c, cd, chi = (np.ascontiguousarray(x) for x in (c, cd, chi))
    p, rest = model.mechanism.momentum(c, cd, own, chi, model.loops(c, cd))
    return p, rest


def _no_external(model: DynamicModel, c: Array) -> Array:
    return np.zeros((len(model.externals), c.shape[1]))


def _coordinates(model: DynamicModel, qa: ArrayLike, *rates: ArrayLike) -> list[Array]:
    """Position and rates of the torque rows' coordinates, each (active, samples), from the active joints'."""
    samples = np.shape(qa)[-1] if np.ndim(qa) else 0
    for name, array in zip(("qa", "qda", "qdda"), (qa, *rates), strict=False):
        expect(name, np.shape(array), (len(model.device.active), samples))
    return [np.ascontiguousarray(model.device.row_map @ np.asarray(x, dtype=float)) for x in (qa, *rates)]
