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
    K, D, M = (np.array(part).transpose(1, 0, 2, 3) for part in zip(*parts, strict=True))  # (poses, p, rows, joints)
    n, p = len(B), len(beta)
    N, b = np.zeros((n, p, p)), np.zeros((n, p))
    for w, weight, rms in zip(2 * np.pi * f, power, density.T, strict=True):
        by_beta = K + 1j * w * D - w**2 * M
        A = np.tensordot(by_beta, beta, (1, 0))
        own = B[:, unknown].T
        back = np.linalg.inv(own @ A[:, :, unknown]) @ own  # motion of the unknown joints by torque of the rows
        spread = moved * rms
        v = np.zeros((len(samples), n, spread.shape[1]), dtype=complex)
        v[:, known] = spread
        v[:, unknown] = -back @ (A[:, :, known] @ spread)
        direct = by_beta.reshape(len(samples), p * n, n) @ v
        # (poses, rows, p, channels), what the unknown joints do about it added.
        direct = direct.reshape(len(samples), p, n, -1).transpose(0, 2, 1, 3).reshape(len(samples), n, -1)
        dH = direct - A[:, :, unknown] @ (back @ direct)
        seen = _real(dH.reshape(len(samples), n, p, -1).transpose(1, 2, 0, 3).reshape(n, p, -1))
        own_noise = _real((A @ v).transpose(1, 0, 2).reshape(n, 1, -1))
        N += weight / len(samples) * seen @ seen.transpose(0, 2, 1)
        b += weight / len(samples) * (seen @ own_noise.transpose(0, 2, 1))[:, :, 0]
    return N, b


def _real(x: np.ndarray) -> Array:
    """Real and imaginary parts, one behind the other in the last dimension."""
    return np.concatenate([x.real, x.imag], axis=-1)


def _impedances(forward: ForwardDynamics, c: Array, cd: Array, cdd: Array, B: Array) -> tuple[Array, Array, Array]:
    """Derivatives of the rows' torque by positions, velocities and accelerations of the joints, (poses, n, n)."""
    by_c, by_cd = forward.gradients(c, cd, cdd)
    return by_c @ B, by_cd @ B, forward.mass(c) @ B
