"""The treated rows themselves, stretch after stretch, for what triangles alone cannot tell.

W is never stored as a whole: methods that weigh single rows, or whiten them, have the rows made again, change them, and
fold them into triangles like those of the observation they came from. All that follows then works on triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import signal

from haptid._internal.arrays import Array, freeze
from haptid.motion.channels import coordinate_torque
from haptid.observation.observation import Block, MotorRows, Observation, Plan, triangle

# Numbers of rows that are kept from one pass to the next; more are made again, pass by pass.
KEPT = 1 << 26


@dataclass(frozen=True, eq=False)
class RowStretch:
    """Rows of all motors that follow one another without a break.

    Attributes:
        blocks: index of each block in the observation, (blocks,).
        edges: first row of each block here, and one past the last, (blocks + 1,).
        W: rows in base parameters, zero where a row does not count, (motors, rows, p), SI.
        y: torque of the same, (motors, rows), N m or N.
        used: whether each counts, (motors, rows).
        velocity: of the coordinates at the rows' own samples, (motors, rows), rad/s or m/s.
    """

    blocks: tuple[int, ...]
    edges: np.ndarray
    W: Array
    y: Array
    used: np.ndarray
    velocity: Array

    def residual(self, beta: Array) -> Array:
        """y - W beta, (motors, rows); zero where a row does not count."""
        return np.asarray(self.y - self.W @ beta)

    def scaled(self, factors: Array) -> RowStretch:
        """Each row multiplied by its factor, (motors, rows)."""
        return replace(self, W=self.W * factors[:, :, None], y=self.y * factors)


# What a method does to rows before they are folded.
Change = Callable[[RowStretch], RowStretch]


class Rows:
    """The rows of an observation, to be walked through any number of times."""

    def __init__(self, observation: Observation) -> None:
        self.observation = observation
        self._kept: list[RowStretch] | None = None

    def __iter__(self) -> Iterator[RowStretch]:
        if self._kept is None and self.observation.rows * (len(self.observation.base) + 1) <= KEPT:
            self._kept = list(stretches_of(self.observation))
        return iter(self._kept) if self._kept is not None else stretches_of(self.observation)

    def residuals(self, beta: Array) -> list[Array]:
        """Of each motor, the rows that count one after the other."""
        parts = [[e[used] for e, used in zip(s.residual(beta), s.used, strict=True)] for s in self]
        return [np.concatenate(own) for own in zip(*parts, strict=True)]

    def folded(self, change: Change, columns: Sequence[np.ndarray] | None = None) -> Observation:
        """The observation of the changed rows.

        Args:
            change: applied to every stretch.
            columns: base parameters that each motor's changed rows can reach; as before where None.
        """
        observation = self.observation
        reached = [motor.columns for motor in observation.motors] if columns is None else columns
        size = len(observation.blocks)
        triangles = [np.zeros((size, len(own) + 1, len(own) + 1)) for own in reached]
        counts = np.zeros((len(reached), size), dtype=int)
        for stretch in self:
            made = change(stretch)
            for k, (start, stop) in zip(made.blocks, pairwise(made.edges), strict=True):
                counts[:, k] = made.used[:, start:stop].sum(axis=1)
                for T, own, W, y in zip(triangles, reached, made.W, made.y, strict=True):
                    T[k] = triangle(np.column_stack([W[start:stop, own], y[start:stop]]))
        motors = tuple(
            MotorRows(motor.name, motor.label, motor.unit, np.array(own), freeze(T), many)
            for motor, own, T, many in zip(observation.motors, reached, triangles, counts, strict=True)
        )
        before = observation.change
        return replace(observation, motors=motors, change=change if before is None else lambda s: change(before(s)))


def stretches_of(observation: Observation) -> Iterator[RowStretch]:
    """All rows of an observation, changed as its own were, stretch after stretch."""
    index = {block: k for k, block in enumerate(observation.blocks)}
    for motion in observation.motions:
        plan = Plan.of(observation.model, motion)
        name = motion.log.sha256 if motion.log else f"motion {id(motion):x}"
        for numbers, start, stop in _runs(plan, plan.blocks(name), index):
            made = _made(observation, plan, numbers, start, stop)
            yield observation.change(made) if observation.change else made


def _runs(plan: Plan, blocks: Sequence[Block], index: dict[Block, int]) -> Iterator[tuple[list[int], int, int]]:
    """Neighbouring blocks that are in an observation: their indices there, and rows start..stop."""
    for first, last in plan.segments():
        run: list[int] = []
        for start in range(first, last, plan.block):
            k = index.get(blocks[start // plan.block])
            if k is not None:
                run.append(k)
            stop = min(start + plan.block, last)
            if run and (k is None or stop == last):
                end = start if k is None else stop
                yield run, end - _length(plan, len(run), end), end
                run = []


def _length(plan: Plan, blocks: int, end: int) -> int:
    """Rows of so many blocks that end at a row: the last block of a motion may be shorter."""
    return (blocks - 1) * plan.block + ((end - 1) % plan.block + 1)


def _made(observation: Observation, plan: Plan, numbers: list[int], start: int, stop: int) -> RowStretch:
    model = observation.model
    own = [model.device.row_names.index(motor.name) for motor in observation.motors]
    low, high = plan.window(start, stop)
    signals = plan.signals(low, high)
    used = plan.weights(start, stop)[own] > 0
    W = treated_columns(plan, signals)[own] * used[:, :, None]
    torque = decimated(
        coordinate_torque(model.device, plan.motion, low, high), plan.taps, plan.motion.treatment.decimation
    )
    centres = signals[1][:, plan.filter.before :: plan.motion.treatment.decimation][:, : stop - start]
    edges = np.append(np.arange(0, stop - start, plan.block), stop - start)
    return RowStretch(tuple(numbers), edges, W, torque[own] * used, used, centres[own])


def treated_columns(plan: Plan, signals: tuple[Array, Array, Array | None, Array]) -> Array:
    """Base parameters' columns of every coordinate's rows, filtered and decimated, (coordinates, rows, p)."""
    c, cd, cdd, own = signals
    model, shared, d = plan.model, plan.filter, plan.motion.treatment.decimation
    mechanism, loops = model.mechanism, model.loops(c, cd)
    if cdd is not None:
        made = decimated(mechanism.regressor(c, cd, cdd, own, list(plan.columns), loops), shared.taps, d)
    else:
        assert shared.slope is not None  # without accelerations the filter differentiates
        momentum, rest = mechanism.momentum_regressor(c, cd, own, list(plan.columns), loops)
        made = decimated(momentum, shared.slope, d) + decimated(rest, shared.taps, d)
    return np.ascontiguousarray(np.einsum("ckr,kp->crp", made, plan.selection, optimize=True))


def decimated(signals: Array, taps: Array, decimation: int) -> Array:
    """Every window's weighted sum, (..., samples) to (..., rows), oldest tap first."""
    if len(taps) == 1:
        return np.asarray(signals[..., ::decimation] * taps[0])
    late = -(len(taps) - 1) % decimation  # so that the first whole window falls on a sample that is kept
    kernel = np.concatenate([np.zeros(late), taps[::-1]])
    rows = (signals.shape[-1] - len(taps)) // decimation + 1
    first = (len(taps) - 1 + late) // decimation
    return np.asarray(signal.upfirdn(kernel, signals, down=decimation, axis=-1)[..., first : first + rows])
