"""A motion's treated rows, stretch after stretch: what dissection and force estimate make their torques on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.model import DynamicModel
from haptid.motion.channels import coordinate_torque
from haptid.motion.treatment import Motion
from haptid.observation.observation import Plan
from haptid.validation.prediction import decimate, treated_torque


@dataclass(frozen=True, eq=False)
class Stretch:
    """Signals under a number of rows that fit in memory together.

    Attributes:
        model: the dynamic model.
        plan: which rows the motion gives.
        start, stop: rows.
        c, cd, cdd: coordinates that torque rows belong to, and their rates, each (active, samples), SI; no acceleration
            where the treatment has none.
        own: columns that Python computes, (externals, samples).
    """

    model: DynamicModel
    plan: Plan
    start: int
    stop: int
    c: Array
    cd: Array
    cdd: Array | None
    own: Array

    @staticmethod
    def of(plan: Plan, start: int, stop: int) -> Stretch:
        """Rows start..stop of a plan."""
        return Stretch(plan.model, plan, start, stop, *plan.signals(*plan.window(start, stop)))

    @property
    def rows(self) -> list[int]:
        """Indices of the coordinates whose torque is measured."""
        return [k for k, known in enumerate(self.model.device.measured) if known]

    @property
    def t(self) -> Array:
        """Of the rows, (rows,), s."""
        motion, step = self.plan.motion, self.plan.motion.treatment.decimation
        return np.asarray(motion.t0 + motion.dt * (self.plan.first + step * np.arange(self.start, self.stop)))

    @property
    def used(self) -> np.ndarray:
        """Whether a row counts, or was dropped as too slow, (measured, rows)."""
        return np.asarray(self.plan.weights(self.start, self.stop)[self.rows] > 0)

    def measured(self) -> Array:
        """Measured torque, treated, (measured, rows), N m or N."""
        return self.treated(
            coordinate_torque(self.model.device, self.plan.motion, *self.plan.window(self.start, self.stop))
        )

    def torque(self, chi: Array) -> Array:
        """Torque of these parameters of the core's columns, treated, (measured, rows), N m or N."""
        signals = (self.c, self.cd, self.cdd, self.own)
        return treated_torque(self.plan, self.model, chi, signals)[self.rows]

    def treated(self, signals: Array) -> Array:
        """Through the filter and decimation of the measured torque, (active, samples) to (measured, rows)."""
        return self.filtered(signals)[self.rows]

    def filtered(self, signals: Array) -> Array:
        """The same of any channels, (channels, samples) to (channels, rows)."""
        return decimate(signals, self.plan.taps, self.plan.motion.treatment.decimation)

    def sizes(self, signals: Array) -> Array:
        """The same of sizes, without the negative lobes of the filter, (active, samples) to (measured, rows)."""
        taps = np.abs(self.plan.taps)
        return decimate(signals, taps / taps.sum(), self.plan.motion.treatment.decimation)[self.rows]

    def centres(self, signals: Array) -> Array:
        """The sample that every row is of, (channels, samples) to (channels, rows)."""
        return signals[:, self.plan.filter.before :: self.plan.motion.treatment.decimation][:, : self.stop - self.start]


def stretches(model: DynamicModel, motion: Motion) -> Iterator[Stretch]:
    """All rows of a motion.

    Raises:
        ChannelCountError: the motion has more or fewer channels than the device has coordinates or motors.
        CommandUnitError: the log's unit of torque is not the unit of the device's command.
        MotionTooShortError: not one row fits between the filters' ends.
    """
    plan = Plan.of(model, motion)
    for start, stop in plan.segments():
        yield Stretch.of(plan, start, stop)


def gathered(pieces: Iterable[tuple[Array, ...]], rows: int) -> tuple[Array, ...]:
    """Arrays of stretch after stretch, each (..., rows of the stretch), as arrays of all rows, each (..., rows).

    Each piece is let go as soon as it is in its place: what is made is not in memory twice.
    """
    whole: tuple[Array, ...] = ()
    start = 0
    for piece in pieces:
        whole = whole or tuple(np.empty((*part.shape[:-1], rows), part.dtype) for part in piece)
        stop = start + piece[0].shape[-1]
        for all_rows, part in zip(whole, piece, strict=True):
            all_rows[..., start:stop] = part
        start = stop
    return whole
