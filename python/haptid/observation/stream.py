"""`RowStream`: time blocks of rows from samples as they come, with a fixed lag: the rows that `observe` gives of all.

A zero-phase filter needs samples after the row. A block is therefore reduced as soon as the samples behind it are so
many that the filter's transient from the end is below double precision; with `Causal` and `HighPass` that is at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from haptid._internal.arrays import Array, expect, positive
from haptid.dynamics.model import DynamicModel
from haptid.errors import LogDataError, SettingError
from haptid.log import Channels, Log
from haptid.motion.filters import ParallelFilter
from haptid.motion.motion import SIDE, TRANSIENT_LEFT, Motion, transient_samples, treat
from haptid.motion.streaming import memory
from haptid.motion.treatment import Treatment
from haptid.observation.observation import Observation, rows_by_motor
from haptid.observation.plan import OUTSIDE_GUARD, SEGMENT, Block, Plan

# Samples of a log so long that no transient of a filter is cut short by its length.
_LONG = 1 << 24


class RowStream:
    """Blocks of rows along a stream of samples.

    Rows, blocks and filters are those of `observe(model, treat(log, treatment))` for a log of the same samples that is
    long enough for blocks of `block_s` (`haptid.observation.plan`); the interior is equal to rounding at every time,
    and with `finish` the ends are too. Samples after a gap begin a part of their own, as another log would.

    Args:
        model: the dynamic model.
        channels: what the samples are; only sides and units of the two signals count.
        dt: step of the samples, s.
        treatment: settings; the default where None.
        name: of the source, for the blocks.

    Attributes:
        lag: samples after a block's last row that it waits for.

    Raises:
        SettingError: `dt` is not above zero, or the model has friction with a memory (presliding, warming).
        TreatmentError: a setting does not fit the rate.
    """

    def __init__(
        self,
        model: DynamicModel,
        channels: Channels,
        dt: float,
        treatment: Treatment | None = None,
        name: str = "stream",
    ) -> None:
        if not positive(dt):
            raise SettingError(f"dt is {dt!r}; write a step above zero, s.", where="dt", found=dt)
        if model.has_history:
            raise SettingError(
                f"{model.device.name} has friction that depends on all motion before (presliding or warming), which a "
                "stream in blocks does not have.",
                where="terms",
                advice="Identify it from a whole log.",
            )
        self.model, self.channels, self.dt, self.name = model, channels, dt, name
        self.treatment = settings = treatment or Treatment()
        self._filter: ParallelFilter = settings.parallel_filter(dt)
        self._block = max(1, round(settings.block_s / (settings.decimation * dt)))
        self._guard = self._filter.main_part(OUTSIDE_GUARD)
        if settings.reversal_guard_s is not None:
            self._guard = (round(settings.reversal_guard_s / dt),) * 2
        rest = max(1, round(settings.rest_s / dt)) if np.any(settings.rest_speed) else 0
        sections, shift = settings.position_filter(dt), settings.lost_to_delay(dt)
        ends = 0 if sections is None else memory(sections)
        if settings.velocity is None:
            self._after = shift + SIDE + (0 if sections is None else transient_samples(sections, _LONG))
            first, far = self._after, ends + SIDE + shift
        else:
            self._after = shift
            first, far = shift + settings.velocity.memory(dt, TRANSIENT_LEFT), shift + settings.velocity.memory(dt)
        self._first = first + self._filter.before
        self._reach = max(far, first) + max(self._filter.before, self._guard[0] + rest)
        self.lag = max(ends + SIDE + shift, self._after) + max(self._filter.after, self._guard[1] + rest)
        self._t = 0.0
        self._begin()

    def _begin(self) -> None:
        """A part without gaps that begins now."""
        self._t0, self._start, self._rows = self._t, 0, 0  # its time; sample that the buffer begins with; rows made
        self._position = np.zeros((0, len(self.channels.position.channels)))
        self._torque = np.zeros((0, len(self.channels.torque.channels)))

    def push(self, position: ArrayLike, torque: ArrayLike) -> Iterator[Observation]:
        """Take the next samples, and give the blocks that are complete by now, a few at a time.

        Args:
            position: (n, positions), rad or m, at the side that the channels have.
            torque: (n, torques), in the log's unit.

        Raises:
            ShapeError: the samples do not fit the channels.
            LogDataError: a sample is not finite.
            LogMismatchError: as for `observe`.
        """
        q, tau = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (position, torque))
        expect("position", q.shape, (None, len(self.channels.position.channels)))
        expect("torque", tau.shape, (len(q), len(self.channels.torque.channels)))
        for signal, x in (("position", q), ("torque", tau)):
            if not np.isfinite(x).all():
                raise LogDataError(f"{self.name}: a {signal} is not finite.", where=signal, advice="Mend the sender.")
        self._position, self._torque = np.concatenate([self._position, q]), np.concatenate([self._torque, tau])
        self._t += len(q) * self.dt
        last = self._start + len(self._position) - 1 - self.lag
        ready = (last - self._first) // self.treatment.decimation + 1  # rows whose samples are there
        yield from self._made((ready - self._rows) // self._block * self._block)

    def finish(self) -> Iterator[Observation]:
        """The rows up to the end of the samples, with the filters' ends of a log that ends here."""
        last = self._start + len(self._position) - 1 - self._after - self._filter.after
        yield from self._made((last - self._first) // self.treatment.decimation + 1 - self._rows)
        self._begin()

    def gap(self, seconds: float) -> Iterator[Observation]:
        """Samples are missing for so long, s: the rows up to the gap; what comes next is a part of its own."""
        yield from self.finish()
        self._t += seconds
        self._begin()

    def _made(self, rows: int) -> Iterator[Observation]:
        """The next rows; samples that no later row needs are forgotten."""
        d = self.treatment.decimation
        rows_per_plan = max(1, SEGMENT // (self._block * d)) * self._block
        for begin in range(self._rows, self._rows + rows, rows_per_plan):
            count = min(rows_per_plan, self._rows + rows - begin)
            low = max(self._start, self._first + begin * d - self._reach)
            high = self._first + (begin + count - 1) * d + self.lag + 1
            motion, first = self._motion(low, high), self._first + begin * d - low
            own = (motion, self._filter, first, count, self._block, self._guard)
            plan = Plan(self.model, *own, *self.model.needed)
            motors = rows_by_motor(plan, [plan.reduce(0, count)], plan.model.known_rows)
            if any(motor.rows.any() for motor in motors):  # not where the device rests: there is nothing to learn
                yield Observation(self.model, motors, self._blocks(begin, begin + count), (motion,))
        self._rows += max(rows, 0)
        drop = max(0, self._first + self._rows * d - self._reach - self._start)
        self._position, self._torque = self._position[drop:], self._torque[drop:]
        self._start += drop

    def _blocks(self, begin: int, end: int) -> tuple[Block, ...]:
        """Time blocks of some rows, on the grid of the part: neighbours share their edge exactly."""
        step = self.treatment.decimation * self.dt
        zero = self._t0 + self._first * self.dt - 0.5 * step
        edges = [*range(begin, end, self._block), end]
        return tuple(Block(self.name, zero + a * step, zero + b * step) for a, b in pairwise(edges))

    def _motion(self, low: int, high: int) -> Motion:
        """Samples of the part, treated."""
        part = slice(low - self._start, high - self._start)
        q, tau = self._position[part], self._torque[part]
        t: Array = self._t0 + self.dt * np.arange(low, low + len(q), dtype=np.float64)
        return treat(Log(Path(self.name), self.name, t, q, tau, self.channels), self.treatment)
