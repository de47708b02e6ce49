"""The inverse dynamic model from base parameters, and its parts: mass matrix, velocity torques, gravity, momentum."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect
from haptid.device import Device
from haptid.motion.channels import external


def inverse_dynamics(device: Device, beta: ArrayLike, qa: Array, qda: Array, qdda: Array) -> Array:
    """Torque of every row (motor or joint, as the device says), at the joint side, (rows, samples), N m or N.

    Args:
        device: the mechanism.
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.
        qda: their velocities.
        qdda: their accelerations.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c, cd, cdd) = raw_parameters(device, beta), _coordinates(device, qa, qda, qdda)
    return core_torque(device, chi, c, cd, cdd, external(device, c, cd, cdd))


def mass_matrix(device: Device, beta: ArrayLike, qa: ArrayLike) -> Array:
    """M in tau = M cdd + h, rotors included, (samples, active, active), kg m^2 (or kg, kg m).

    Rows and columns are the coordinates that torque rows belong to: see `Device.frame`. Rows whose torque is not
    measured are only known as far as measured rows tell.

    Args:
        device: the mechanism.
        beta: its base parameters, (p,), SI.
        qa: positions of the active joints, (active, samples), rad or m.

    Raises:
        ShapeError: an array does not fit the device.
    """
    (c,) = _coordinates(device, qa)
    return core_mass(device, raw_parameters(device, beta), c)


def bias_torque(device: Device, beta: ArrayLike, qa: Array, qda: Array) -> Array:
    """h = C cd + g: torque of the bodies without acceleration, (rows, samples), N m or N; no friction, no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c, cd) = rigid(device, raw_parameters(device, beta)), _coordinates(device, qa, qda)
    return core_torque(device, chi, c, cd, np.zeros_like(c))


def gravity_torque(device: Device, beta: ArrayLike, qa: ArrayLike) -> Array:
    """g: torque that holds the bodies still, (rows, samples), N m or N; no springs.

    Raises:
        ShapeError: an array does not fit the device.
    """
    chi, (c,) = rigid(device, raw_parameters(device, beta)), _coordinates(device, qa)
    return core_torque(device, chi, c, np.zeros_like(c), np.zeros_like(c))


def momentum(device: Device, chi: Array, c: Array, cd: Array) -> tuple[Array, Array]:
    """Generalised momentum p = M cd and the rest in tau = dp/dt + rest, rest = g - C' cd, each (rows, samples).

    The core makes both without accelerations: row k of C' cd is the kinetic energy's derivative along coordinate k.

    Args:
        device: the mechanism.
        chi: parameters of the core's columns, (r,), SI; only those of bodies and rotors count.
        c: positions of the coordinates that torque rows belong to, (active, samples).
        cd: their velocities.
    """
    return core_momentum(device, rigid(device, chi), c, cd)


def raw_parameters(device: Device, beta: ArrayLike) -> Array:
    """Parameters of the core's columns that give these base parameters' torque, (r,), SI: all others are zero."""
    beta = np.asarray(beta, dtype=float)
    expect("beta", beta.shape, (len(device.base),))
    return np.asarray(device.parameters.S[:, list(device.base.kept)] @ beta)


def rigid(device: Device, chi: Array) -> Array:
    """Only the parameters of bodies and rotors, (r,)."""
    links = 10 * len(device.joints)
    kept = [True] * links + [term.kind == "rotor" for term in device.terms]
    return np.where(kept, chi, 0.0)


def core_torque(device: Device, chi: Array, c: Array, cd: Array, cdd: Array, own: Array | None = None) -> Array:
    """Torque of the core's columns, (rows, samples); `own` are the columns that Python computes, none if left out."""
    if own is None:
        own = np.zeros((len(device.externals), c.shape[1]))
    c, cd, cdd, own, chi = (np.ascontiguousarray(x) for x in (c, cd, cdd, own, chi))
    return np.asarray(device.mechanism.torque(c, cd, cdd, own, chi, device.loops(c, cd)))


def core_mass(device: Device, chi: Array, c: Array) -> Array:
    """Mass matrix of the core's columns, (samples, rows, rows), kg m^2 (or kg, kg m).

    Args:
        device: the mechanism.
        chi: parameters of the core's columns, (r,) or several sets (sets, r), SI; only those of bodies and rotors
            count.
        c: positions of the coordinates that torque rows belong to, (active, samples), of the first set, then of the
            second, ...
    """
    c, chi = np.ascontiguousarray(c), np.ascontiguousarray(chi)
    return np.asarray(device.mechanism.mass_matrix(c, chi, device.loops(c, np.zeros_like(c))))


def core_momentum(device: Device, chi: Array, c: Array, cd: Array, own: Array | None = None) -> tuple[Array, Array]:
    """Momentum of the core's columns, and the rest of their torque, each (rows, samples); `own` as in `core_torque`."""
    if own is None:
        own = np.zeros((len(device.externals), c.shape[1]))
    c, cd, chi = np.ascontiguousarray(c), np.ascontiguousarray(cd), np.ascontiguousarray(chi)
    p, rest = device.mechanism.momentum(c, cd, own, chi, device.loops(c, cd))
    return p, rest


def _coordinates(device: Device, qa: ArrayLike, *rates: ArrayLike) -> list[Array]:
    """Of the torque rows, from the active joints': position and rates, each (active, samples)."""
    samples = np.shape(qa)[-1] if np.ndim(qa) else 0
    for name, array in zip(("qa", "qda", "qdda"), (qa, *rates), strict=False):
        expect(name, np.shape(array), (len(device.active), samples))
    return [np.ascontiguousarray(device.frame @ np.asarray(x, dtype=float)) for x in (qa, *rates)]
