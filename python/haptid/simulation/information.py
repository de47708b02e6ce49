"""Information of a log on the parameters, each frequency weighed by its own noise: what no method can exceed.

Positions are measured with the encoders' noise, torque with noise of its own, and the motion itself is not known. The
residual of the rows is then the noise behind the linearised model, with density S(f), and the information is the
integral of J(f)' S(f)^-1 J(f), J the derivatives of the rows' torque. Its inverse is the Cramer-Rao bound, to first
order in the noise.

Source: Pintelon and Schoukens (2012), System Identification: A Frequency Domain Approach, sections 9.8 and 9.11.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.simulation.small_motion import SmallMotion

# Frequencies at which the noise is computed, and of these at once.
_FREQUENCIES, _TOGETHER = 96, 8


def spectrum_of(signals: Array, dt: float, highest: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies above 0 and below `highest`, Hz, and Fourier sums of signals behind Hann's window, (..., bins)."""
    n = signals.shape[-1]
    window = np.hanning(n)
    f = np.fft.rfftfreq(n, dt)
    used = (f > 0) & (f < highest)
    return f[used], np.fft.rfft(signals * np.sqrt(window / window.mean()), axis=-1)[..., used]


def residual_noise(linear: SmallMotion, f: Array, noise: tuple[Array, Array]) -> np.ndarray:
    """Density of the rows' residual by the encoders' noise, (k, rows, rows), (N m)^2/Hz.

    Args:
        linear: the model.
        f: frequencies, (k,), Hz.
        noise: frequencies, (bins,), and density of every position channel, (channels, bins).
    """
    made = []
    for part in np.array_split(f, -(-len(f) // _TOGETHER)):
        at = linear.at(2j * np.pi * part)
        missed = at.Z @ _read(linear, part, noise)[:, None]
        made.append((missed @ missed.conj().swapaxes(-1, -2)).mean(axis=1))
    return np.concatenate(made)


def fisher_information(
    linear: SmallMotion,
    J: Array,
    dt: float,
    noise: tuple[Array, Array],
    torque: Array,
    highest: float,
    inside: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """Of rows up to a frequency on parameters, and on what else has a column, (columns, columns), 1/SI^2.

    Args:
        linear: the model, at its parameters and along the motion.
        J: derivatives of the rows' torque, (rows, columns, samples), of the base parameters first.
        dt: sampling period, s.
        noise: frequencies, (bins,), Hz, and density of the noise of every position channel, (channels, bins).
        torque: density of the noise of the rows' torque, (rows, rows), (N m)^2/Hz.
        highest: frequency, Hz.
        inside: the noise of the positions that J was computed along, as `noise`; None where they are exact.

    Returns:
        The information, and what of that on the p parameters is noise inside J, (p, p), which tells nothing.
    """
    f, found = spectrum_of(J, dt, highest)
    groups = np.array_split(np.arange(len(f)), min(_FREQUENCIES, len(f)))
    middle = np.array([f[group].mean() for group in groups])
    inverses = np.linalg.inv(residual_noise(linear, middle, noise) + torque)
    made, p = np.zeros((J.shape[1], J.shape[1])), linear.by_beta.shape[2]
    false = np.zeros((p, p))
    for group, inverse in zip(groups, inverses, strict=True):
        part = found[:, :, group]
        made += 4 * dt / J.shape[2] * np.einsum("rak,rs,sbk->ab", part.conj(), inverse, part, optimize=True).real
    if inside is not None:
        counts = np.array([len(group) for group in groups])
        for own in np.array_split(np.arange(len(middle)), -(-len(middle) // _TOGETHER)):
            at = linear.at(2j * np.pi * middle[own])
            read = _read(linear, middle[own], inside)[:, None]
            dH = at.by_parameters(np.broadcast_to(read, (*at.Z.shape[:2], *read.shape[2:])))
            # Of noise of density G a bin has n G / (2 dt) in the mean.
            weights = 2 * counts[own, None, None] * inverses[own] / dH.shape[1]
            false += np.einsum("fxrac,frs,fxsbc->ab", dH.conj(), weights, dH, optimize=True).real
    return made, false


def _read(linear: SmallMotion, f: Array, noise: tuple[Array, Array]) -> Array:
    """Noise of unit channels as the measured joints have it, (k, known, channels)."""
    density = np.array([np.interp(f, noise[0], own) for own in noise[1]])
    noisy = linear.moved.any(axis=0) & density.any(axis=1)
    return np.asarray(linear.moved[:, noisy] * np.sqrt(density[noisy]).T[:, None])
