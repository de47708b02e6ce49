"""Parallel filter and decimation of sampled signals, as the core applies them to torque and columns.

Source: Gautier, Janot and Vandanjon (2013), IEEE Trans. Control Systems Technology 21(2), section III: the same
low-pass filter and decimation for the torque and for every column of the observation matrix.
"""

from __future__ import annotations

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import core_momentum, core_torque
from haptid.dynamics.model import DynamicModel
from haptid.observation.plan import Plan, Signals

# Least length of a piece of samples: shorter ones make a matrix product too slim.
_PIECE = 48


def decimate(signals: Array, taps: Array, decimation: int) -> Array:
    """FIR filter and decimation, (..., samples) to (..., rows): each row is a window's sum, weighted by the taps.

    Args:
        signals: (..., samples).
        taps: weights of a window, oldest sample first.
        decimation: samples from one row to the next.
    """
    if len(taps) == 1:
        return np.asarray(signals[..., ::decimation] * taps[0])
    samples = signals.shape[-1]
    rows = (samples - len(taps)) // decimation + 1
    # Samples in pieces of some rows' length: the i-th row of piece p is the sum over j of piece p + j weighted by the
    # j-th part of the taps moved by i rows. All these products are one matrix product.
    group = -(-_PIECE // decimation)
    length, count = group * decimation, -(-rows // group)
    pieces = -(-(len(taps) + length - decimation) // length)
    parts = np.zeros((pieces, group, length))
    for i in range(group):
        moved = np.zeros(pieces * length)
        moved[i * decimation : i * decimation + len(taps)] = taps
        parts[:, i] = moved.reshape(pieces, length)
    needed = (count + pieces - 1) * length
    decimated = np.zeros((int(np.prod(signals.shape[:-1], dtype=int)), count, group))
    for channel, target in zip(signals.reshape(len(decimated), samples), decimated, strict=True):
        if not channel.any():  # half of a serial arm's columns are zero
            continue
        padded = channel[:needed] if needed <= samples else np.append(channel, np.zeros(needed - samples))
        products = padded.reshape(-1, length) @ parts.reshape(-1, length).T
        for j in range(pieces):
            target += products[j : j + count, j * group : (j + 1) * group]
    decimated = decimated.reshape(len(decimated), -1)[:, :rows]
    return decimated.reshape(*signals.shape[:-1], rows)


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
    mechanism, loops = model.mechanism, model.loops(c, cd)
    if cdd is not None:
        columns = decimate(mechanism.regressor(c, cd, cdd, own, list(plan.columns), loops), shared.taps, d)
    else:
        assert shared.slope is not None  # in the momentum formulation the filter differentiates
        momentum, rest = mechanism.momentum_regressor(c, cd, own, list(plan.columns), loops)
        columns = decimate(momentum, shared.slope, d) + decimate(rest, shared.taps, d)
    return np.ascontiguousarray(np.einsum("ckr,kp->crp", columns, plan.selection, optimize=True))
