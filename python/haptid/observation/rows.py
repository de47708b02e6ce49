"""Rows of the observation matrix, chunk by chunk: W, y, the model's torque, and the signals under them.

W is never stored as a whole. Estimators that weight, whiten or project single rows have the rows computed again,
change them, and reduce them to R factors like those of the observation they came from; all later steps use R factors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import coordinate_torque
from haptid.motion.motion import Motion
from haptid.observation.filtering import decimate, treated_columns, treated_torque
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Block, Plan, Signals
from haptid.observation.r_factor import r_factor

# Numbers (rows times columns) that `Rows` caches between passes; more are computed again in every pass.
_CACHED = 1 << 26


@dataclass(frozen=True, eq=False)
class Chunk:
    """Consecutive rows of a Plan that fit in memory together.

    Signals, W, y and the other arrays are computed at first use.

    Attributes:
        plan: which rows the motion gives.
        start, stop: rows.
        model: of `torque`: the plan's, or one that differs in its terms' settings.
        coordinates: indices of the coordinates that its motors' rows are of, (motors,).
        blocks: index of each of its time blocks in an observation, (blocks,); empty where it is of none.
    """

    plan: Plan
    start: int
    stop: int
    model: DynamicModel
    coordinates: tuple[int, ...]
    blocks: tuple[int, ...] = ()

    @staticmethod
    def of(plan: Plan, start: int, stop: int) -> Chunk:
        """Rows start..stop of a plan, all whose torque is known."""
        return Chunk(plan, start, stop, plan.model, plan.model.known_rows)

    @cached_property
    def signals(self) -> Signals:
        """Those of the plan for the samples under the rows."""
        return self.plan.signals(*self.plan.window(self.start, self.stop))

    @property
    def c(self) -> Array:
        """Positions of the coordinates under the rows, (active, samples), SI."""
        return self.signals[0]

    @property
    def cd(self) -> Array:
        """Their velocities, (active, samples)."""
        return self.signals[1]

    @property
    def cdd(self) -> Array | None:
        """Their accelerations, (active, samples); None in the momentum formulation."""
        return self.signals[2]

    @property
    def t(self) -> Array:
        """Times of the rows, (rows,), s."""
        return self.plan.t(self.start, self.stop)

    @property
    def edges(self) -> np.ndarray:
        """First row of each time block in this chunk, and one past the last, (blocks + 1,)."""
        rows = self.stop - self.start
        return np.append(np.arange(0, rows, self.plan.block), rows)

    @cached_property
    def used(self) -> np.ndarray:
        """Whether each row is used, or was dropped as too slow, (motors, rows)."""
        return np.asarray(self.plan.weights(self.start, self.stop)[list(self.coordinates)] > 0)

    @cached_property
    def W(self) -> Array:
        """Rows in base parameters, zero where a row is not used, (motors, rows, p), SI."""
        W = treated_columns(self.plan, self.signals)[list(self.coordinates)]
        return np.asarray(W * self.used[:, :, None])

    @cached_property
    def y(self) -> Array:
        """Measured torque, zero where a row is not used, (motors, rows), N m or N."""
        return np.asarray(self.measured() * self.used)

    @cached_property
    def velocity(self) -> Array:
        """Velocity of the motors' coordinates at the rows' own samples, (motors, rows), rad/s or m/s."""
        return self.centres(self.cd)[list(self.coordinates)]

    def with_rows(self, W: Array, y: Array) -> Chunk:
        """The same chunk with other W and y (weighted, whitened, projected), and without its signals."""
        changed = replace(self)
        changed.__dict__.update(used=self.used, velocity=self.velocity, W=W, y=y)
        return changed

    def scaled(self, factors: Array) -> Chunk:
        """Each row of W and y multiplied by its factor, (motors, rows)."""
        return self.with_rows(self.W * factors[:, :, None], self.y * factors)

    def residual(self, beta: Array) -> Array:
        """y - W beta, (motors, rows); zero where a row is not used."""
        return np.asarray(self.y - self.W @ beta)

    def measured(self) -> Array:
        """Measured torque, treated, (motors, rows), N m or N."""
        window = self.plan.window(self.start, self.stop)
        return self.treated(coordinate_torque(self.model.device, self.plan.motion, *window))

    def torque(self, chi: Array) -> Array:
        """Model torque of these parameters of the core's columns, treated, (motors, rows), N m or N."""
        return treated_torque(self.plan, self.model, chi, self.signals)[list(self.coordinates)]

    def treated(self, signals: Array) -> Array:
        """Filtered and decimated like the measured torque, (active, samples) to (motors, rows)."""
        return self.filtered(signals)[list(self.coordinates)]

    def filtered(self, signals: Array) -> Array:
        """Any channels filtered and decimated, (channels, samples) to (channels, rows)."""
        return decimate(signals, self.plan.taps, self.plan.motion.treatment.decimation)

    def sizes(self, signals: Array) -> Array:
        """Filtered with the absolute taps, for magnitudes, (active, samples) to (motors, rows)."""
        taps = np.abs(self.plan.taps)
        return decimate(signals, taps / taps.sum(), self.plan.motion.treatment.decimation)[list(self.coordinates)]

    def centres(self, signals: Array) -> Array:
        """The sample that each row is of, (channels, samples) to (channels, rows)."""
        return signals[:, self.plan.filter.before :: self.plan.motion.treatment.decimation][:, : self.stop - self.start]


def chunks(model: DynamicModel, motion: Motion) -> Iterator[Chunk]:
    """All rows of a motion.

    Raises:
        LogMismatchError: the motion has more or fewer channels than the device has coordinates or motors, or its torque
            is not in the unit of the device's command.
        MotionTooShortError: not one row fits between the filters' ends.
    """
    plan = Plan.of(model, motion)
    for start, stop in plan.segments():
        yield Chunk.of(plan, start, stop)


def gathered(pieces: Iterable[tuple[Array, ...]], rows: int) -> tuple[Array, ...]:
    """Concatenate arrays of chunk after chunk along their last axis, (..., rows of the chunk) to (..., rows).

    Each piece is copied into its place as it comes, so the whole is not in memory twice.
    """
    joined: tuple[Array, ...] = ()
    start = 0
    for piece in pieces:
        joined = joined or tuple(np.empty((*part.shape[:-1], rows), part.dtype) for part in piece)
        stop = start + piece[0].shape[-1]
        for all_rows, part in zip(joined, piece, strict=True):
            all_rows[..., start:stop] = part
        start = stop
    return joined


# What an estimator does to rows before they are reduced.
Change = Callable[[Chunk], Chunk]


class Rows:
    """The rows of an observation, chunk by chunk; can be iterated any number of times."""

    def __init__(self, observation: Observation) -> None:
        self.observation = observation
        self._cached: list[Chunk] | None = None

    def __iter__(self) -> Iterator[Chunk]:
        if self._cached is None and self.observation.rows * (len(self.observation.base) + 1) <= _CACHED:
            self._cached = list(chunks_of(self.observation))
        return iter(self._cached) if self._cached is not None else chunks_of(self.observation)

    def residuals(self, beta: Array) -> list[Array]:
        """Residuals of each motor's used rows, (rows,) for each motor."""
        parts = [[e[used] for e, used in zip(s.residual(beta), s.used, strict=True)] for s in self]
        return [np.concatenate(own) for own in zip(*parts, strict=True)]

    def folded(self, change: Change, columns: Sequence[np.ndarray] | None = None) -> Observation:
        """The observation of the changed rows.

        Args:
            change: applied to every chunk.
            columns: base parameters that each motor's changed rows depend on; as before where None.
        """
        observation = self.observation
        reached = [motor.columns for motor in observation.motors] if columns is None else columns
        size = len(observation.blocks)
        r_factors = [np.zeros((size, len(own) + 1, len(own) + 1)) for own in reached]
        counts = np.zeros((len(reached), size), dtype=int)
        for chunk in self:
            changed = change(chunk)
            for k, (start, stop) in zip(changed.blocks, pairwise(changed.edges), strict=True):
                counts[:, k] = changed.used[:, start:stop].sum(axis=1)
                for T, own, W, y in zip(r_factors, reached, changed.W, changed.y, strict=True):
                    T[k] = r_factor(np.column_stack([W[start:stop, own], y[start:stop]]))
        motors = tuple(
            MotorRows(motor.name, motor.label, motor.unit, np.array(own), freeze(T), rows, free=motor.free)
            for motor, own, T, rows in zip(observation.motors, reached, r_factors, counts, strict=True)
        )
        before = observation.change
        return replace(observation, motors=motors, change=change if before is None else lambda s: change(before(s)))


def chunks_of(observation: Observation) -> Iterator[Chunk]:
    """All rows of an observation, changed as its own were."""
    index = {block: k for k, block in enumerate(observation.blocks)}
    own = tuple(observation.model.device.row_names.index(motor.name) for motor in observation.motors)
    for motion in observation.motions:
        plan = Plan.of(observation.model, motion)
        for numbers, start, stop in _runs(plan, plan.blocks(), index):
            chunk = Chunk(plan, start, stop, observation.model, own, tuple(numbers))
            unchanged = chunk.with_rows(chunk.W, chunk.y)
            yield observation.change(unchanged) if observation.change else unchanged


def _runs(plan: Plan, blocks: Sequence[Block], index: dict[Block, int]) -> Iterator[tuple[list[int], int, int]]:
    """Runs of neighbouring blocks that are in an observation: their indices there, and rows start..stop."""
    for first, last in plan.segments():
        run: list[int] = []
        begin = first
        for start in range(first, last, plan.block):
            k = index.get(blocks[start // plan.block])
            if k is not None:
                begin = begin if run else start
                run.append(k)
            elif run:
                yield run, begin, start
                run = []
        if run:
            yield run, begin, last
