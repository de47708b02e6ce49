"""What noise of the motors' positions does to a simulation of joints that springs alone move.

Near the resonance of a link on its spring the predicted torque amplifies such noise, and a fit would choose parameters
that amplify less: too much damping, another stiffness. At a pose, for small noise, the torque is a linear filter H of
the positions' noise, and E(J'e) = -integral of S Re(dH* H) is what it adds to the score, E(J'J) = integral of
S Re(dH* dH) to the information. Source: Nakamura (1990), Biometrika 77(1), of corrected scores.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.forward import ForwardDynamics
from haptid.dynamics.model import DynamicModel
from haptid.log.lattice import rounding_density
from haptid.log.spectrum import spectra
from haptid.motion.channels import coordinates, position_map
from haptid.motion.motion import Motion
from haptid.simulation.driven import unloaded_joints

# Poses of the motion, and frequencies up to the filter's cut-off, over which the noise is integrated.
_POSES, _FREQUENCIES = 24, 600
# Frequencies that are computed at once.
_TOGETHER = 8
# Times its cut-off from which on the parallel filter passes less than a thousandth.
_BEYOND = 4.0


def noise_density(motion: Motion) -> tuple[Array, Array]:
    """Frequencies, (bins,), Hz, and density of the encoders' noise, (channels, bins), rad^2/Hz or m^2/Hz.

    Of an encoder whose step is known, that of rounding; white of others.

    Args:
        motion: of a log.
    """
    assert motion.log is not None
    dt, own = float(motion.log.dt), spectra(motion.log)
    steps = np.array([spectrum.step or spectrum.recorded for spectrum in own])
    f, density = rounding_density(np.asarray(motion.q[:]), steps, dt)
    white = np.array([0.0 if step else 2 * dt * spectrum.white(dt) for step, spectrum in zip(steps, own, strict=True)])
    return f, density + white[:, None]


def noise_moments(
    model: DynamicModel, base: Array, beta: Array, motion: Motion, noise: tuple[Array, Array]
) -> tuple[Array, Array]:
    """What noise adds to a row's information, (n, p, p), and to its score with opposite sign, (n, p), by row of torque.

    Nothing for rows without motor.

    Args:
        model: the dynamic model; dry friction that jumps has no slope, as in rows away from reversals. Smoothed, as it
            is simulated, it would have one of thousands of times viscous friction at a pose that happens to be at a
            reversal, and what that does to noise would count for all rows.
        base: maps base parameters to the core's columns, (r, p).
        beta: base parameters, (p,).
        motion: of all joints; its filters are those that the noise passes.
        noise: its frequencies and density, as `noise_density` gives them.
    """
    device, dt = model.device, motion.dt
    taps = motion.treatment.taps(dt)
    highest = min(_BEYOND * (motion.treatment.parallel(dt) or np.inf), 0.5 / dt)
    f = (np.arange(_FREQUENCIES) + 0.5) * highest / _FREQUENCIES
    passed = np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(len(taps))) * dt) @ taps) ** 2
    power = highest / _FREQUENCIES * passed
    density = np.array([np.interp(f, noise[0], own) for own in noise[1]])
    low, high = motion.usable
    samples = np.linspace(low, high - 1, _POSES + 2).astype(int)[1:-1]
    c, cd, cdd = (np.ascontiguousarray(x[:, samples - low]) for x in coordinates(device, motion, low, high))
    B, unknown = np.asarray(device.row_map), unloaded_joints(model)
    known = np.delete(np.arange(len(B)), unknown)
    moved = (np.linalg.inv(B) @ position_map(device, motion)(np.eye(len(density))))[known]
    noisy = moved.any(axis=0) & density.any(axis=1)
    moved, density = moved[:, noisy], np.sqrt(density[noisy])
    parts = [_impedances(ForwardDynamics(model, base[:, k]), c, cd, cdd, B) for k in range(len(beta))]
    by_beta = np.array(parts).transpose(2, 3, 0, 1, 4)  # (poses, rows, p, 3, joints)
    poses, n, p = by_beta.shape[:3]
    impedance = np.einsum("arkdj,k->darj", by_beta, beta)
    every = np.ascontiguousarray(by_beta).reshape(poses, n * p, -1)
    rows = [device.row_names.index(motor.name) for motor in device.drives if motor.motorised]
    N, b = np.zeros((n, p, p)), np.zeros((n, p))
    for part in np.array_split(np.arange(len(f)), -(-len(f) // _TOGETHER)):
        s = (2j * np.pi * f[part])[:, None, None, None]
        A = impedance[0] + s * impedance[1] + s**2 * impedance[2]
        own = B[:, unknown].T
        back = np.linalg.inv(own @ A[..., unknown]) @ own  # motion of the unknown joints by torque of the rows
        spread = moved * density[:, part].T[:, None, None]
        v = np.zeros((len(part), poses, n, spread.shape[-1]), dtype=complex)
        v[..., known, :] = spread
        v[..., unknown, :] = -back @ (A[..., known] @ spread)
        rates = np.concatenate([v, s * v, s**2 * v], axis=2)
        direct = every @ np.concatenate([rates.real, rates.imag], axis=-1)
        direct = direct[..., : v.shape[-1]] + 1j * direct[..., v.shape[-1] :]
        # What the unknown joints do about it is added: (frequencies, poses, rows, p, channels).
        through = np.eye(n)[rows] - A[..., rows, :][..., unknown] @ back
        dH = (through @ direct.reshape(len(part), poses, n, -1)).reshape(len(part), poses, len(rows), p, -1)
        weight = np.sqrt(power[part] / poses)[:, None, None, None, None]
        seen = _real((weight * dH).transpose(2, 3, 0, 1, 4).reshape(len(rows), p, -1))
        own_noise = weight * (A[..., rows, :] @ v)[..., None, :]
        N[rows] += seen @ seen.transpose(0, 2, 1)
        b[rows] += (seen @ _real(own_noise.transpose(2, 0, 1, 3, 4).reshape(len(rows), -1))[..., None])[..., 0]
    return N, b


def _real(x: np.ndarray) -> Array:
    """Real and imaginary parts, one behind the other in the last dimension."""
    return np.concatenate([x.real, x.imag], axis=-1)


def _impedances(forward: ForwardDynamics, c: Array, cd: Array, cdd: Array, B: Array) -> Array:
    """Derivatives of the rows' torque by positions, velocities and accelerations of the joints, (3, poses, n, n)."""
    return np.asarray(forward.slopes(c, cd, cdd).transpose(1, 3, 0, 2) @ B)
