"""Plan: which rows a motion gives, in which time blocks, with which filter and which columns of the core."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid._internal.signals import running_maximum
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.motion.channels import coordinate_torque, coordinates, position_map, state
from haptid.motion.filters import ParallelFilter, bad_setting
from haptid.motion.motion import Motion, too_short
from haptid.motion.noise_torques import rows_of_noise
from haptid.observation.own_instants import OwnColumn, along, own_columns, with_given
from haptid.observation.r_factor import r_factor

# Samples passed to the core at a time: enough for all its threads, little memory compared with a log.
SEGMENT = 1 << 16
# Most time blocks of one motion; those of a longer motion are twice, four times, ... as long.
MOST_BLOCKS = 512
# Fewest time blocks: the blocks of a short motion are shortened to this number, as leaving one out must leave enough.
LEAST_BLOCKS = 8
# Share of the parallel filter's weight that may lie outside the default guard around a row.
OUTSIDE_GUARD = 1e-3
# Share of the wanted length of a time block below which a shorter one is reported.
_SHORTENED = 0.8

# Position, velocity, acceleration (None in the momentum formulation) and external columns, each (..., samples).
Signals = tuple[Array, Array, Array | None, Array]
# R factors of some rows: (columns, stack) for each coordinate, and the rows of each block, (coordinates, blocks).
RFactors = tuple[list[tuple[np.ndarray, Array]], np.ndarray]


@dataclass(frozen=True)
class Block:
    """Time block: the rows of one log between two times.

    Attributes:
        log: SHA-256 of the log, or a name for a motion without one.
        start, stop: s.
    """

    log: str
    start: float
    stop: float


def shared_block(groups: Iterable[Iterable[Block]]) -> Block | None:
    """A block that shares rows with one of another group; None where there is none.

    Blocks of one group may share rows. The work grows as the number of blocks times its logarithm.
    """
    furthest: dict[str, dict[int, Block]] = {}  # of each log, the two groups whose blocks reach furthest
    numbered = [(block, k) for k, group in enumerate(groups) for block in group]
    for block, k in sorted(numbered, key=lambda one: one[0].start):
        reached = furthest.setdefault(block.log, {})
        if any(block.start < before.stop for group, before in reached.items() if group != k):
            return block
        if k not in reached or reached[k].stop < block.stop:
            reached[k] = block
        if len(reached) > 2:
            del reached[min(reached, key=lambda group: reached[group].stop)]
    return None


@dataclass(frozen=True, eq=False)
class Plan:
    """Rows of a motion: where they lie, how they are filtered and decimated, and which columns they need.

    Attributes:
        first: sample of row 0.
        rows: rows of each motor.
        block: rows of a time block.
        filter: the parallel filter.
        guard: samples before and after a row's own in which the motion must not be slow.
        columns: the core's columns that the base parameters need.
        selection: from those columns to the base parameters', (columns, p).
    """

    model: DynamicModel
    motion: Motion
    filter: ParallelFilter
    first: int
    rows: int
    block: int
    guard: tuple[int, int]
    columns: tuple[int, ...]
    selection: Array

    @staticmethod
    def of(model: DynamicModel, motion: Motion) -> Plan:
        """Place the rows between the ends within the transients of the filters.

        Raises:
            MotionTooShortError: not one row fits.
            TreatmentError: `reversal_speed` or `rest_speed` has neither one value nor one for each coordinate.
        """
        treatment, (low, high) = motion.treatment, motion.usable
        for name in ("reversal_speed", "rest_speed"):
            if np.size(getattr(treatment, name)) not in (1, len(model.device.row_names)):
                wanted = f"one value, or {len(model.device.row_names)}: one for each row of torque"
                raise bad_setting(name, getattr(treatment, name), wanted)
        shared = shared_filter(motion)
        rows = (high - low - len(shared)) // treatment.decimation + 1
        block = max(1, round(min(treatment.block_s / (treatment.decimation * motion.dt), rows / LEAST_BLOCKS)))
        while rows > MOST_BLOCKS * block:
            block *= 2
        guard = shared.main_part(OUTSIDE_GUARD)
        if treatment.reversal_guard_s is not None:
            guard = (round(min(treatment.reversal_guard_s / motion.dt, len(motion))),) * 2
        return Plan(model, motion, shared, low + shared.before, rows, block, guard, *model.needed)

    @property
    def taps(self) -> Array:
        """Taps of the parallel filter."""
        return self.filter.taps

    def segments(self) -> Iterator[tuple[int, int]]:
        """Row ranges start..stop of whole blocks, each small enough to process in memory."""
        step = self.block * max(1, SEGMENT // (self.block * self.motion.treatment.decimation))
        for start in range(0, self.rows, step):
            yield start, min(start + step, self.rows)

    def notes(self) -> tuple[str, ...]:
        """Sentences on segments of the log that are too short, and on shortened time blocks."""
        motion = self.motion
        if motion.log is None:
            return ()
        notes, length = [], len(self.filter)
        short = len(motion.segments) - sum(high - low >= length for low, high in motion.usable_segments)
        if short:
            low, high = motion.usable_segments[0]
            start, stop = next(part for part in motion.segments if part[0] <= low < part[1])
            notes.append(
                f"{short} of {len(motion.segments)} segments of {motion.log.path.name} are shorter than the filters "
                f"({(stop - start - (high - low) + length) * motion.dt:.3g} s) and give no rows"
            )
        block_s = self.block * motion.treatment.decimation * motion.dt
        if block_s < _SHORTENED * motion.treatment.block_s:
            notes.append(
                f"Time blocks are {block_s:.2g} s long and not {motion.treatment.block_s:.3g} s: a log needs "
                f"{LEAST_BLOCKS} of them at least."
            )
        return tuple(notes)

    def window(self, start: int, stop: int) -> tuple[int, int]:
        """First sample and one past the last that rows start..stop need."""
        d = self.motion.treatment.decimation
        return self.first + start * d - self.filter.before, self.first + (stop - 1) * d + self.filter.after + 1

    def t(self, start: int, stop: int) -> Array:
        """Times of rows start..stop, (rows,), s."""
        return self.motion.times(self.first + self.motion.treatment.decimation * np.arange(start, stop))

    def signals(self, low: int, high: int) -> Signals:
        """Position, velocity, acceleration where rows need one, and external columns of samples low..high."""
        if self.motion.treatment.momentum:
            c, cd = state(self.model.device, self.motion, low, high)
            return c, cd, None, external(self.core, c, cd, None, self.history(low, high))
        c, cd, cdd = coordinates(self.model.device, self.motion, low, high)
        return c, cd, cdd, external(self.core, c, cd, cdd, self.history(low, high))

    @property
    def core(self) -> DynamicModel:
        """The model of which the core computes the columns."""
        return self.for_core(self.model)

    def for_core(self, model: DynamicModel) -> DynamicModel:
        """The plan's model, or one with other settings, with friction at its motors' own instants from `history`."""
        given = frozenset(own.term.name for own in self._own_columns)
        return with_given(model, given) if given else model

    @cached_property
    def _own_columns(self) -> tuple[OwnColumn, ...]:
        return own_columns(self.model, self.motion)

    def history(self, low: int, high: int) -> dict[str, Array]:
        """Columns at samples low..high that their state does not determine, by name, each (samples,).

        Those of friction with presliding or warming, and of dry friction at the instants of a motor by itself.
        """
        before = {name: column[low:high] for name, column in self._columns_with_history.items()}
        return {**before, **along(self.model, self.motion, self._own_columns, low, high)}

    @cached_property
    def _columns_with_history(self) -> dict[str, Array]:
        """Columns of friction with presliding or warming along the whole motion, by name."""
        if not self.model.has_history:
            return {}
        change = position_map(self.model.device, self.motion)
        q, qd = (np.ascontiguousarray(x[:].T) for x in (self.motion.q, self.motion.qd))
        return self.model.history(change(q), change(qd), np.arange(len(self.motion), dtype=float) * self.motion.dt)

    def blocks(self, log: str | None = None) -> tuple[Block, ...]:
        """Time block of every `block` rows, (blocks,); `log` names their source, `motion.name` where None."""
        step = self.motion.treatment.decimation * self.motion.dt
        begin = self.motion.t0 + self.first * self.motion.dt - 0.5 * step
        edges = [*range(0, self.rows, self.block), self.rows]
        name = self.motion.name if log is None else log
        if len(self.motion.segments) > 1:
            first = self.t(0, self.rows)[[*range(0, self.rows, self.block), -1]] - 0.5 * step
            first[-1] += step
            return tuple(Block(name, float(a), float(b)) for a, b in pairwise(first))
        return tuple(Block(name, begin + a * step, begin + b * step) for a, b in pairwise(edges))

    def reduce(self, start: int, stop: int) -> RFactors:
        """R factors of rows start..stop: the core computes, filters, decimates and factorises them block by block."""
        low, high = self.window(start, stop)
        weights = self.weights(start, stop)
        c, cd, cdd, own = self.signals(low, high)
        factors = self.core.mechanism.reduce(
            c,
            cd,
            cdd,
            own,
            coordinate_torque(self.model.device, self.motion, low, high),
            list(self.columns),
            self.filter.taps,
            self.motion.treatment.decimation,
            len(self.filter) // 2,
            stop - start,
            self.block,
            weights,
            self.filter.slope,
            self.model.loops(c, cd),
        )
        blocks = np.arange(0, stop - start, self.block)
        return [self.selected(np.array(a), T) for a, T in factors], np.add.reduceat(
            weights > 0, blocks, axis=1, dtype=int
        )

    @cached_property
    def _one_to_one(self) -> bool:
        """Whether the core's columns are those of the base parameters."""
        return np.array_equal(self.selection, np.eye(len(self.selection)))

    def selected(self, reached: np.ndarray, r_factors: Array) -> tuple[np.ndarray, Array]:
        """R factors over the core's columns as R factors over base parameters, which may be sums of several."""
        if self._one_to_one:
            return reached, r_factors
        chosen = self.selection[reached]
        base = np.flatnonzero(chosen.any(axis=0))
        if chosen.shape == (len(base), len(base)) and (chosen[:, base] == np.eye(len(base))).all():
            return base, r_factors
        mix = np.zeros((len(reached) + 1, len(base) + 1))
        mix[:-1, :-1], mix[-1, -1] = chosen[:, base], 1.0
        return base, r_factor(r_factors @ mix)

    def weights(self, start: int, stop: int) -> Array:
        """1 for a row that is used, (coordinates, rows); 0 for one near a reversal, at rest, or across a gap.

        The sign of a slow velocity is uncertain, and with it the Coulomb friction; that of a joint at rest is anything
        up to it, as the controller and the way there have left it. A motor whose torque shows noise alone has no rows.
        """
        model, treatment = self.model, self.motion.treatment
        weights = np.ones((len(model.device.row_names), stop - start))
        self._drop_across_gaps(weights, start, stop)
        if self.motion.log is not None:
            weights[rows_of_noise(model.device, self.motion.log)] = 0.0
        if not np.any(treatment.reversal_speed) and not np.any(treatment.rest_speed):
            return weights
        slow, rest = (
            np.broadcast_to(np.asarray(speed, dtype=float), (len(weights),))
            for speed in (treatment.reversal_speed, treatment.rest_speed)
        )
        window = max(1, round(treatment.rest_s / self.motion.dt)) if rest.any() else 0
        centres = self.first + treatment.decimation * np.arange(start, stop)
        low, high = self.motion.usable
        back, ahead = self.guard
        low, high = max(low, int(centres[0]) - back - window), min(high, int(centres[-1]) + ahead + window + 1)
        c, cd = state(model.device, self.motion, low, high)
        after = np.minimum(centres + ahead + 1, high) - low
        before = np.maximum(centres - back, low) - low
        for row in map(int, np.flatnonzero((slow > 0) | (rest > 0))):
            for term in model.coulomb_terms(row):
                v = model.speed(term, c, cd)
                dropped = _slow(v, slow[row]) if slow[row] > 0 else np.zeros(len(v), dtype=bool)
                if rest[row] > 0:
                    dropped |= rest_samples(v, rest[row], window)
                dropped = np.concatenate([[0], np.cumsum(dropped)])
                weights[row, dropped[after] > dropped[before]] = 0.0
        return weights

    def _drop_across_gaps(self, weights: Array, start: int, stop: int) -> None:
        """Set to 0 what the weights are of rows whose filter window is not within one usable segment."""
        if len(self.motion.segments) == 1:
            return
        centres = self.first + self.motion.treatment.decimation * np.arange(start, stop)
        inside = np.zeros(stop - start, dtype=bool)
        for low, high in self.motion.usable_segments:
            inside |= (centres - self.filter.before >= low) & (centres + self.filter.after < high)
        weights[:, ~inside] = 0.0


def shared_filter(motion: Motion) -> ParallelFilter:
    """The parallel filter of a motion's torque and columns.

    Raises:
        MotionTooShortError: not one row fits between the filters' ends.
    """
    low, high = max(motion.usable_segments, key=lambda part: part[1] - part[0])
    length = 2 * motion.treatment.reach(motion.dt) + 1  # a filter much longer than the motion may not fit in memory
    if length < 2 * len(motion):
        parallel_filter = motion.treatment.parallel_filter(motion.dt)
        if len(parallel_filter) <= high - low:
            return parallel_filter
        length = len(parallel_filter)
    needed = (len(motion) - (high - low) + length) * motion.dt
    raise too_short(len(motion) * motion.dt, needed, "the filters' ends", motion.treatment.decimation)


def _slow(v: Array, speed: float) -> np.ndarray:
    """Samples that are slow, or where the sign changes: at a low sampling rate no sample of a reversal is slow."""
    slow = np.abs(v) < speed
    slow[1:] |= v[1:] * v[:-1] < 0
    return slow


def rest_samples(v: Array, speed: float, window: int) -> np.ndarray:
    """Samples of a stretch of `window` samples in which the position moves less than at a mean speed.

    A reversal is left at once, a rest is not; noise of the velocity about zero has a small range of positions.
    """
    x, length = np.cumsum(v), min(window, len(v))
    span = running_maximum(x, length) + running_maximum(-x, length)
    return np.asarray(running_maximum((span < speed * length).astype(float), length) > 0)
