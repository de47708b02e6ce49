"""The residual row by row, and what moved meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array, read_only
from haptid.dynamics.inverse import raw_parameters
from haptid.estimation import Estimate
from haptid.inference.diagnosis.added_variable import device_rows
from haptid.inference.diagnosis.subsample import numbered, runs
from haptid.motion.treatment import Motion
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk

# Rows without residual between two stretches: no lag that is looked at reaches across.
BETWEEN = 400
# Rows so far apart that the shared filter alone correlates them by less than this count as apart.
APART = 0.02


@dataclass(frozen=True, eq=False)
class Residuals:
    """What an estimate leaves of every motor's treated torque; NaN where a row does not count.

    Attributes:
        labels, units: of the motors, (motors,).
        t: (rows,), s.
        step: between rows, s.
        e: measured less model torque, (motors, rows), N m or N.
        predicted: torque of the model, (motors, rows).
        position, velocity: of the coordinates that torque rows belong to, (active, rows), SI.
        block: index into the observation's blocks, -1 for none, (rows,).
        filter_stride: rows from one to the next that the shared filter does not correlate.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    step: float
    e: Array
    predicted: Array
    position: Array
    velocity: Array
    block: np.ndarray
    filter_stride: int

    def __post_init__(self) -> None:
        for name in ("t", "e", "model", "position", "velocity"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        self.block.flags.writeable = False

    def used(self, motor: int) -> np.ndarray:
        """Whether each row counts, (rows,)."""
        return np.asarray(np.isfinite(self.e[motor]))


def residuals(estimate: Estimate) -> Residuals:
    """Of all blocks that the estimate was made from, one after the other."""
    motions = estimate.observation.motions
    parts = [part for motion in motions for part in _of(estimate, motion)]
    t, e, predicted, position, velocity, block = (np.concatenate(each, axis=-1) for each in zip(*parts, strict=True))
    e = np.where(block < 0, np.nan, e)
    rows = estimate.observation.motors
    return Residuals(
        labels=tuple(motor.label for motor in rows),
        units=tuple(motor.unit for motor in rows),
        t=t,
        step=motions[0].treatment.decimation * motions[0].dt,
        e=e,
        predicted=predicted,
        position=position,
        velocity=velocity,
        block=block.astype(int),
        filter_stride=max(filter_stride(motion) for motion in motions),
    )


Part = tuple[Array, Array, Array, Array, Array, Array]


def _of(estimate: Estimate, motion: Motion) -> Iterator[Part]:
    """Stretches of one motion; rows without residual between those that are no neighbours, and at the end."""
    model, plan = estimate.model, Plan.of(estimate.model, motion)
    chi = raw_parameters(model, estimate.beta)
    wanted = estimate.observation.blocks
    index = dict(numbered(plan, wanted))
    measured_rows = np.flatnonzero(model.device.measured).tolist()
    own = [measured_rows.index(row) for row in device_rows(estimate)]
    end = 0
    for start, stop in runs(plan, wanted):
        stretch = Chunk.of(plan, start, stop)
        if start > end:
            yield _nothing(len(own), len(stretch.c))
        measured, predicted = stretch.measured()[own], stretch.torque(chi)[own]
        e = np.where(stretch.used[own], measured - predicted, np.nan)
        block = np.array([index[row // plan.block] for row in range(start, stop)], dtype=float)
        yield stretch.t, e, predicted, stretch.centres(stretch.c), stretch.centres(stretch.cd), block
        end = stop
    yield _nothing(len(own), len(model.device.row_names))


def _nothing(motors: int, coordinates: int) -> Part:
    """Rows without residual."""
    e, c = (np.full((size, BETWEEN), np.nan) for size in (motors, coordinates))
    return np.full(BETWEEN, np.nan), e, e, c, c, np.full(BETWEEN, -1.0)


def filter_stride(motion: Motion) -> int:
    """Rows from one to the next that the filter shared by torque and columns does not correlate."""
    treatment = motion.treatment
    taps, d = treatment.taps(motion.dt), treatment.decimation
    full = np.correlate(taps, taps, mode="full")[len(taps) - 1 :: d]
    alike = np.flatnonzero(np.abs(full) > APART * full[0])
    return int(alike[-1]) + 1
