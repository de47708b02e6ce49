"""Stale rows: rows of a recorder that hold a signal's earlier sample again.

A recorder that polls a bus faster than the bus delivers, or misses a message, writes the last sample once more. Such a
row is wrong by up to one step of motion, which is as much as jitter of a whole sampling period. A repeat is not proof:
positions of a coarse encoder repeat where motion is slow, torques of few levels repeat anywhere, and both repeat at
rest and at turning points.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.log.spectrum import lattice_step

Mask = NDArray[np.bool_]

# More repeats in a row than this are rest.
LONGEST_RUN = 12
# A position that moves one way by FAST counts a row, on average over SPAN rows to either side, cannot repeat.
SPAN, FAST = 3, 1.5
# Not even with noise of a count if it moves by this many times more.
FASTER = 6.0
# Nor is it likely to, where rows are stale, if it moves by this many times more to and fro.
LIVELY = 2.0
# Share of rows above which repeats of one signal are acted on: turning points imitate up to 4.5 %.
LEAST_STALE = 0.05
# Share of the rows that move fastest above which repeated positions are acted on: there is no turning point among them.
LEAST_SURE = 0.002
# Least step after a repeat, in mean steps: 2 for a sample that was missed, 1.5 for one that noise has made equal.
CATCHES_UP = 1.75
# Least share, and number, of rows where positions and torques repeat together.
LEAST_TOGETHER, FEWEST_TOGETHER = 0.002, 10
# Share of stale positions whose torque repeats too, from which on whole rows are taken as stale.
TOGETHER = 0.8
# Percentile of the steps that stands for a count where there are none.
_SLOWEST = 2.0
# A torque with fewer distinct values than this share of the samples is coarse: its repeats prove nothing.
FINE = 0.25
# Share of slow rows with repeated positions whose torques repeat too, from which on torques follow positions.
FOLLOWS = 0.9
# Rows that distinct values are counted in, and levels of an encoder are found in.
ROWS_COUNTED = 2**16


# Least number of rows with one sample from which a recorder polls; repeats by twos are stale rows.
_POLLED = 3
# Share of rows that repeat then, of the repeats' lengths that are within a half of the usual one, and the usual step
# of a position in its smallest ones: a coarse encoder moves by single counts.
_HELD, _EVEN, _COUNTS = 0.6, 0.8, 2.5


def polled(same_position: Mask, same_torque: Mask, positions: Callable[[], Iterable[Array]]) -> tuple[Mask, int] | None:
    """Rows to keep of a recorder that polls a slower source: the first of each sample, and the usual rows of a sample.

    While nothing changes, at rest, a row of each usual length is kept. None where rows do not repeat evenly.

    Args:
        same_position, same_torque, positions: as in `find_stale`.
    """
    whole = same_position & same_torque
    if whole.mean() < _HELD:
        return None
    fresh = np.flatnonzero(~whole)
    lengths = np.diff(fresh)
    usual = int(np.median(lengths)) if lengths.size else 0
    if usual < _POLLED or np.mean(np.abs(lengths - usual) <= 0.5 * usual) < _EVEN:
        return None
    kept = ~whole
    kept[0] = True
    if not any(_several_counts(channel[kept]) for channel in positions()):
        return None
    starts = np.flatnonzero(kept)
    since = np.arange(whole.size) - np.repeat(starts, np.diff(starts, append=whole.size))
    left = np.repeat(np.diff(starts, append=whole.size), np.diff(starts, append=whole.size)) - since
    kept |= (since % usual == 0) & (left > usual // 2)
    kept[0] = False  # when its sample came is not known
    return kept, usual


def _several_counts(channel: Array) -> bool:
    """Whether a position moves by several counts from sample to sample."""
    steps = np.abs(np.diff(channel))
    steps = steps[steps > 0]
    return bool(steps.size and np.median(steps) > _COUNTS * smallest_step(channel))


@dataclass(frozen=True, eq=False)
class Stale:
    """Rows whose sample is that of the row before, (rows,) each.

    Attributes:
        position, torque: of the signal; all False where it is not acted on.
        moving: rows in which the positions move too fast to repeat.
    """

    position: Mask
    torque: Mask
    moving: Mask


def find_stale(
    same_position: Mask,
    same_torque: Mask,
    positions: Callable[[], Iterable[Array]],
    torques: Callable[[], Iterable[Array]],
) -> Stale | None:
    """Stale rows of both signals; None where there are none.

    A repeated position counts where a channel moves faster than `FAST` counts a row, or where torques repeat with it
    that are not a function of the positions. A repeated torque counts if the torques are fine, see `FINE`, and not a
    function of positions that may rest; coarse torques are stale where the rows of stale positions are stale as a
    whole. Below `LEAST_STALE` only those are stale where positions and torques repeat together, positions repeat in
    fast motion, or torques that lie on no lattice repeat off their limits.

    Args:
        same_position, same_torque: whether all channels of a signal equal those of the row before, (rows,).
        positions, torques: give the channels, each (rows,), in any unit.
    """
    short_position, short_torque = (same & ~_long_runs(same) for same in (same_position, same_torque))
    if max(short_position.mean(), short_torque.mean()) < LEAST_TOGETHER:
        return None
    moving, fast, lively = _moving(positions, same_position.size)
    position = short_position & moving
    if (
        _catching_up(positions, position) < CATCHES_UP
    ):  # an encoder whose error follows its angle repeats where it is flat
        position[:] = False
    slow = same_position & ~moving
    bound = not slow.any() or float(same_torque[slow].mean()) >= FOLLOWS
    if bound and position.any() and slow.any():
        # Samples that motion catches up on are missed in slow motion as often: where these are most of the repeats
        # there, the rest shows nothing.
        caught_up = float((position & same_torque)[moving].mean())
        bound = caught_up < TOGETHER * float(same_position[~moving].mean())
    fine = [channel for channel in torques() if _is_fine(channel)]
    if fine:
        torque = short_torque & (position | ~same_position) if bound else short_torque
        position |= short_position & torque
    else:
        whole = position.any() and float(same_torque[position].mean()) >= TOGETHER
        torque = position & same_torque if whole else np.zeros_like(position)
    both = position & torque
    if bound:  # torques that repeat because positions do are no proof
        both &= fast
    together = int(both.sum())
    judged = position & fast if bound else position
    whole = together >= max(FEWEST_TOGETHER, LEAST_TOGETHER * position.size, TOGETHER * int(judged.sum()))
    found = [own if whole or own.mean() > LEAST_STALE else np.zeros_like(own) for own in (position, torque)]
    if not found[1].any() and torque.mean() >= LEAST_TOGETHER:
        exact = torque & _exact(fine)
        if exact.mean() >= LEAST_TOGETHER:
            found[1] = exact
    sure = position & fast
    if not found[0].any() and sure.sum() >= max(FEWEST_TOGETHER, LEAST_SURE * fast.sum()):
        found[0] = sure
    if found[0].any():  # repeats in quick turns prove nothing, but where rows are stale most of them are
        found[0] |= short_position & lively
        if found[1].any():
            found[1] |= short_torque & found[0]
    return Stale(found[0], found[1], moving) if found[0].any() or found[1].any() else None


def _long_runs(same: Mask) -> Mask:
    """Repeats in runs longer than `LONGEST_RUN`."""
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False))
    made = np.zeros(same.size, dtype=bool)
    lengths = edges[1::2] - edges[::2]
    made[same] = np.repeat(lengths > LONGEST_RUN, lengths)
    return made


def _moving(positions: Callable[[], Iterable[Array]], rows: int) -> tuple[Mask, Mask, Mask]:
    """Where a channel moves one way, which noise does not, faster than `FAST` counts a row; and `FASTER`; any way."""
    moving, fast, lively = (np.zeros(rows, dtype=bool) for _ in range(3))
    for channel in positions():
        least = 2 * SPAN * FAST * smallest_step(channel)
        travel = np.abs(channel[2 * SPAN :] - channel[: -2 * SPAN])
        window = np.ones(2 * SPAN, dtype=np.int8)
        down, up = (np.convolve(way(channel[1:], channel[:-1]), window, "valid") for way in (np.less, np.greater))
        one_way = (down == 0) | (up == 0)
        moving[SPAN:-SPAN] |= (travel > least) & one_way
        fast[SPAN:-SPAN] |= (travel > FASTER * least) & one_way
        lively[SPAN:-SPAN] |= np.convolve(np.abs(np.diff(channel)), window, "valid") > LIVELY * least
    return moving, fast, lively


def _catching_up(positions: Callable[[], Iterable[Array]], repeated: Mask) -> float:
    """Step after a repeated position over the mean step around it: 2 after a sample that was missed, for any motion.

    Of rows that repeat once; infinite without any.
    """
    alone = repeated[1:-1] & ~repeated[2:] & ~repeated[:-2]
    rows = 1 + np.flatnonzero(alone)
    rows = rows[(rows >= SPAN) & (rows < repeated.size - SPAN - 1)]
    next_step = usual = 0.0
    for channel in positions():
        step = (channel[rows + SPAN] - channel[rows - SPAN]) / (2 * SPAN)
        size = np.abs(step).sum()
        if size > 0:  # channels of different units count alike
            next_step += float(np.sum(np.sign(step) * (channel[rows + 1] - channel[rows])) / size)
            usual += 1.0
    return next_step / usual if usual else np.inf


def smallest_step(channel: Array) -> float:
    """Count of an encoder; where there are no counts, the step that few of the moving rows stay below."""
    part = channel[: 4 * ROWS_COUNTED]
    if step := lattice_step(part):
        return step
    steps = np.abs(np.diff(part))
    steps = steps[steps > 0]
    return float(np.percentile(steps, _SLOWEST)) if steps.size else 0.0


def _exact(channels: Iterable[Array]) -> Mask | bool:
    """Rows of torques that lie on no lattice, off the limits of each; none where all lie on one."""
    off, free = True, False
    for channel in channels:
        off = off & (channel > channel.min()) & (channel < channel.max())
        free = free or not lattice_step(channel[: 4 * ROWS_COUNTED])
    return off if free else False


def _is_fine(channel: Array) -> bool:
    """Whether a channel has so many distinct values that it does not repeat by chance."""
    middle = max(0, (channel.size - ROWS_COUNTED) // 2)
    part = channel[middle : middle + ROWS_COUNTED]
    return bool(np.unique(part).size >= FINE * part.size)
