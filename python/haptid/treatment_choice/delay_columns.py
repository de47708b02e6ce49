"""Columns of the torque channels' delays: the rate of the model's torque, above the motion of friction's jumps alone.

Positions have noise, and the rate of the torque has its third derivative. In a control loop that noise is what the
disturbances moved, which are in the residual too; a column with both biases the delay. So above the motion only dry
friction that jumps at reversals, load-dependent friction with it, is in the column. Where the Gauss-Newton steps end,
the residual is orthogonal to this column: it is an instrument, and what it leaves out of the true rate matters for the
steps alone.

Source of instruments for robots in closed loops: Janot, Vandanjon and Gautier (2014), IEEE Transactions on Control
Systems Technology 22(1).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy import fft

from haptid._internal.arrays import Array, freeze
from haptid._internal.signals import fast_length
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import channel_shares, position_map
from haptid.motion.motion import Motion
from haptid.observation.augmented import CandidateColumns, ResidualContext
from haptid.treatment_choice.nuisance_problem import NuisanceColumn

# Share of the largest entry of a matrix below which a channel has no part in a row.
_NO_PART = 1e-12
# Poses at which that is seen, where the map from channels to rows varies with the pose.
_POSES = 50
# Steepness of the filter between motion and noise, and samples of a part that is too short for it.
_ORDER, _FEWEST = 8, 15
# Where nothing is left for it: share of the sampling rate, and parallel cut-off over its own.
_HIGHEST, _ALIKE = 0.45, 1.1


def delay_columns(
    model: DynamicModel,
    motion: Motion,
    part: Callable[[DynamicModel, Array], Array] | None = None,
    order: int = 1,
    noise_hz: float = np.inf,
) -> list[NuisanceColumn]:
    """The rate of each channel's torque, by the model, in every row that the channel acts on.

    Args:
        motion: of a log.
        part: parameters of the core's columns of which the torque is taken, from all; all where None.
        order: of the derivative; 2 for the rate of the rate.
        noise_hz: frequency above which the torque without dry friction is noise, and left out, Hz.
    """
    assert motion.log is not None
    some = [motion.q[k : k + 1][0] for k in np.linspace(0, len(motion) - 1, _POSES).astype(int)]
    c = position_map(model.device, motion)(np.array(some).T)
    acts = np.abs(channel_shares(model.device, motion, c)).max(axis=0).T
    split = _ALIKE * noise_hz < min(motion.treatment.parallel(motion.dt) or np.inf, _HIGHEST / motion.dt)

    def column(row: int, channel: int) -> CandidateColumns:
        def rate(context: ResidualContext) -> Array:
            chi, plan = context.chi if part is None else part(model, context.chi), context.plan
            own = context.channel_torque(chi)[channel]
            if split:
                smooth = context.channel_torque(smooth_part(model, chi))[channel]
                own = own - smooth + _of_motion(plan.motion, smooth, context.low, noise_hz)
            for _ in range(order):
                own = np.gradient(own, plan.motion.dt)
            return np.asarray((context.channel_shares[:, channel, row] * own)[None])

        return CandidateColumns(np.eye(len(acts))[row], 1, rate)

    loaded = acts > _NO_PART * acts.max()
    return [(int(channel), column(int(row), int(channel))) for row, channel in np.argwhere(loaded)]


def smooth_part(model: DynamicModel, chi: Array) -> Array:
    """Parameters of the core's columns without dry friction that jumps, also by load, (r,); with presliding."""
    kept = np.array(chi)
    for k, term in enumerate(model.terms):
        if term.jumps:
            kept[10 * len(model.device.joints) + k] = 0.0
    return kept


def _of_motion(motion: Motion, x: Array, low: int, highest: float) -> Array:
    """A signal below a frequency, by the parts of a motion between its gaps, (n,).

    Sines from end to end, less the line between the ends, are the signal turned about both end points.

    Args:
        x: of the samples from `low` on, (n,).
        highest: frequency, Hz.
    """
    made = np.array(x)
    for start, stop in motion.segments:
        part = made[max(start - low, 0) : max(stop - low, 0)]
        n = len(part)
        if n > _FEWEST:
            more = fast_length(n - 1) + 1 - n
            whole = np.concatenate([part, 2 * part[-1] - part[n - 1 - more : n - 1][::-1]])
            line = np.linspace(whole[0], whole[-1], len(whole))
            turned = np.concatenate([whole - line, (line - whole)[-2:0:-1]])
            gain = _gain(len(whole), highest * motion.dt)
            part[:] = (line + fft.irfft(gain * fft.rfft(turned), len(turned))[: len(line)])[:n]
    return made


@lru_cache(maxsize=4)
def _gain(n: int, highest: float) -> Array:
    """Gain of the sines between both ends of n samples, (n,); `highest` as a share of the sampling rate."""
    frequency = np.arange(n) / (2 * (n - 1))
    return freeze(np.asarray(1 / (1 + (frequency / highest) ** _ORDER)))
