"""What noise of the motors' encoders leaves uncertain in an estimate from the motor side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid.estimation.estimate import Estimate
from haptid.estimation.method import Fit
from haptid.estimation.methods.motor_side import MotorSide
from haptid.estimation.methods.simulation_based import Linearised, linearised_observation
from haptid.log.lattice import lattices
from haptid.log.spectrum import spectra
from haptid.motion.motion import Motion, with_delay, with_positions
from haptid.observation.observation import stacked
from haptid.simulation import smooth

# Share of the correction for the encoders' noise within which it is known.
_KNOWN = 0.3
# Share of noise in what distinguishes a parameter below which its rounding is not drawn again.
_MATTERS = 1e-3
# Where the delay is given.
DELAY_KNOWN = (
    "Intervals take the torque's delay as known, since it is given: a tenth of a millisecond may move a viscous "
    "friction by a tenth. Leave torque_delay_s out, and it is estimated with the parameters."
)
# Where rows are whitened.
WHITENED = (
    "Noise of the encoders hides a stiffness where all frequencies count alike: rows are filtered by the inverse of "
    "their noise's spectrum, so that each frequency counts by its own. Intervals of such fits have been studied on few "
    "simulated logs, of one arm; those of positions of both sides on hundreds of four devices."
)


def with_noise_uncertainty(fitted: Estimate) -> Estimate:
    """The estimate with what is not known of the encoders' noise in its covariance.

    The scatter of few blocks shows the variance by rounding within a third or so, and where it happens to be small the
    error does not: that variance is computed too, from positions that are rounded to other lattices, and what the
    scatter does not show of it is added, parameter by parameter.

    Args:
        fitted: by `MotorSide`; its motions hold the simulated joints.
    """
    fit, p = fitted.fit, len(fitted.beta)
    if fit.noise is None:
        return fitted
    N, inverse = _summed(fit), fit.solution.root @ fit.solution.root.T
    correction = np.asarray(_KNOWN * (inverse @ (N[:p, :p] @ fitted.beta - N[:p, p]))[None], dtype=np.float64)
    if shares_of_motor_noise(fitted).max() > _MATTERS:
        shifts = _by_rounding(fitted) @ inverse
        size = np.maximum(np.mean(shifts**2, axis=0), np.finfo(float).tiny)
        shown = np.sqrt(np.maximum(0.0, 1.0 - fitted.se**2 / size) / len(shifts))
        fitted = fitted.with_nuisance("rounding of the encoders", shifts * shown)
    fitted = fitted.with_nuisance("noise of the encoders", correction)
    method = fitted.method
    known = () if isinstance(method, MotorSide) and method.delays else (DELAY_KNOWN,)
    whitened = (WHITENED,) if isinstance(method, MotorSide) and method.whitening is not None else ()
    return replace(fitted, notes=(*fitted.notes, *whitened, *known))


def shares_of_motor_noise(fitted: Estimate) -> Array:
    """Share of the encoders' noise in the part of each column that no other column explains, (p,).

    Args:
        fitted: by `MotorSide`.
    """
    fit, p = fitted.fit, len(fitted.beta)
    W, N = fit.observation.stack(fit.weights)[:, :p], _summed(fit)[:p, :p]
    v = np.linalg.inv(W.T @ W)
    return np.asarray(np.einsum("ij,ik,kj->j", v, N, v) / np.diag(v))


def _summed(fit: Fit) -> Array:
    """Squares of the noise in all weighted rows, (p + 1, p + 1)."""
    assert fit.noise is not None
    return np.asarray(np.sum([blocks.sum(axis=0) for blocks in fit.noise], axis=0))


def _by_rounding(fitted: Estimate) -> Array:
    """Score of the weighted rows by the rounding of positions to each of some lattices, (lattices, p)."""
    method, observation = fitted.method, fitted.observation
    assert isinstance(method, MotorSide)
    rows = replace(observation, motors=fitted.fit.observation.motors)
    smoothed = smooth(fitted.model, observation.motions, method.friction)
    parts, p = list[Linearised](), len(fitted.beta)
    for motion in observation.motions:
        unrounded, *rounded = _rounded(motion)
        along = method.joints(smoothed, unrounded)
        plain = along.met(fitted.beta)
        along.measured = plain.torque
        slopes = np.concatenate([plain.slope, -along.responses(fitted.beta, rounded)], axis=1)
        part = Linearised(motion, np.zeros((len(slopes), len(motion))), slopes, along.names)
        parts.append(method.whitened(part))
    columns = parts[0].slope.shape[1]
    changed = linearised_observation(rows, np.zeros(columns), parts, [motor.unit for motor in rows.motors])
    W = stacked(changed.motors, fitted.fit.weights, columns)
    return np.asarray(W[:, p:columns].T @ W[:, :p])


def _rounded(motion: Motion) -> list[Motion]:
    """The motion with its filtered positions, and with these rounded to each of some lattices; as it is without a log.

    Positions of a motion are evaluated later by the torque's delay, and treated again they would be so twice: 0.5 ms
    of a motion are many steps of a fine encoder.
    """
    every = lattices(motion.q.shape[1])
    if motion.log is None:
        return [motion for _ in range(1 + len(every))]
    q = np.asarray(with_delay(motion, 0.0).q[:])
    steps = np.array([own.step or own.recorded for own in spectra(motion.log)])
    return [with_positions(motion, seen) for seen in (q, *(lattice.rounded(q, steps) for lattice in every))]
