"""Which rows are looked at once more: all of a short log, stretches spread over a long one.

What the triangles tell needs no rows, and is asked of the whole log. What needs the rows again is a test, and its cost
grows with the log while what it sees hardly does: it is asked of stretches, each whole blocks of the observation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from haptid.estimation import Estimate
from haptid.motion.treatment import Motion
from haptid.observation.plan import Block, Plan

# Samples that are looked at; of fewer blocks than these no deviation can be made, so they are looked at all the same.
MOST_SAMPLES, FEWEST_BLOCKS = 200_000, 24
# Stretches that these are in.
STRETCHES = 20
# Stretches begin at this share, times their number, of the room that each has (the golden ratio): evenly spread, but
# not in step with a motion that repeats.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


def portion(estimate: Estimate) -> Estimate:
    """The same estimate beside the blocks to be looked at, and the motions that these are of; itself where it is short.

    Args:
        estimate: of any method.
    """
    seen = estimate.observation
    kept = spread_blocks(len(seen.blocks), samples(estimate))
    if len(kept) == len(seen.blocks):
        return estimate
    some = seen.pick(kept)
    names = {block.log for block in some.blocks}
    motions = tuple(motion for motion in seen.motions if named(motion) in names)
    return replace(estimate, observation=replace(some, motions=motions))


def spread_blocks(blocks: int, samples: int) -> np.ndarray:
    """Indices of the blocks to be looked at, increasing, of so many that hold so many samples."""
    wanted = max(MOST_SAMPLES * blocks // max(samples, 1), FEWEST_BLOCKS)
    if wanted >= blocks:
        return np.arange(blocks)
    each = -(-wanted // STRETCHES)
    many = wanted // each
    edges = np.arange(many + 1) * blocks // many
    room = np.diff(edges) - each
    starts = edges[:-1] + (np.arange(many) * GOLDEN % 1.0 * (room + 1)).astype(int)
    return np.asarray((starts[:, None] + np.arange(each)).ravel())


def samples(estimate: Estimate) -> int:
    """Samples under all blocks."""
    seen = estimate.observation
    return round(sum(block.stop - block.start for block in seen.blocks) / seen.motions[0].dt)


def named(motion: Motion) -> str:
    """What the blocks of a motion call it."""
    return motion.log.sha256 if motion.log else f"motion {id(motion):x}"


def runs(plan: Plan, wanted: Sequence[Block]) -> Iterator[tuple[int, int]]:
    """Rows start..stop of those blocks of a motion that are wanted, neighbours together as far as memory allows."""
    there = np.isin(np.arange(-(-plan.rows // plan.block)), [k for k, _ in numbered(plan, wanted)])
    for start, stop in plan.segments():
        first = start // plan.block
        inside = there[first : -(-stop // plan.block)].astype(int)
        for a, b in np.flatnonzero(np.diff(inside, prepend=0, append=0)).reshape(-1, 2) + first:
            yield int(a) * plan.block, min(int(b) * plan.block, stop)


def numbered(plan: Plan, wanted: Sequence[Block]) -> Iterator[tuple[int, int]]:
    """Of every block of a plan that is wanted, its number in the plan and its index among those wanted."""
    index = {block: k for k, block in enumerate(wanted)}
    for k, block in enumerate(plan.blocks(named(plan.motion))):
        if block in index:
            yield k, index[block]


def sentence(whole: Estimate, part: Estimate) -> str:
    """Which share of an estimate's log was looked at."""
    return (
        f"The log is long: residuals were looked at in {len(part.observation.blocks)} of "
        f"{len(whole.observation.blocks)} blocks, {samples(part)} of {samples(whole)} samples, spread evenly; "
        f"excitation, influence and drift in all of it."
    )
