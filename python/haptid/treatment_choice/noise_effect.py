"""Bias of the parameters by encoder noise and by the position filter, found by simulation-extrapolation (SIMEX).

Noise in the columns attenuates parameters, a narrow filter inflates them. The balanced cut-off cancels both to first
order; what is left is measured: noise like the encoders' is added once more, and positions are filtered once more.
Of devices with springs both are subtracted: the balance is of accelerations, and torsions are much smaller than these.

Source: Cook and Stefanski (1994), Journal of the American Statistical Association 89, for simulation-extrapolation
(SIMEX), of which this is the first difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.errors import IdentifiabilityError, MotionTooShortError, NoRowsError
from haptid.estimation import Estimate
from haptid.estimation.bias import carried, less, may_be_less
from haptid.estimation.method import Fitting
from haptid.log import Log
from haptid.log.spectrum import Spectrum
from haptid.motion.motion import treat, with_positions
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, observe
from haptid.treatment_choice.delay_estimate import Delays
from haptid.treatment_choice.first_fit import least_squares
from haptid.treatment_choice.refit import Refit

# The share of its own size within which each effect is known: that of noise better where it is bounded by rounding.
_NOISE_KNOWN, _NOISE_BOUNDED, _FILTER_KNOWN = 1.0, 0.5, 0.5
# Share of the torque, per cent, by which the encoders' noise may change the predicted one.
NOISY = 3.0


def noise_effect(
    found: Estimate,
    logs: Sequence[Log],
    spectra: Sequence[Sequence[Spectrum]],
    treatment: Treatment,
    delays: Delays | None = None,
) -> Mapping[str, Array]:
    """Standard error of the parameters by the encoders' noise, and by the position filter, each (1, p), SI.

    Of devices with springs the delays are estimated again with the parameters: noise moves them, and with them damping.

    Args:
        found: by `WLS` from rows of the logs.
        logs: recordings.
        spectra: of each log's position channels.
        treatment: of the logs.
        delays: of the torque channels; None where they were given.
    """
    if treatment.cutoff_hz is None:
        return {}
    rows, p = found.observation, len(found.beta)
    untimed = replace(treatment, torque_delay_s=0.0)
    measured = [np.asarray(log.position[:]) for log in logs]
    try:
        # A rigid fit may have taken up noise that repeats with the motion, so that its residual bounds nothing.
        elastic = bool(rows.model.device.elastic)
        noise = possible_noise(rows, found.beta, logs, spectra) if elastic else encoder_noise(logs, spectra)
        filtered = [np.asarray(treat(log, untimed).q[:]) for log in logs]
        refit = Refit.of(found, delays) if elastic and not treatment.momentum else None

        def fitted(positions: Sequence[Array]) -> Array:
            if refit is None:
                return least_squares(_with_positions(rows, positions))
            return refit.least_squares(positions)[:p]

        as_is = least_squares(rows) if refit is None else fitted(measured)
        more, less = (fitted([q + sign * n for q, n in zip(measured, noise, strict=True)]) for sign in (1, -1))
        twice = fitted(filtered)
    except (NoRowsError, IdentifiabilityError, MotionTooShortError):
        return {}
    known = _known(rows.model)
    return {
        "encoder noise": known["encoder noise"] * (0.5 * (more + less) - as_is)[None],
        "position filter": known["position filter"] * (twice - as_is)[None],
    }


def _known(model: DynamicModel) -> Mapping[str, float]:
    """The share of its own size within which each effect is known."""
    noise = _NOISE_BOUNDED if model.device.elastic else _NOISE_KNOWN
    return {"encoder noise": noise, "position filter": _FILTER_KNOWN}


def without_bias(estimate: Estimate, effects: Mapping[str, Array]) -> tuple[Estimate, Mapping[str, Array]]:
    """An estimate of a device with springs less its bias by noise and filter, and what this leaves uncertain.

    Of other devices both are as they are. Of intervals by `Profile` nothing is subtracted, and all of the bias is
    uncertain. A method that is not least squares, such as `ErrorsInVariables`, corrects for the noise in its own way:
    of its estimate only the filter's bias is subtracted.

    Args:
        estimate: of any method.
        effects: standard errors by noise and filter, of least squares, as `noise_effect` has them.
    """
    p, known = len(estimate.beta), _known(estimate.model)
    effects = {name: carried(estimate, shift) for name, shift in effects.items() if shift.shape[1] == p}
    if not estimate.model.device.elastic:
        return estimate, effects
    whole = {name: shift / known[name] for name, shift in effects.items()}
    if not may_be_less(estimate):
        return estimate, whole
    if isinstance(estimate.method, Fitting):
        whole.pop("encoder noise", None)
    return less(estimate, sum((shift[0] for shift in whole.values()), np.zeros(p))), effects


def possible_noise(
    rows: Observation, beta: Array, logs: Sequence[Log], spectra: Sequence[Sequence[Spectrum]]
) -> list[Array]:
    """`encoder_noise`, of each channel no more than rounding and the residual of the torque can hold.

    Noise in the columns is an error of the torque. A spectrum of positions alone takes it to be in the motion's band
    as it is just above, where motion may go on: of rotors that noise of the torque moves, for one. So each channel's
    noise is reduced to what by itself explains no more than the residual of every motor.

    Args:
        rows: of the logs.
        beta: their least squares, (p,), SI.
        logs: recordings.
        spectra: of each log's position channels.
    """
    noise = encoder_noise(logs, [[one.of_rounding() for one in own] for own in spectra])
    left = _squares_left(rows, beta)

    def explained(noise: Sequence[Array]) -> Array:
        return np.asarray(0.5 * sum(_squares_left(one, beta) for one in _moved(rows, logs, noise)) - left)

    if np.all(explained(noise) <= left):
        return noise
    for k in range(noise[0].shape[1]):
        made = explained([np.where(np.arange(n.shape[1]) == k, n, 0.0) for n in noise])
        share = np.min(left[made > left] / made[made > left], initial=1.0)
        for n in noise:
            n[:, k] *= np.sqrt(share)
    return noise


def _moved(rows: Observation, logs: Sequence[Log], noise: Sequence[Array]) -> tuple[Observation, Observation]:
    """Rows with noise added to the positions, and with it subtracted."""
    measured = [np.asarray(log.position[:]) for log in logs]
    more, less = ([q + sign * n for q, n in zip(measured, noise, strict=True)] for sign in (1, -1))
    return _with_positions(rows, more), _with_positions(rows, less)


def _with_positions(rows: Observation, positions: Sequence[Array]) -> Observation:
    """Rows of the same motions with other positions of their logs, each (samples, channels)."""
    return observe(rows.model, *(with_positions(motion, q) for motion, q in zip(rows.motions, positions, strict=True)))


def _squares_left(rows: Observation, beta: Array) -> Array:
    """Sum of the squares of each motor's residual, (motors,)."""
    return np.array([np.sum((m.whole[:, -1] - m.whole[:, :-1] @ beta[m.columns]) ** 2) for m in rows.motors])


def encoder_noise(logs: Sequence[Log], spectra: Sequence[Sequence[Spectrum]]) -> list[Array]:
    """Noise with the spectrum of that in the positions of each log, (samples, channels), rad or m."""
    rng = np.random.default_rng(0)
    return [
        np.stack([s.noise_like(len(log.t), float(log.dt), rng) for s in own], axis=1)
        for log, own in zip(logs, spectra, strict=True)
    ]


def of_torque(observation: Observation, shift: Array) -> float:
    """Torque of a change of the parameters, (p,), in per cent of the measured torque."""
    own = [np.linalg.norm(m.whole[:, :-1] @ shift[m.columns]) for m in observation.motors]
    measured = float(np.linalg.norm([m.norm for m in observation.motors]))
    return 100 * float(np.linalg.norm(own)) / measured if measured else 0.0
