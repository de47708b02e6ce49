"""Fits from the motors alone whose rows weigh each frequency by its noise, where rows that weigh all alike are refused.

Noise of the positions is amplified near the frequency of a link on its spring, by tens, and hides there what rows tell
elsewhere. A short filter with the inverse of the residual's spectrum makes it white: of each motor's errors and columns
alike, so that it weighs, and does not bias. It is the least squares over such filters, and symmetric.

Source: Ljung (1999), System Identification, section 14.4, of prefilters as weights of frequencies.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.errors import ConvergenceError
from haptid.estimation import Estimate, estimate
from haptid.estimation.methods.motor_side import MotorSide
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation
from haptid.treatment_choice.motor_delays import motor_delays
from haptid.treatment_choice.spring_bound import residual_density

# Half of the filter, s: with it 5 to 8 % of the stiffness of an arm with 12 bits is noise, of 25 % before.
_HALF = 0.15
# Frequencies at which the filter is chosen, up to this many times the parallel filter's cut-off, and its free taps in
# the shortest period of these.
_FREQUENCIES, _BEYOND, _TAPS = 400, 4.0, 5.0
# Frequency up to which the residual is to be white, over the cut-off; least weight of what the parallel filter stops.
_WHITE, _STOPPED = 1.3, 3e-3
# Singular values of the least squares below this share of the largest are left out.
_DETERMINED = 1e-4
# Fits, each behind the filter of the one before, until parameters move by less than this many standard errors.
_FITS, _STILL = 4, 0.3


def whitened_fit(
    observe: Callable[[Treatment], Observation], treatment: Treatment, beta: Array, delays: bool
) -> Estimate:
    """The estimate from rows behind filters that make their residual white.

    Args:
        observe: the rows behind a treatment.
        treatment: to begin with.
        beta: base parameters to begin with, (p,).
        delays: whether those of the torque are estimated.

    Raises:
        ConvergenceError: parameters, delays and filters do not settle.
        HaptidError: as `estimate`.
    """
    before: Array | None = None
    for _ in range(_FITS):
        rows = observe(treatment)
        initial = dict(zip(rows.base.names, beta.tolist(), strict=True))
        found = estimate(rows, MotorSide(initial=initial, delays=delays, whitening=whitening(rows, beta, delays)))
        moved = np.inf if before is None else float(np.max(np.abs(found.beta - before) / found.se))
        before = beta = found.beta
        still = True
        if delays:
            late = motor_delays(found)
            still, beta, treatment = late.still, late.beta, replace(treatment, torque_delay_s=late.setting)
        if still and moved < _STILL:
            return found
    raise ConvergenceError(
        f"parameters and the weights of frequencies do not settle within {_FITS} fits.",
        where="whitening",
        found=moved,
        limit=_STILL,
        advice="Measure with finer encoders, or positions of both sides.",
    )


def whitening(rows: Observation, beta: Array, delays: bool) -> Array:
    """Symmetric taps of a filter for each motor behind which its residual is white, (motors, taps).

    Args:
        rows: of the logs.
        beta: base parameters of the residual, (p,).
        delays: whether the torque's delay is to be found.
    """
    first = rows.motions[0]
    dt, cutoff = float(first.dt), float(first.treatment.parallel(float(first.dt)) or 0.5 / first.dt)
    f = np.linspace(0.0, _BEYOND * cutoff, _FREQUENCIES + 1)[1:]
    density = np.mean([residual_density(rows.model, beta, motion, delays, f) for motion in rows.motions], axis=0)
    taps = first.treatment.taps(dt)
    passed = np.abs(np.exp(-2j * np.pi * np.outer(f, np.arange(len(taps))) * dt) @ taps)
    weight = np.maximum(passed, _STOPPED)
    side, every = round(_HALF / dt), max(1, round(1 / (_TAPS * _BEYOND * cutoff) / dt))
    places = np.arange(0, side + 1, every)
    cosines = np.cos(2 * np.pi * np.outer(f, places) * dt) * np.where(places, 2.0, 1.0)
    made = np.zeros((len(density), 2 * side + 1))
    for own, S in zip(made, density, strict=True):
        columns = cosines * (weight * np.sqrt(S))[:, None]
        ridge = _DETERMINED * np.linalg.norm(columns, 2) * np.eye(len(places))
        wanted = np.concatenate([weight * (f < _WHITE * cutoff), np.zeros(len(places))])
        x = np.linalg.lstsq(np.concatenate([columns, ridge]), wanted, rcond=None)[0]
        own[side + places], own[side - places] = x, x
    return made
