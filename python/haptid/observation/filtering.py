"""Parallel filter and decimation of sampled signals, as the core applies them to torque and columns.

Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III: the same
low-pass filter and decimation for the torque and for every column of the observation matrix.
"""

from __future__ import annotations

import numpy as np

from haptid import _core
from haptid._internal.arrays import Array
from haptid.dynamics.inverse import core_momentum, core_torque
from haptid.dynamics.model import DynamicModel
from haptid.observation.plan import Plan, Signals

# Numbers of columns that are computed together, and least samples of theirs, in lengths of the filter: windows overlap.
_TOGETHER, _LEAST = 2**19, 4


def decimate(signals: Array, taps: Array, decimation: int) -> Array:
    """FIR filter and decimation, (..., samples) to (..., rows): each row is a window's sum, weighted by the taps.

    Args:
        signals: (..., samples).
        taps: weights of a window, oldest sample first.
        decimation: samples from one row to the next.
    """
    if len(taps) == 1:
        return np.asarray(signals[..., ::decimation] * taps[0])
    channels = np.ascontiguousarray(signals, dtype=np.float64).reshape(-1, signals.shape[-1])
    rows = _core.decimate(channels, np.ascontiguousarray(taps), decimation)
    return rows.reshape(*signals.shape[:-1], rows.shape[1])


def treated_torque(plan: Plan, model: DynamicModel, chi: Array, signals: Signals) -> Array:
    """Model torque of some rows, filtered and decimated like the measured torque, (coordinates, rows), N m or N.

    The filter is linear, so filtering the model's torque is the same as filtering every column of W.

    Args:
        plan: which rows.
        model: the plan's, or one that differs in its terms' settings.
        chi: parameters of the core's columns, (r,), SI.
        signals: those of `plan.signals` for the samples under the rows.
    """
    c, cd, cdd, own = signals
    model, shared, d = plan.for_core(model), plan.filter, plan.motion.treatment.decimation
    if cdd is not None:
        return decimate(core_torque(model, chi, c, cd, cdd, own), shared.taps, d)
    assert shared.slope is not None  # in the momentum formulation the filter differentiates
    momentum, rest = core_momentum(model, chi, c, cd, own)
    return decimate(rest, shared.taps, d) + decimate(momentum, shared.slope, d)


def treated_columns(plan: Plan, signals: Signals) -> Array:
    """Columns of W over base parameters, filtered and decimated, (coordinates, rows, p)."""
    c, cd, cdd, own = signals
    model, shared, d = plan.core, plan.filter, plan.motion.treatment.decimation
    mechanism, loops, length = model.mechanism, model.loops(c, cd), len(shared.taps)
    rows = (c.shape[1] - length) // d + 1
    made = np.empty((len(c), rows, plan.selection.shape[1]))
    # Piece by piece: the columns of all samples take more memory than the caches have.
    piece = 1 + max(_TOGETHER // (len(c) * max(1, len(plan.columns))), _LEAST * length) // d
    for start in range(0, rows, piece):
        stop = min(start + piece, rows)
        samples = slice(start * d, (stop - 1) * d + length)
        motion = (np.ascontiguousarray(x[:, samples]) for x in ((c, cd, own) if cdd is None else (c, cd, cdd, own)))
        closed = None if loops is None else np.ascontiguousarray(loops[:, samples])
        if cdd is not None:
            columns = decimate(mechanism.regressor(*motion, list(plan.columns), closed), shared.taps, d)
        else:
            assert shared.slope is not None  # in the momentum formulation the filter differentiates
            momentum, rest = mechanism.momentum_regressor(*motion, list(plan.columns), closed)
            columns = decimate(momentum, shared.slope, d) + decimate(rest, shared.taps, d)
        made[:, start:stop] = np.einsum("ckr,kp->crp", columns, plan.selection, optimize=True)
    return made
