"""From a motion to an observation: y = W beta + rho, kept as one small triangle per motor and time block.

W is never stored: the core makes its rows, filters and decimates them together with the torques, and folds them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from haptid import _core
from haptid._internal.arrays import Array, expect, freeze, read_only
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.errors import (
    DifferentModelError,
    MotionTooShortError,
    MotorNameError,
    NoRowsError,
    SameRowsError,
    TreatmentValueError,
)
from haptid.motion.channels import check_log, coordinate_torque, coordinates, state
from haptid.motion.parallel_filter import ParallelFilter
from haptid.motion.treatment import Motion

if TYPE_CHECKING:
    from haptid.observation.rows import RowStretch

# Samples handed to the core at a time: enough to keep its threads busy, little beside a log.
SEGMENT = 1 << 16
# Blocks of one motion that are kept apart; a longer one has blocks of twice, four times, ... the length.
MOST_BLOCKS = 512
# A short motion has shorter blocks than asked for: leaving one out must leave something.
LEAST_BLOCKS = 8
# What is left outside the guard around a row weighs less than this share of the parallel filter.
OUTSIDE_GUARD = 1e-3


@dataclass(frozen=True)
class Block:
    """A stretch of one log: rows between two times.

    Attributes:
        log: SHA-256 of the log, or a name for a motion without one.
        start, stop: s.
    """

    log: str
    start: float
    stop: float

    def overlaps(self, other: Block) -> bool:
        """Whether the two share rows."""
        return self.log == other.log and self.start < other.stop and other.start < self.stop


@dataclass(frozen=True, eq=False)
class MotorRows:
    """The rows of one motor, reduced by QR, block by block: R beta = z, and what is left over.

    Attributes:
        name: of the motor, or of the joint where rows are the joints'.
        label: what to write beside it, "motor 1" or "joint 5".
        unit: of its torque, N m or N.
        columns: base parameters that this motor's rows can reach, (p,).
        triangles: per block the upper triangle [R z; 0 rest], (blocks, p + 1, p + 1), SI.
        rows: rows reduced into each block, (blocks,).
    """

    name: str
    label: str
    unit: str
    columns: np.ndarray
    triangles: Array
    rows: np.ndarray

    def __post_init__(self) -> None:
        size = len(self.columns) + 1
        object.__setattr__(self, "triangles", read_only(self.triangles))
        self.columns.flags.writeable = self.rows.flags.writeable = False
        expect("triangles", self.triangles.shape, (None, size, size))
        expect("rows", np.shape(self.rows), (len(self.triangles),))

    @cached_property
    def whole(self) -> Array:
        """The triangle of all blocks together, (p + 1, p + 1)."""
        if len(self.triangles) == 1:
            return freeze(self.triangles[0])
        return freeze(triangle(self.triangles.reshape(-1, self.triangles.shape[-1])))

    def residual(self, beta: Array) -> float:
        """Norm of y - W beta over the motor's rows, for all base parameters beta, N m or N."""
        return float(np.linalg.norm(self.whole @ np.append(-beta[self.columns], 1.0)))

    @property
    def norm(self) -> float:
        """Norm of y over the motor's rows, N m or N."""
        return float(np.linalg.norm(self.whole[:, -1]))

    def pick(self, blocks: np.ndarray) -> MotorRows:
        """Only those blocks."""
        return replace(self, triangles=self.triangles[blocks], rows=self.rows[blocks])


def triangle(rows: Array) -> Array:
    """The square upper triangle R with R'R = rows'rows, (..., columns, columns), of rows (..., many, columns)."""
    *stacks, many, columns = rows.shape
    flat = np.ascontiguousarray(rows, dtype=float).reshape(math.prod(stacks), many, columns)
    return _core.triangles(flat).reshape(*stacks, columns, columns)


@dataclass(frozen=True, eq=False)
class Observation:
    """All motors' rows of one or several motions, in one device's base parameters.

    Attributes:
        model: the dynamic model.
        motors: rows by motor.
        blocks: where and when each block's rows are from, (blocks,).
        motions: what they were made from.
        notes: sentences a user should read.
        change: what was done to the motions' rows before they were folded, where a method weighs or whitens them.
    """

    model: DynamicModel
    motors: tuple[MotorRows, ...]
    blocks: tuple[Block, ...]
    motions: tuple[Motion, ...]
    notes: tuple[str, ...] = ()
    change: Callable[[RowStretch], RowStretch] | None = None

    @property
    def base(self) -> BaseParameters:
        """The parameters that the columns stand for."""
        return self.model.base

    @property
    def rows(self) -> int:
        """Rows of all motors."""
        return int(sum(motor.rows.sum() for motor in self.motors))

    def __add__(self, other: Observation) -> Observation:
        """Both together: observations of one device add."""
        if not other.model.is_same_as(self.model):
            raise DifferentModelError(self.model.device.name, other.model.device.name)
        shared = self.shares_rows_with(other)
        if shared is not None:
            raise SameRowsError(shared.log, shared.start, shared.stop)
        pairs = zip(self.motors, other.motors, strict=True)
        motors = tuple(
            replace(
                a,
                triangles=freeze(np.concatenate([a.triangles, b.triangles])),
                rows=np.concatenate([a.rows, b.rows]),
            )
            for a, b in pairs
        )
        return Observation(
            self.model,
            motors,
            self.blocks + other.blocks,
            self.motions + other.motions,
            self.notes + other.notes,
        )

    def shares_rows_with(self, other: Observation) -> Block | None:
        """A block of this observation whose rows are also in the other, if there is one."""
        for block in self.blocks:
            if any(block.overlaps(b) for b in other.blocks):
                return block
        return None

    def alternate(self) -> tuple[Observation, Observation]:
        """Every other block: the first, third, ... and the second, fourth, ..."""
        index = np.arange(len(self.blocks))
        even, odd = (self.pick(index[index % 2 == parity]) for parity in (0, 1))
        return even, odd

    def pick(self, blocks: np.ndarray) -> Observation:
        """Only those blocks."""
        motors = tuple(motor.pick(blocks) for motor in self.motors)
        return replace(self, motors=motors, blocks=tuple(self.blocks[k] for k in blocks))

    def stack(self, weights: Array | None = None) -> Array:
        """The triangle of all rows [R z; 0 rest], each motor's rows multiplied by its weight, (p + 1, p + 1)."""
        p, stop = len(self.base), 0
        rows = np.zeros((sum(len(motor.whole) for motor in self.motors), p + 1))
        for k, motor in enumerate(self.motors):
            start, stop = stop, stop + len(motor.whole)
            own = motor.whole if weights is None else motor.whole * weights[k]
            rows[start:stop, motor.columns], rows[start:stop, p] = own[:, :-1], own[:, -1]
        return triangle(rows)

    @cached_property
    def condition(self) -> tuple[float, float]:
        """Condition number of W: as it is, and with its columns scaled to unit length."""
        return self.condition_without(())

    def condition_without(self, zero: Sequence[int]) -> tuple[float, float]:
        """The same without the columns of some base parameters, given by index."""
        return conditions(self.stack()[:-1, [k for k in range(len(self.base)) if k not in zero]])

    def only(self, motor: str) -> Observation:
        """The rows of one motor, given by name.

        Raises:
            MotorNameError: there is none of that name.
        """
        names = [m.name for m in self.motors]
        if motor not in names:
            raise MotorNameError(motor, names)
        return replace(self, motors=(self.motors[names.index(motor)],))


def conditions(W: Array) -> tuple[float, float]:
    """Condition number of a matrix: as it is, and with its columns scaled to unit length."""
    return condition(W), scaled_condition(W)


def condition(W: Array) -> float:
    """Condition number of a matrix; infinite where it is singular."""
    singular = np.linalg.svd(W, compute_uv=False)
    return float(singular[0] / singular[-1]) if len(singular) and singular[-1] > 0 else float("inf")


def scaled_condition(W: Array) -> float:
    """The same with its columns scaled to unit length."""
    lengths = np.linalg.norm(W, axis=0)
    return condition(W / np.where(lengths > 0, lengths, 1.0))


def observe(model: DynamicModel, motion: Motion, progress: Callable[[float], None] | None = None) -> Observation:
    """Reduce a motion to triangles in the device's base parameters.

    Args:
        model: the dynamic model.
        motion: treated signals; its channels are the device's joints or motors, in order.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        ChannelCountError: the log has more or fewer channels than the device has coordinates or motors.
        LooksLikeDegreesError, LooksLikeRadiansError, SwappedChannelsError: positions that do not fit the joints.
        MotionTooShortError: not one row fits between the filters' ends.
        NoRowsError: every row of a motor was dropped as too slow, and no joint is locked.
    """
    if motion.log:
        check_log(model.device, motion.log)
    plan = Plan.of(model, motion)
    parts = []
    for start, stop in plan.segments():
        parts.append(plan.reduce(start, stop))
        if progress:
            progress(stop / plan.rows)
    return assemble(plan, parts)


# Triangles of some rows by coordinate (columns, stack), and how many rows went into each block, (coordinates, blocks).
Reduced = tuple[list[tuple[np.ndarray, Array]], np.ndarray]


def assemble(plan: Plan, parts: Sequence[Reduced]) -> Observation:
    """The observation of a plan's rows, from what its segments gave, in order.

    Raises:
        NoRowsError: every row of a motor was dropped as too slow, and no joint is locked.
    """
    model, motion = plan.model, plan.motion
    rows = np.concatenate([many for _, many in parts], axis=1)
    told = rows.any(axis=1)
    if not told.any() or not (told.all() or locked(motion)):
        raise NoRowsError(model.device.row_names[int(np.argmin(told))], motion.treatment.reversal_speed)
    motors = []
    for k in np.flatnonzero(model.device.measured):
        columns = parts[0][0][k][0]
        triangles = freeze(np.concatenate([stack[k][1] for stack, _ in parts]))
        motors.append(
            MotorRows(
                model.device.row_names[k],
                model.device.row_labels[k],
                model.device.torque_units[k],
                columns,
                triangles,
                rows[k],
            )
        )
    name = motion.log.sha256 if motion.log else f"motion {id(motion):x}"
    doubts = check_log(model.device, motion.log) if motion.log else ()
    return Observation(model, tuple(motors), plan.blocks(name), (motion,), doubts)


def locked(motion: Motion) -> bool:
    """Whether a position channel stands still throughout: of a locked joint the motor has nothing to tell."""
    if motion.log:
        return any(low == high for low, high in motion.log.spans)
    return bool((np.ptp(motion.q, axis=0) == 0).any())


# Position, velocity, acceleration (None where rows are made without) and columns that Python computes.
Signals = tuple[Array, Array, Array | None, Array]


def shared_filter(motion: Motion) -> ParallelFilter:
    """The filter that a motion's torque and columns share.

    Raises:
        MotionTooShortError: not one row fits between the filters' ends.
    """
    low, high = motion.usable
    length = 2 * motion.treatment.reach(motion.dt) + 1  # a filter much longer than the motion may not fit into memory
    if length < 2 * len(motion):
        made = motion.treatment.parallel_filter(motion.dt)
        if len(made) <= high - low:
            return made
        length = len(made)
    needed = (len(motion) - (high - low) + length) * motion.dt
    raise MotionTooShortError(len(motion) * motion.dt, needed, "the filters' ends")


@dataclass(frozen=True, eq=False)
class Plan:
    """Which rows a motion gives, and which columns of the core they need.

    Attributes:
        first: sample of row 0.
        rows: rows of each motor.
        block: rows of a time block.
        filter: the parallel filter.
        guard: samples before and after a row's own in which the motion must not be slow.
        columns: the core's columns that the base parameters need, and `selection` that makes them so.
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
        """Fit the rows between the ends that the filters leave."""
        treatment, (low, high) = motion.treatment, motion.usable
        speeds = np.atleast_1d(treatment.reversal_speed)
        if len(speeds) not in (1, len(model.device.row_names)):
            wanted = f"one figure, or {len(model.device.row_names)}: one for each row of torque"
            raise TreatmentValueError("reversal_speed", treatment.reversal_speed, wanted)
        shared = shared_filter(motion)
        rows = (high - low - len(shared)) // treatment.decimation + 1
        block = max(1, round(min(treatment.block / (treatment.decimation * motion.dt), rows / LEAST_BLOCKS)))
        while rows > MOST_BLOCKS * block:
            block *= 2
        guard = shared.main_part(OUTSIDE_GUARD)
        if treatment.guard is not None:
            guard = (round(min(treatment.guard / motion.dt, len(motion))),) * 2
        first = low + shared.before
        return Plan(model, motion, shared, first, rows, block, guard, *model.needed)

    @property
    def taps(self) -> Array:
        """Of the parallel filter."""
        return self.filter.taps

    def segments(self) -> Iterator[tuple[int, int]]:
        """Rows start..stop, whole blocks at a time."""
        step = self.block * max(1, SEGMENT // (self.block * self.motion.treatment.decimation))
        for start in range(0, self.rows, step):
            yield start, min(start + step, self.rows)

    def window(self, start: int, stop: int) -> tuple[int, int]:
        """Samples that rows start..stop need."""
        d = self.motion.treatment.decimation
        return self.first + start * d - self.filter.before, self.first + (stop - 1) * d + self.filter.after + 1

    def signals(self, low: int, high: int) -> Signals:
        """Position, velocity, acceleration where rows have one, and external columns of samples low..high."""
        if self.motion.treatment.momentum:
            c, cd = state(self.model.device, self.motion, low, high)
            return c, cd, None, external(self.model, c, cd, None)
        c, cd, cdd = coordinates(self.model.device, self.motion, low, high)
        return c, cd, cdd, external(self.model, c, cd, cdd)

    def blocks(self, log: str) -> tuple[Block, ...]:
        """When each block's rows are from."""
        step = self.motion.treatment.decimation * self.motion.dt
        begin = self.motion.t0 + self.first * self.motion.dt - 0.5 * step
        edges = [*range(0, self.rows, self.block), self.rows]
        return tuple(Block(log, begin + a * step, begin + b * step) for a, b in pairwise(edges))

    def reduce(self, start: int, stop: int) -> Reduced:
        """Triangles of rows start..stop by coordinate (columns, stack), and how many rows went into each block."""
        low, high = self.window(start, stop)
        weights = self.weights(start, stop)
        c, cd, cdd, own = self.signals(low, high)
        made = self.model.mechanism.reduce(
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
        return [self.selected(np.array(a), T) for a, T in made], np.add.reduceat(weights > 0, blocks, axis=1, dtype=int)

    @cached_property
    def _one_to_one(self) -> bool:
        """Whether the core's columns are those of the base parameters."""
        return np.array_equal(self.selection, np.eye(len(self.selection)))

    def selected(self, reached: np.ndarray, triangles: Array) -> tuple[np.ndarray, Array]:
        """Triangles over the core's columns as triangles over base parameters, which may be sums of several."""
        if self._one_to_one:
            return reached, triangles
        chosen = self.selection[reached]
        base = np.flatnonzero(chosen.any(axis=0))
        if chosen.shape == (len(base), len(base)) and (chosen[:, base] == np.eye(len(base))).all():
            return base, triangles
        mix = np.zeros((len(reached) + 1, len(base) + 1))
        mix[:-1, :-1], mix[-1, -1] = chosen[:, base], 1.0
        return base, triangle(triangles @ mix)

    def weights(self, start: int, stop: int) -> Array:
        """One for a row that counts, zero for one too near slow motion for sgn to be known, (coordinates, rows)."""
        model, treatment = self.model, self.motion.treatment
        weights = np.ones((len(model.device.row_names), stop - start))
        if not np.any(treatment.reversal_speed):
            return weights
        speeds = np.broadcast_to(np.asarray(treatment.reversal_speed, dtype=float), (len(model.device.row_names),))
        centres = self.first + treatment.decimation * np.arange(start, stop)
        low, high = self.motion.usable
        back, ahead = self.guard
        low, high = max(low, int(centres[0]) - back), min(high, int(centres[-1]) + ahead + 1)
        c, cd = state(model.device, self.motion, low, high)
        after = np.minimum(centres + ahead + 1, high) - low
        before = np.maximum(centres - back, low) - low
        for row, speed in enumerate(speeds):
            for term in model.coulomb_terms(row) if speed > 0 else ():
                slow = np.concatenate([[0], np.cumsum(np.abs(model.speed(term, c, cd)) < speed)])
                weights[row, slow[after] > slow[before]] = 0.0
        return weights
