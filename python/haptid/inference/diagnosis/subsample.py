"""Subsampling of long logs: diagnostics that must compute rows again use blocks spread evenly over the log.

Diagnostics on the R factors need no rows and use the whole log. The cost of those that do grows with the log, while
their power is sufficient on part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from haptid.dynamics.model import DynamicModel
from haptid.estimation import Estimate
from haptid.log import OnDisk, PartlyInMemory, as_array
from haptid.motion.motion import Motion
from haptid.observation.plan import Block, Plan

# Samples in a subsample; never fewer blocks than this, since block-wise standard errors need them.
MOST_SAMPLES, FEWEST_BLOCKS = 200_000, 24
# The subsample consists of this many contiguous ranges of blocks.
RANGES = 20
# A range begins at this fraction, times its number, of the room that it has (the golden ratio): evenly spread, but not
# synchronous with a periodic motion.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
# Samples beyond those under a range's rows that are kept in memory with them, s: torques are shifted by less.
_AROUND = 0.5
# The subsample of each estimate, and its blocks: diagnosis, comparisons and advice take the same one.
_TAKEN: WeakKeyDictionary[Estimate, tuple[np.ndarray, Estimate]] = WeakKeyDictionary()


def subsample(estimate: Estimate) -> Estimate:
    """The same estimate with the blocks of the subsample only, and their motions; itself if the log is short.

    Samples under these blocks stay in memory once they were read.
    """
    observation = estimate.observation
    indices = evenly_spaced(len(observation.blocks), samples_in(observation.blocks, observation.motions[0].dt))
    if len(indices) == len(observation.blocks):
        return estimate
    known, part = _TAKEN.get(estimate, (None, estimate))
    if known is None or not np.array_equal(known, indices):
        some = observation.pick(indices)
        names = {block.log for block in some.blocks}
        used = (motion for motion in observation.motions if log_name(motion) in names)
        motions = tuple(_held(observation.model, motion, some.blocks) for motion in used)
        part = replace(estimate, observation=replace(some, motions=motions))
        _TAKEN[estimate] = indices, part
    return part


def _held(model: DynamicModel, motion: Motion, wanted: Sequence[Block]) -> Motion:
    """A motion on disk with the samples under some blocks kept in memory; one in memory as it is."""
    if not isinstance(motion.q, OnDisk):
        return motion
    plan = Plan.of(model, motion)
    margin = round((_AROUND + np.max(motion.treatment.rest_s)) / motion.dt) + max(plan.guard)
    ranges: list[tuple[int, int]] = []
    for rows in row_ranges(plan, wanted):
        low, high = plan.window(*rows)
        low, high = max(low - margin, 0), min(high + margin, len(motion))
        if ranges and low <= ranges[-1][1]:
            low = ranges.pop()[0]
        ranges.append((low, high))
    q, tau = (as_array(PartlyInMemory(samples, tuple(ranges))) for samples in (motion.q, motion.tau))
    return replace(motion, q=q, tau=tau)


def evenly_spaced(blocks: int, samples: int, most: int | None = None) -> np.ndarray:
    """Indices of the blocks of the subsample, increasing.

    Args:
        blocks: of the whole log.
        samples: in these blocks.
        most: samples of the subsample; `MOST_SAMPLES` where None.
    """
    wanted = max((MOST_SAMPLES if most is None else most) * blocks // max(samples, 1), FEWEST_BLOCKS)
    if wanted >= blocks:
        return np.arange(blocks)
    length = -(-wanted // RANGES)
    ranges = wanted // length
    edges = np.arange(ranges + 1) * blocks // ranges
    room = np.diff(edges) - length
    starts = edges[:-1] + (np.arange(ranges) * GOLDEN % 1.0 * (room + 1)).astype(int)
    return np.asarray((starts[:, None] + np.arange(length)).ravel())


def samples_in(blocks: Sequence[Block], dt: float) -> int:
    """Samples in some blocks.

    Args:
        dt: step between samples, s.
    """
    return round(sum(block.stop - block.start for block in blocks) / dt)


def log_name(motion: Motion) -> str:
    """The name by which the blocks of a motion refer to it."""
    return motion.log.sha256 if motion.log else f"motion {id(motion):x}"


def row_ranges(plan: Plan, wanted: Sequence[Block]) -> Iterator[tuple[int, int]]:
    """Rows start..stop of the wanted blocks of a motion, neighbours together as far as memory allows."""
    wanted_blocks = np.isin(np.arange(-(-plan.rows // plan.block)), [k for k, _ in block_numbers(plan, wanted)])
    for start, stop in plan.segments():
        first = start // plan.block
        inside = wanted_blocks[first : -(-stop // plan.block)].astype(int)
        for a, b in np.flatnonzero(np.diff(inside, prepend=0, append=0)).reshape(-1, 2) + first:
            yield int(a) * plan.block, min(int(b) * plan.block, stop)


def block_numbers(plan: Plan, wanted: Sequence[Block]) -> Iterator[tuple[int, int]]:
    """Of every wanted block of a plan, its number in the plan and its index among those wanted."""
    index = {block: k for k, block in enumerate(wanted)}
    for k, block in enumerate(plan.blocks(log_name(plan.motion))):
        if block in index:
            yield k, index[block]


def sentence(full: Estimate, part: Estimate) -> str:
    """The size of the subsample, in words."""
    of_part, of_all = (samples_in(one.observation.blocks, one.observation.motions[0].dt) for one in (part, full))
    return (
        f"The log is long: tests of the residual use {len(part.observation.blocks)} of "
        f"{len(full.observation.blocks)} blocks, {of_part} of {of_all} samples, spread evenly; "
        f"excitation, influence and drift use all of it."
    )
