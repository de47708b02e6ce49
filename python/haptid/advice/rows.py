"""The rows on which advice is tried: W, candidate columns and every motor's torque, as Gram matrices of time blocks.

Every trial is a choice of columns, a factor on each motor's model and an assignment of torque channels to motors, so
that all of them are solved from the same Gram matrices, and the log is passed through once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.advice.grams import Grams
from haptid.dynamics.inverse import raw_parameters
from haptid.dynamics.model import DynamicModel
from haptid.inference.diagnosis.subsample import evenly_spaced, row_ranges
from haptid.motion.channels import coordinate_torque
from haptid.motion.motion import Motion, treat
from haptid.observation.augmented import ResidualContext
from haptid.observation.filtering import treated_columns
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk

# Blocks of a trial, at most: neighbours are merged, since more do not sharpen a standard error.
_MOST_BLOCKS = 40


@dataclass(frozen=True, eq=False)
class Column:
    """Candidate columns along a motion.

    Attributes:
        values: torque of each column, (count, coordinates, samples), or where `weights` are given (count, samples).
        weights: the coordinate that all act on, as a combination of the device's, (coordinates,); None: any.
    """

    values: Callable[[ResidualContext], Array]
    weights: Array | None = None


@dataclass(frozen=True, eq=False)
class TrialRows:
    """Rows of an estimate, dense: few, because they are decimated.

    Attributes:
        W: columns of the base parameters, then of the candidates, (motors, rows, columns), SI.
        y: torque of every motor's channel at every motor's rows, (motors, rows), N m or N.
        used: whether a row is used, (motors, rows).
        block: time block of each row, (rows,), from 0.
        t: s; begins anew in each log, (rows,).
        groups: columns of each candidate, in order.
        position, velocity: of the torque rows' coordinates, (coordinates, rows), SI.
        sample: index of the middle sample in its log, (rows,), and `log`, of which motion.
        chunks: that the rows are of, with their motion each; none where they are not known.
    """

    W: Array
    y: Array
    used: np.ndarray
    block: np.ndarray
    t: Array
    groups: tuple[tuple[int, ...], ...]
    position: Array
    velocity: Array
    sample: np.ndarray
    log: np.ndarray
    chunks: tuple[tuple[int, Chunk], ...] = ()

    @property
    def movable(self) -> bool:
        """Whether `torque_of` can be computed."""
        return bool(self.chunks)

    def torque_of(self, taus: Sequence[Array]) -> Array:
        """As `y`, from other torques of each motion, (n, channels): the motors', or as its log has them."""
        made = []
        for k, chunk in self.chunks:
            motion, window = replace(chunk.plan.motion, tau=taus[k]), chunk.plan.window(chunk.start, chunk.stop)
            made.append(chunk.treated(coordinate_torque(chunk.model.device, motion, *window)))
        return np.concatenate(made, axis=-1)

    @property
    def blocks(self) -> int:
        return int(self.block.max()) + 1

    @property
    def whole(self) -> TrialRows:
        """The same rows as one block."""
        return replace(self, block=np.zeros_like(self.block))

    def grams(self, mask: np.ndarray | None = None, columns: int | None = None) -> Grams:
        """Gram matrices of [W y_1 .. y_m] of every block and motor.

        Args:
            mask: rows that count besides being used, (motors, rows).
            columns: number of W's columns, from the first on; all where None.
        """
        used = self.used if mask is None else self.used & mask
        return Grams.of(self.W[:, :, :columns], self.y, used, self._edges)

    def grams_with_torque(self, grams: Grams, y: Array) -> Grams:
        """`grams()` of these rows with another torque, (motors, rows)."""
        return grams.with_torque(self.W, y, self.used, self._edges)

    @property
    def _edges(self) -> np.ndarray:
        """First row of each block, and one past the last, (blocks + 1,)."""
        return np.searchsorted(self.block, np.arange(self.blocks + 1))

    def halves(self, columns: int) -> tuple[TrialRows, np.ndarray]:
        """The rows of every other block as one block each, with W's first columns; and where each row was, (rows,)."""
        order = np.argsort(self.block % 2, kind="stable")
        names = ("y", "used", "t", "position", "velocity", "sample", "log")
        moved = {name: getattr(self, name)[..., order] for name in names}
        return replace(self, W=self.W[:, order, :columns], block=self.block[order] % 2, chunks=(), **moved), order


def trial_rows(
    model: DynamicModel,
    motions: Sequence[Motion],
    beta: Array,
    columns: Sequence[Column] = (),
    like: Sequence[Motion] | None = None,
    most: int | None = None,
) -> TrialRows:
    """The rows of motions with candidate columns; of long logs, those of blocks spread evenly over them.

    Args:
        motions: treated signals.
        beta: base parameters from which the candidates' signals are computed, (p,), SI.
        columns: candidates.
        like: motions whose rows are used, where these are simulated copies of them.
        most: samples in these blocks, as of `evenly_spaced`.
    """
    return BaseRows.of(model, motions, like, most).with_columns(beta, columns)


@dataclass(frozen=True, eq=False)
class BaseRows:
    """The rows of motions in the base parameters' columns, to which candidates are added without computing them again.

    Attributes:
        model: whose columns.
        chunks: of consecutive rows.
        W: of each chunk, (motors, p, rows), SI.
        block, log: of each chunk's rows, (rows,).
    """

    model: DynamicModel
    chunks: tuple[Chunk, ...]
    W: tuple[Array, ...]
    block: tuple[np.ndarray, ...]
    log: tuple[np.ndarray, ...]

    @staticmethod
    def of(
        model: DynamicModel,
        motions: Sequence[Motion],
        like: Sequence[Motion] | None = None,
        most: int | None = None,
    ) -> BaseRows:
        """As `trial_rows` has them."""
        own, chunks, block, log, before = model.known_rows, [], [], [], 0
        plans = [
            (Plan.of(model, motion), Plan.of(model, there))
            for motion, there in zip(motions, like or motions, strict=True)
        ]
        every = [wanted.blocks() for _, wanted in plans]
        # Logs of a fit may have different rates.
        samples = sum(
            (one.stop - one.start) / plan.motion.dt for (plan, _), own in zip(plans, every, strict=True) for one in own
        )
        kept = evenly_spaced(sum(map(len, every)), round(samples), most)
        for k, (plan, wanted) in enumerate(plans):
            here = kept[(kept >= before) & (kept < before + len(every[k]))] - before
            for start, stop in row_ranges(wanted, [every[k][b] for b in here]):
                if (stop := min(stop, plan.rows)) > start:
                    chunks.append(Chunk(plan, start, stop, model, tuple(own)))
                    block.append(before + np.arange(start, stop) // wanted.block)
                    log.append(np.full(stop - start, k))
            before += len(every[k])
        W = tuple(treated_columns(chunk.plan, chunk.signals)[list(own)].swapaxes(1, 2) for chunk in chunks)
        return BaseRows(model, tuple(chunks), W, tuple(block), tuple(log))

    def with_columns(self, beta: Array, columns: Sequence[Column] = ()) -> TrialRows:
        """With candidates, whose signals are computed from base parameters, (p,)."""
        chi = raw_parameters(self.model, beta)
        groups = _groups(self.model, self.chunks[0].plan.motion, chi, columns)
        rows, width = sum(map(len, self.block)), 1 + groups[-1][-1] if groups else len(self.model.base)
        # Filled chunk by chunk: of a long log it takes more memory than all else.
        W, start = np.empty((len(self.W[0]), rows, width)), 0
        for chunk, own in zip(self.chunks, self.W, strict=True):
            W[:, start : start + own.shape[2]] = _wide(chunk, own, columns, chi).swapaxes(1, 2)
            start += own.shape[2]
        there_are, number = np.unique(np.concatenate(self.block), return_inverse=True)
        merged = -(-len(there_are) // _MOST_BLOCKS)
        y, used, t, c, cd, sample = self._measured
        of = tuple((int(log[0]), chunk) for log, chunk in zip(self.log, self.chunks, strict=True))
        return TrialRows(W, y, used, number // merged, t, groups, c, cd, sample, np.concatenate(self.log), of)

    @cached_property
    def _measured(self) -> tuple[np.ndarray, ...]:
        """Torque, whether it is used, time, position, velocity and sample of each row, (..., rows)."""
        parts = [(chunk.measured(), chunk.used, chunk.t, *_state(chunk)) for chunk in self.chunks]
        return tuple(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))


def excerpts(rows: BaseRows) -> Iterator[Motion]:
    """The samples under the rows of each motion in memory, treated alike; there are gaps between its parts."""
    by_log: dict[int, list[Chunk]] = {}
    for chunk, log in zip(rows.chunks, rows.log, strict=True):
        by_log.setdefault(int(log[0]), []).append(chunk)
    for chunks in by_log.values():
        motion, ranges = chunks[0].plan.motion, list[tuple[int, int]]()
        assert motion.log is not None
        ends = max(motion.usable[0], len(motion) - motion.usable[1])  # that the filters take from each part
        for low, high in (chunk.plan.window(chunk.start, chunk.stop) for chunk in chunks):
            low, high = max(low - ends, 0), min(high + ends, len(motion))
            if ranges and low <= ranges[-1][1]:
                low = ranges.pop()[0]
            ranges.append((low, high))
        yield treat(motion.log.excerpt(ranges), motion.treatment)


def _wide(chunk: Chunk, own: Array, columns: Sequence[Column], chi: Array) -> Array:
    """W with candidates, (motors, columns, rows)."""
    context = ResidualContext(chunk.plan, chi, *chunk.plan.window(chunk.start, chunk.stop), chunk.signals)
    W = [own]
    for column in columns:
        treated = chunk.filtered(column.values(context))
        if column.weights is None:
            W.append(treated[:, list(chunk.coordinates)].swapaxes(0, 1))
        else:
            W.append(column.weights[list(chunk.coordinates)][:, None, None] * treated[None])
    return np.concatenate(W, axis=1)


def _state(chunk: Chunk) -> tuple[Array, Array, np.ndarray]:
    """Position and velocity of the coordinates at each row, (coordinates, rows), and its sample, (rows,)."""
    plan = chunk.plan
    sample = plan.first + plan.motion.treatment.decimation * np.arange(chunk.start, chunk.stop)
    return chunk.centres(chunk.c), chunk.centres(chunk.cd), sample


def _groups(model: DynamicModel, motion: Motion, chi: Array, columns: Sequence[Column]) -> tuple[tuple[int, ...], ...]:
    """Columns of each candidate, after those of the base parameters."""
    plan = Plan.of(model, motion)
    low, _ = plan.window(0, 1)
    context = ResidualContext(plan, chi, low, low + 8)
    ends = len(model.base) + np.cumsum([0, *(len(one.values(context)) for one in columns)])
    return tuple(tuple(range(int(a), int(b))) for a, b in pairwise(ends))
