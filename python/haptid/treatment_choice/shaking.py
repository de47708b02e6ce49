"""Speeds at which a controller shakes light rotors, which no filtered position shows; dry friction is smooth below.

A controller makes torque of the steps of its encoder, mostly by its gain on speed. A light rotor follows at frequencies
at which its encoder shows nothing but steps. Dry friction has the sign of the true speed: averaged over the shaking it
is a smooth function of the mean speed, as by dither, and a fit finds it too small and viscous friction too large.

What a log tells of it is the torque above the motion that repeats the position's noise: only a loop makes both
coherent.

Source: Zames and Shneydor (1976), Dither in nonlinear systems, IEEE Transactions on Automatic Control 21(5).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.log import Log
from haptid.motion.channels import motor_torque
from haptid.motion.motion import treat
from haptid.motion.treatment import Treatment
from haptid.observation.observation import observe
from haptid.treatment_choice.first_fit import least_squares
from haptid.treatment_choice.spring_bound import parameters_of

# Lowest frequency that is looked at, in bandwidths of the motion, and the highest, as a share of the Nyquist frequency.
_ABOVE, _UP_TO = 4.0, 0.9
# Speed over that of the shaking, rms, from which on dry friction has 99 % of its size, as of a normal distribution.
_CLEAR = 2.5
# Samples of a segment of the spectra, fewest segments, and the coherence from which on a loop makes it.
_SEGMENT, _FEWEST, _COHERENT = 512, 8, 0.3


def shaken_speeds(model: DynamicModel, logs: Sequence[Log], treatment: Treatment, bandwidth: float) -> Array:
    """Speed of each row's motor above which shaking leaves dry friction as it is, (rows of torque,), rad/s or m/s.

    Zero where nothing tells it: of rigid devices, whose rotors shake their links, and of torques of joints.

    Args:
        logs: recordings of both sides of elastic motors.
        treatment: of the logs.
        bandwidth: of the motion, Hz.

    Raises:
        HaptidError: as `observe`.
    """
    device, made = model.device, np.zeros(len(model.device.row_names))
    if not device.elastic or any(log.channels.torque.side != "motor" for log in logs):
        return made
    beta = least_squares(observe(model, *(treat(log, treatment) for log in logs)))
    order = [drive.name for drive in device.motors]
    impulses = np.max([_impulses(model, log, bandwidth) for log in logs], axis=0)
    for drive in device.elastic:
        found = [beta[model.base.names.index(name)] for name in parameters_of(model, drive, "rotor")]
        if len(found) != 1 or not found[0] > 0:
            continue
        for row in range(len(made)):
            if any(term.on == f"motor {drive.name}" for term in model.coulomb_terms(row)):
                made[row] = max(made[row], _CLEAR * impulses[order.index(drive.name)] / found[0])
    return made


def _impulses(model: DynamicModel, log: Log, bandwidth: float) -> Array:
    """RMS of the integral of each motor's torque that repeats a position's noise, (motors,), N m s or N s."""
    dt = float(log.dt)
    torque = motor_torque(model.device, log, np.asarray(log.torque).T)
    starts = [k for a, b in log.segments for k in range(a, b - _SEGMENT + 1, _SEGMENT // 2)]
    if len(starts) < _FEWEST:
        return np.zeros(len(torque))
    window, at = np.hanning(_SEGMENT), np.array(starts)[:, None] + np.arange(_SEGMENT)
    f = np.fft.rfftfreq(_SEGMENT, dt)
    band = (f > _ABOVE * bandwidth) & (f < _UP_TO * 0.5 / dt)

    def spectra(signals: Array) -> Array:
        return np.asarray(np.fft.rfft(signals[:, at] * window, axis=2)[:, :, band])

    q = np.asarray(log.position)
    steps = np.diff(q, 2, axis=0, prepend=q[:1], append=q[-1:])  # of positions motion would leak into the band
    x, u = spectra(steps.T), spectra(torque)
    power = np.mean(np.abs(u) ** 2, axis=1)
    both = np.abs(np.einsum("isf,jsf->ijf", np.conj(u), x) / len(at)) ** 2
    coherence = np.max(both / np.maximum(power[:, None] * np.mean(np.abs(x) ** 2, axis=1), 1e-300), axis=1)
    coherent = np.where(coherence > _COHERENT, coherence, 0.0) * power
    density = 2 * dt / np.sum(window**2) * coherent
    return np.asarray(np.sqrt(np.sum(density / (2 * np.pi * f[band]) ** 2, axis=1) * (f[1] - f[0])))
