"""Integral time of a residual's autocorrelation, from which time blocks (clusters) follow; a first weighted fit."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array
from haptid._internal.signals import fast_length
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.estimation.least_squares import Solution
from haptid.estimation.methods.wls import WLS
from haptid.motion.motion import Motion
from haptid.observation.observation import MotorRows, Observation, stacked
from haptid.observation.r_factor import r_factor
from haptid.observation.rows import chunks

# Correlation below which the rest of the autocorrelation is noise, and the largest lag as a share of the rows.
_ENDS, _FARTHEST = 0.05, 6
# Least ratio of singular values of the columns with unit length that are solved for.
LEAST_EXCITED = 1e-8
# Rows of a motion that are used, at most.
_ENOUGH = 1 << 16


def residual_memory(model: DynamicModel, motions: Sequence[Motion], beta: Array) -> float:
    """Integral time of the residuals' autocorrelation, the longest of all motors, s.

    Two samples' worth of a white residual is its own sampling time; the parallel filter alone makes it about half a
    period of its cut-off.

    Args:
        motions: of the rows.
        beta: base parameters, (p,), SI.
    """
    chi, longest = raw_parameters(model, beta), 0.0
    for motion in motions:
        parts, rows = [], 0
        for chunk in chunks(model, motion):
            parts.append((chunk.measured() - chunk.torque(chi)) * chunk.used)
            rows += parts[-1].shape[1]
            if rows > _ENOUGH:
                break
        e = np.concatenate(parts, axis=1)
        step = motion.treatment.decimation * motion.dt
        longest = max([longest, *(step * _integral(own) for own in e)])
    return longest


# Of each estimate, as long as it lives: its delays and the rounding of its positions ask for the same.
_MEMORY: WeakKeyDictionary[Estimate, float] = WeakKeyDictionary()


def memory_of(estimate: Estimate) -> float:
    """Integral time of the residual of an estimate's free fit, as of `residual_memory`, s."""
    if estimate not in _MEMORY:
        _MEMORY[estimate] = residual_memory(estimate.model, estimate.observation.motions, estimate.free)
    return _MEMORY[estimate]


def _integral(e: Array) -> float:
    """Sum of the autocorrelation over all lags of both signs up to its first fall below ENDS, in rows."""
    used = e != 0
    if used.sum() < 2 * _FARTHEST:
        return 1.0
    centred = np.where(used, e - e[used].mean(), 0.0)
    size = fast_length(2 * len(e))
    r = fft.irfft(np.abs(fft.rfft(centred, size)) ** 2, size)[: len(e) // _FARTHEST + 1]
    if r[0] <= 0:
        return 1.0
    r = r[1:] / r[0]
    below = np.flatnonzero(r < _ENDS)
    return float(1 + 2 * np.sum(r[: below[0] if len(below) else len(r)]))


def least_squares(observation: Observation) -> Array:
    """Base parameters of weighted least squares, of least norm where some are not excited, (p,)."""
    weights, none = np.ones(len(observation.motors)), np.zeros((0, len(observation.base) + 1))
    for _ in range(2):
        beta = solve_excited(observation.motors, weights, none).beta
        weights = np.array(
            [WLS().weight(motor, beta) if motor.norm or motor.free else 1.0 for motor in observation.motors]
        )
    return beta


def solve_excited(motors: Sequence[MotorRows], weights: Array, known: Array) -> Solution:
    """Least squares on R factors and prior rows (k, columns + 1), in the directions that are excited."""
    # By their R factor: singular values of all rows take three times as long.
    factor = r_factor(np.concatenate([known, stacked(motors, weights, known.shape[1] - 1)]))
    R, z = factor[:-1, :-1], factor[:-1, -1]
    lengths = np.linalg.norm(R, axis=0)
    lengths[lengths == 0] = 1.0
    U, singular, Vt = np.linalg.svd(R / lengths)
    kept = singular > LEAST_EXCITED * singular[0]
    root = (Vt[kept].T / singular[kept]) / lengths[:, None]
    beta = root @ (U[:, kept].T @ z)
    rest = float(np.hypot(np.linalg.norm(z - R @ beta), factor[-1, -1]))
    many = int(sum(motor.rows.sum() for motor in motors)) - int(kept.sum())
    pull = known[:, :-1] @ root if len(known) else None
    return Solution(beta, np.diag(singular[kept]), root, rest, max(many, 1), pull)
