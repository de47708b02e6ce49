"""Faults of channels that a log shows without a model (dead, coarse, clipped, stuck), and simulated noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.grams import Grams
from haptid.advice.rows import BaseRows, Column, excerpts, trial_rows
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import HaptidError
from haptid.inference.diagnosis.torque_faults import clipped
from haptid.log import Log, OnDisk
from haptid.log.lattice import Lattice, lattices
from haptid.log.noise_alone import noise_alone
from haptid.motion.channels import channel_shares, channel_torque, coordinates, motor_torque
from haptid.motion.motion import Motion, treat
from haptid.motion.treatment import Treatment
from haptid.observation.augmented import torque_of

# A channel is dead if more than this share of its samples is one value while its joint moves,
DEAD = 0.3
# and coarse with fewer values than this.
_COARSE = 64
# Samples of a channel that show whether it can be.
_SOME = 4096
# Share of the log in which a clipped torque spoils the fit.
CLIPPED = 0.002
# A position is stuck while it stays where the motion around it would have moved it by this many of its own steps, or
# this share of its range.
STUCK_STEPS, STUCK = 12.0, 0.01
# Steps in a row without a change from which on it may be; share of its range that is rounding of a resampled log.
_STILL, _SAME = 5, 1e-9
# Stretches before and after a stop, as shares of its length, that are compared with the next ones, and steps of the
# encoder that those have at least.
_NEAR, _TOLD = (0.01, 0.03, 0.1), 8.0
# A longer stop, as a share of the log, is held on purpose unless the change of travel from some samples to the next at
# its ends is so many times a quantile of that elsewhere: share, ratio, quantile, samples, fewest samples elsewhere.
_LONG, _ABRUPT, _USUAL, _BESIDE, _FEWEST = 0.02, 8.0, 0.99, 10, 500


@dataclass(frozen=True, eq=False)
class ChannelFault:
    """A fault of a channel, and the samples that it spoils.

    Attributes:
        kind: "dead torque", "noise alone", "coarse torque", "clipped torque", "stuck position".
        channel: index of it.
        samples: spoiled, (n,); all of them for a dead channel.
        share: of the samples.
        size: the value at which it stays, the step of a coarse one, or the deviation of noise, in its own unit as the
            log has it.
    """

    kind: str
    channel: int
    samples: np.ndarray
    share: float
    size: float


def faults(log: Log) -> Iterator[ChannelFault]:
    """Faults of a log's channels."""
    noise = noise_alone(log)
    for k, tau in enumerate(log.torque.T):  # of a log on disk one at a time
        if noise[k]:
            yield ChannelFault("noise alone", k, np.ones(len(tau), dtype=bool), 1.0, float(tau.std()))
        else:
            yield from _torque_faults(tau, k)
    for k, x in enumerate(log.position.T):
        stuck = _stuck(x)
        if stuck.any():
            yield ChannelFault("stuck position", k, stuck, float(stuck.mean()), float(x[np.argmax(stuck)]))


def _torque_faults(tau: Array, k: int) -> Iterator[ChannelFault]:
    low, high = float(tau.min()), float(tau.max())
    if low == high:
        return
    value, share = _most_frequent(tau)
    if share > DEAD and low < value < high:
        yield ChannelFault("dead torque", k, np.ones(len(tau), dtype=bool), share, value)
        return
    at_limit = clipped(tau)
    if at_limit.mean() > CLIPPED:
        yield ChannelFault("clipped torque", k, at_limit, float(at_limit.mean()), max(abs(low), abs(high)))
    if len(np.unique(tau[:_SOME])) <= _COARSE and len(values := np.unique(tau)) <= _COARSE:
        yield ChannelFault("coarse torque", k, np.ones(len(tau), dtype=bool), 1.0, float(np.diff(values).min()))


def _most_frequent(tau: Array) -> tuple[float, float]:
    """The most frequent value of a torque and its share; of those with a share below DEAD any.

    A value with more than that share of the samples is at one of the quantiles so far apart, once they are in order.
    """
    places = np.arange(0, len(tau), max(int(DEAD * len(tau)), 1))
    candidates = np.unique(np.partition(tau, places)[places])
    counts = [np.count_nonzero(tau == value) for value in candidates]
    most = int(np.argmax(counts))
    return float(candidates[most]), counts[most] / len(tau)


def _stuck(x: Array) -> np.ndarray:
    """Samples in which a position does not change although it moves fast right before and after, or jumps then.

    A joint that is held, as between motions from point to point, slows down before and sets off slowly.
    """
    steps, made = np.abs(np.diff(x)), np.zeros(len(x), dtype=bool)
    still = np.concatenate([steps <= _SAME * np.ptp(x), [False]])
    moved = steps[~still[:-1]]
    step = float(moved.min()) if moved.size else 0.0
    least = max(STUCK_STEPS * step, STUCK * float(np.ptp(x)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]]))).reshape(-1, 2)
    long = max(_LONG * len(x), 2 * _BESIDE)
    bends, usual = _bends(x, still) if (np.diff(edges) > long).any() else (x[:0], np.inf)
    for start, stop in edges[np.diff(edges)[:, 0] >= _STILL].tolist():
        n = stop - start
        after, before = x[min(stop + n, len(x) - 1)] - x[min(stop + 1, len(x) - 1)], x[start] - x[max(start - n, 0)]
        jump = abs(x[min(stop + 1, len(x) - 1)] - x[start])
        at_speed = before * after > 0 and min(abs(before), abs(after)) > least
        at_speed = at_speed and not _slows_down(x[start::-1], n, step) and not _slows_down(x[stop:], n, step)
        # The motion on both sides goes on at its speed through the range, or the position jumps at its end.
        jumps = jump > max(least, 3 * abs(after) / n)
        least_bend = max(_ABRUPT * usual, STUCK_STEPS * step)
        if at_speed or jumps or (n > long and _abrupt(x, bends, start, stop, least_bend)):
            made[start : stop + 1] = True
    return made


def _slows_down(x: Array, n: int, step: float) -> bool:
    """Whether a motion sets off slowly, at any scale of time that its steps show.

    Under a constant acceleration the first stretch is a third of the second.
    """
    return any(_sets_off_slowly(x, max(1, round(share * n)), _TOLD * step) for share in _NEAR)


def _sets_off_slowly(x: Array, near: int, least: float) -> bool:
    """Whether the travel over the first samples is less than half of that over as many next ones.

    Args:
        x: the position from standstill on, (n,).
        near: how many samples.
        least: travel over the next ones below which it is noise.
    """
    if len(x) <= 2 * near:
        return False
    first, second = abs(x[near] - x[0]), abs(x[2 * near] - x[near])
    return bool(second > least and first < 0.5 * second)


def _bends(x: Array, still: np.ndarray) -> tuple[Array, float]:
    """How a position's travel over some samples differs from that over the next ones, and what is usual of its motion.

    Args:
        x: the position, (n,).
        still: samples after which it does not change, (n,).
    """
    bends = np.abs(x[2 * _BESIDE :] - 2 * x[_BESIDE:-_BESIDE] + x[: -2 * _BESIDE])
    moving = bends[~still[_BESIDE:-_BESIDE]]
    return bends, float(np.quantile(moving, _USUAL)) if moving.size > _FEWEST else np.inf


def _abrupt(x: Array, bends: Array, start: int, stop: int, least: float) -> bool:
    """Whether a position stops, or sets off, at once: by a change of speed that is none of the motion elsewhere.

    One quick motion in a slow log bends more than all others, and yet slows down before the stop.

    Args:
        x, bends: the position, and its bends.
        start, stop: samples between which it does not change.
        least: that is none of the motion, nor of the encoder's steps.
    """
    reach = 3 * _BESIDE  # a resampled log rings beside a corner
    for at, beside in ((start, x[start::-1]), (stop, x[stop:])):
        part = bends[max(at - _BESIDE - reach, 0) : max(at - _BESIDE + reach + 1, 0)]
        if part.size and float(part.max()) > least and not _sets_off_slowly(beside, _BESIDE, 0.0):
            return True
    return False


def simulated_rows(
    rows: BaseRows,
    motions: Sequence[Motion],
    beta: Array,
    columns: Sequence[Column],
    blocks: int,
    lattice: Lattice | None = None,
) -> Grams | None:
    """Gram matrices of the same rows of logs made by the model, as one block; None where there are no such logs.

    Of logs on disk the samples under the rows are simulated, and no others.
    """
    model, there = rows.model, _in_memory(rows, motions)
    try:
        logs = [log for motion in there if (log := simulated_log(model, motion, beta, lattice)) is not None]
        if len(logs) < len(there):
            return None
        made = trial_rows(model, logs, beta, columns, there)
    except HaptidError:
        return None
    return made.whole.grams() if there is not motions or made.blocks == blocks else None


def _in_memory(rows: BaseRows, motions: Sequence[Motion]) -> Sequence[Motion]:
    """The motions themselves, or of those on disk the samples under the rows."""
    return list(excerpts(rows)) if any(isinstance(motion.q, OnDisk) for motion in motions) else motions


def rounded_rows(
    rows: BaseRows, motions: Sequence[Motion], beta: Array, columns: Sequence[Column], blocks: int
) -> tuple[Grams, ...]:
    """As `simulated_rows`, several times with the encoders' steps elsewhere; none where noise is larger than steps.

    Where a motion comes back, rounding is the same in every period, and no scatter of blocks shows what it has of a
    candidate column.
    """
    if not any(motion.log is not None and _steps(motion).any() for motion in _in_memory(rows, motions)):
        return ()
    every = lattices(motions[0].q.shape[1])
    made = (simulated_rows(rows, motions, beta, columns, blocks, one) for one in every)
    return tuple(one for one in made if one is not None)


def simulated_log(model: DynamicModel, motion: Motion, beta: Array, lattice: Lattice | None = None) -> Motion | None:
    """The motion's log as the model would have made it, with the same noise of the encoders, treated the same.

    What candidate columns have in it is made by noise, steps and filters and not by a missing term: positions are the
    filtered ones with noise, or steps, of the log's size; the torque is the model's at the filtered positions.
    None where there is no log, or the torque cannot be assigned to its channels.

    Args:
        lattice: on which the steps lie; where the filtered positions' multiples of them are for None.
    """
    log = motion.log
    if log is None or motion.treatment.momentum:
        return None
    plain: Treatment = replace(motion.treatment, torque_delay_s=0.0)
    try:
        smooth = treat(log, plain)
        low, high = smooth.usable
        c, cd, cdd = coordinates(model.device, smooth, low, high)
        shares = channel_shares(model.device, smooth, c)
        history = model.history(c, cd, np.arange(low, high, dtype=float) * log.dt)
        tau = torque_of(model, raw_parameters(model, beta), c, cd, cdd, history)
        torque = np.array(log.torque)
        made = channel_torque(model.device, shares, tau)
        if log.channels.torque.side == "motor":
            made = made / motor_torque(model.device, log, np.ones((len(made), 1)))
        torque[low:high] = made.T
        q, steps = np.asarray(smooth.q), _steps(smooth)
        # The noise backwards in time has its spectrum, but is not of this motion.
        noisy = np.where(steps > 0, q, q + (np.asarray(log.position) - q)[::-1])
        return treat(replace(log, position=(lattice or _own(len(steps))).rounded(noisy, steps), torque=torque), plain)
    except HaptidError:
        return None


def _steps(motion: Motion) -> Array:
    """Steps of the encoders whose rounding is most of what the filtered positions leave, rad or m; 0 of the others."""
    assert motion.log is not None  # as the callers have checked
    low, high = motion.usable
    made = np.zeros(motion.q.shape[1])
    for k, x in enumerate(np.asarray(motion.log.position).T):
        moved = np.abs(np.diff(x))
        step = float(moved[moved > 0].min()) if moved.any() else 0.0
        if (x[low:high] - np.asarray(motion.q)[low:high, k]).std() < step:
            made[k] = step
    return made


def _own(channels: int) -> Lattice:
    """The multiples of each encoder's step."""
    return Lattice(np.zeros(channels), np.ones(channels))
