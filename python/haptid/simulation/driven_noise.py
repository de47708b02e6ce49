"""What noise of the motors' positions does to a simulation of joints that springs alone move.

Near the resonance of a link on its spring the predicted torque amplifies such noise, and a fit would choose parameters
that amplify less: too much damping, another stiffness. At a pose, for small noise, the torque is a linear filter H of
the positions' noise, and E(J'e) = -integral of S Re(dH* H) is what it adds to the score, E(J'J) = integral of
S Re(dH* dH) to the information. Where the feedback is known (`loop`), that noise and the torque's own move the motors
around it. Source: Nakamura (1990), Biometrika 77(1), of corrected scores.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.log.lattice import rounding_density
from haptid.log.spectrum import spectra
from haptid.motion.motion import Motion
from haptid.simulation.driven import unloaded_joints
from haptid.simulation.loop import Loop, loop_of
from haptid.simulation.small_motion import SmallMotion

# Frequencies up to the filter's cut-off over which the noise is integrated.
_FREQUENCIES = 600
# Frequencies that are computed at once.
_TOGETHER = 8
# Times its cut-off from which on the parallel filter passes less than a thousandth.
_BEYOND = 4.0


@dataclass(frozen=True, eq=False)
class MotionNoise:
    """Noise of one motion.

    Attributes:
        f, density: frequencies, (bins,), Hz, and density of the encoders' noise, (channels, bins), rad^2/Hz or m^2/Hz.
        loop: the feedback through which noise moves the motors; None where it is not known.
    """

    f: Array
    density: Array
    loop: Loop | None = None

    @staticmethod
    def of(model: DynamicModel, motion: Motion) -> MotionNoise:
        """Of an encoder whose step is known, that of rounding; white of others.

        Args:
            model: the dynamic model.
            motion: of a log.
        """
        return MotionNoise(*encoder_density(motion), loop_of(model, motion))


def encoder_density(motion: Motion, finer: float = 1.0) -> tuple[Array, Array]:
    """Frequencies, (bins,), Hz, and density of the encoders' noise, (channels, bins), rad^2/Hz or m^2/Hz.

    Args:
        motion: of a log.
        finer: by which the encoders' steps are divided.
    """
    assert motion.log is not None
    dt, own = float(motion.log.dt), spectra(motion.log)
    steps = np.array([spectrum.step or spectrum.recorded for spectrum in own])
    f, density = rounding_density(np.asarray(motion.q[:]), steps / finer, dt)
    white = [0.0 if step else 2 * dt * spectrum.white(dt) for step, spectrum in zip(steps, own, strict=True)]
    return f, density + np.array(white)[:, None] / finer**2


@dataclass(frozen=True, eq=False)
class NoiseMoments:
    """What noise adds to moments of one row of each motor, behind the filters of the rows.

    Attributes:
        information: to that on the parameters, (motors, p, p).
        score, late: to the scores of parameters and of the rate of the row's torque, with opposite sign, (motors, p)
            and (motors,).
        error: to the square of the row's error, (motors,).
    """

    information: Array
    score: Array
    late: Array
    error: Array


def noise_moments(
    model: DynamicModel,
    base: Array,
    beta: Array,
    motion: Motion,
    noise: MotionNoise,
    squares: Array,
    whitening: Array | None = None,
) -> NoiseMoments:
    """What noise of the encoders and of the torque adds to moments of rows.

    Args:
        model: the dynamic model; dry friction that jumps has no slope, as in rows away from reversals. Smoothed, as it
            is simulated, it would have one of thousands of times viscous friction at a pose that happens to be at a
            reversal, and what that does to noise would count for all rows.
        base: maps base parameters to the core's columns, (r, p).
        beta: base parameters, (p,).
        motion: of all joints; its filters are those that the noise passes.
        noise: of the motion.
        squares: mean square of each motor's error in rows, (motors,), SI; what the encoders do not explain of it is
            noise of the torque, and where the feedback is known, its part that was not read with the torque moves.
        whitening: taps of the filter that each motor's rows have passed besides, (motors, taps); None without.
    """
    device, dt = model.device, motion.dt
    taps = motion.treatment.taps(dt)
    highest = min(_BEYOND * (motion.treatment.parallel(dt) or np.inf), 0.5 / dt)
    f = (np.arange(_FREQUENCIES) + 0.5) * highest / _FREQUENCIES
    passed = np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(len(taps))) * dt) @ taps) ** 2
    power = highest / _FREQUENCIES * passed
    rows = [device.row_names.index(motor.name) for motor in device.drives if motor.motorised]
    gain = np.ones((len(f), len(rows))) if whitening is None else np.abs(gains(whitening, f, dt)).T
    density = np.array([np.interp(f, noise.f, own) for own in noise.density])
    linear, p = SmallMotion.along(model, base, beta, motion, unloaded_joints(model), rows), len(beta)
    noisy = linear.moved.any(axis=0) & density.any(axis=1)
    moved, density = linear.moved[:, noisy], np.sqrt(density[noisy])
    motors, loop, poses = np.arange(len(rows)), noise.loop, linear.impedance.shape[1]
    # By the encoders, and by torque of unit density.
    N, b, late, error = np.zeros((len(rows), p, p)), np.zeros((len(rows), p)), np.zeros(len(rows)), np.zeros(len(rows))
    by_torque, late_by_torque = np.zeros_like(b), np.zeros_like(late)
    for part in np.array_split(np.arange(len(f)), -(-len(f) // _TOGETHER)):
        at = linear.at(2j * np.pi * f[part])
        s, Z = at.s, at.Z
        read = np.broadcast_to(moved * density[:, part].T[:, None, None], (*Z.shape[:2], *moved.shape))
        # Where motors and feedback are known, noise of the encoders moves the motors too, and so does that of torque.
        G = np.linalg.inv(Z + loop.at(s.ravel())[:, None]) if loop else np.zeros((*Z.shape[:2], Z.shape[-1], 0))
        spread = np.concatenate([G @ (Z @ read) if loop else read, G], axis=-1)
        dH = at.by_parameters(spread)
        weight, channels = np.sqrt(power[part] / poses)[:, None] * gain[part], read.shape[-1]
        weight = weight[:, None, :, None]
        seen = _real((weight[..., None] * dH[..., :channels]).transpose(2, 3, 0, 1, 4).reshape(len(rows), p, -1))
        missed, rate = (weight * x for x in (Z @ read, s * (Z @ spread[..., :channels])))
        N += seen @ seen.transpose(0, 2, 1)
        b += (seen @ _real(missed.transpose(2, 0, 1, 3).reshape(len(rows), -1))[..., None])[..., 0]
        late += np.sum((rate * missed.conj()).real, axis=(0, 1, 3))
        error += np.sum(np.abs(missed) ** 2, axis=(0, 1, 3))
        if loop:
            moving, rate = dH[:, :, motors, :, channels + motors].real, np.diagonal(s * (Z @ G), axis1=2, axis2=3).real
            by_torque += np.einsum("f,fr,rfap->rp", power[part] / poses, gain[part] ** 2, moving)
            late_by_torque += np.einsum("f,fr,far->r", power[part] / poses, gain[part] ** 2, rate)
    if loop:
        torque = np.maximum((squares - error) / (power @ gain**2) - loop.rest, 0.0)
        b, late = b + torque[:, None] * by_torque, late + torque * late_by_torque
    return NoiseMoments(N, b, late, error)


def gains(taps: Array, f: Array, dt: float) -> Array:
    """Frequency response of filters with symmetric taps, (filters, taps), at frequencies, (k,), Hz: (filters, k)."""
    side = taps.shape[1] // 2
    return np.asarray(taps @ np.cos(2 * np.pi * np.outer(np.arange(-side, side + 1) * dt, f)))


def _real(x: np.ndarray) -> Array:
    """Real and imaginary parts, one behind the other in the last dimension."""
    return np.concatenate([x.real, x.imag], axis=-1)
