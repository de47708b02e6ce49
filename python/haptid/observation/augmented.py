"""Rows with candidate columns after those of the base parameters, and the signals that these are computed from.

The core computes, filters, decimates and reduces the candidates together with W and the torque, so that they pass the
same filter and cost one more reduction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields
from functools import cached_property

import numpy as np
from scipy import linalg

from haptid._internal.arrays import Array, freeze
from haptid._internal.late import dataclass
from haptid.device.terms.term import TermColumn
from haptid.dynamics.inverse import core_torque
from haptid.dynamics.model import DynamicModel
from haptid.dynamics.regressor import external
from haptid.motion.channels import channel_shares, channel_torque, state
from haptid.motion.motion import Motion
from haptid.observation.observation import MotorRows, rows_by_motor
from haptid.observation.plan import Plan, Signals

# Samples before those of a chunk from which a column with history is computed.
_APPROACH = 1 << 15


@dataclass(frozen=True, eq=False)
class ResidualContext:
    """A range of samples of a motion.

    Attributes:
        plan: of the rows.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        low, high: first sample, and one past the last.
        signals: the plan's of these samples, computed where None.
    """

    plan: Plan
    chi: Array
    low: int
    high: int
    signals: Signals | None = None
    _torques: dict[bytes, Array] = field(default_factory=dict, init=False, repr=False)
    _shared: dict[bytes, Array] = field(default_factory=dict, init=False, repr=False)

    @property
    def model(self) -> DynamicModel:
        """The dynamic model of the estimate."""
        return self.plan.model

    @cached_property
    def history(self) -> dict[str, Array]:
        """Columns that the state does not determine, by name, each (samples,)."""
        return self.plan.history(self.low, self.high)

    @cached_property
    def motion(self) -> tuple[Array, Array, Array | None]:
        """Position, velocity, and acceleration where rows have one, each (coordinates, samples), SI."""
        return self._signals[:3]

    @cached_property
    def _signals(self) -> Signals:
        return self.signals or self.plan.signals(self.low, self.high)

    @cached_property
    def approach(self) -> tuple[Array, Array]:
        """Positions and velocities of the samples and of those before, where a history begins, (coordinates, ...)."""
        motion = self.plan.motion
        return state(self.model.device, motion, max(motion.usable[0], self.low - _APPROACH), self.high)

    @cached_property
    def channel_shares(self) -> Array:
        """B of the torque channels, (samples or 1, channels, coordinates); see `haptid.motion.channels`."""
        return channel_shares(self.model.device, self.plan.motion, self.motion[0])

    def channel_torque(self, chi: Array) -> Array:
        """Torque of the channels of given parameters of the core's columns, (channels, samples), N m or N.

        By the distribution law, or the minimal norm where the device file has none. The columns of all channels are
        made of one such torque, which is kept.
        """
        key = chi.tobytes()
        if key not in self._shared:
            self._shared[key] = freeze(channel_torque(self.model.device, self.channel_shares, self.torque(chi)))
        return self._shared[key]

    @cached_property
    def predicted(self) -> Array:
        """Torque of the estimate, (coordinates, samples), N m or N."""
        return self.torque(self.chi)

    def torque(self, chi: Array) -> Array:
        """Torque of given parameters of the core's columns, (coordinates, samples), N m or N; static without cdd.

        Many candidate columns are made of the same few torques, which are kept.
        """
        key = chi.tobytes()
        if key not in self._torques:
            c, cd, cdd, own = self._signals
            cdd = np.zeros_like(c) if cdd is None else cdd
            self._torques[key] = freeze(core_torque(self.plan.core, chi, c, cd, cdd, own))
        return self._torques[key]


def torque_of(
    model: DynamicModel, chi: Array, c: Array, cd: Array, cdd: Array, history: Mapping[str, Array] | None = None
) -> Array:
    """Torque of the core's columns and of those that Python computes, (coordinates, samples), N m or N."""
    return core_torque(model, chi, c, cd, cdd, external(model, c, cd, cdd, history))


@dataclass(frozen=True, eq=False)
class CandidateColumns:
    """Columns that the model lacks, all acting on one coordinate.

    Attributes:
        weights: the coordinate, as a combination of the device's coordinates, (active,).
        count: number of columns.
        values: of the columns along a motion, (count, samples), SI.
    """

    weights: Array
    count: int
    values: Callable[[ResidualContext], Array]


@dataclass(frozen=True, eq=False)
class AugmentedPlan(Plan):
    """A plan whose rows include the candidate columns.

    Attributes:
        narrow: the plan without them.
        chi: the estimate's parameters of the core's columns, (r,), SI.
        candidates: what is added.
    """

    narrow: Plan
    chi: Array
    candidates: tuple[CandidateColumns, ...]

    def signals(self, low: int, high: int) -> Signals:
        """Those of the plan without, and the candidates' values after the columns that Python computes."""
        c, cd, cdd, own = self.narrow.signals(low, high)
        context = ResidualContext(self.narrow, self.chi, low, high, (c, cd, cdd, own))
        return c, cd, cdd, np.concatenate([own, *(candidate.values(context) for candidate in self.candidates)])


def torque_rates(model: DynamicModel, rows: Sequence[int]) -> tuple[CandidateColumns, ...]:
    """For every row, the time derivative of the model's torque: the column of a delay."""

    def rate(row: int) -> CandidateColumns:
        return CandidateColumns(
            np.eye(len(model.device.active))[row],
            1,
            lambda context: np.gradient(context.predicted[row], context.plan.motion.dt)[None],
        )

    return tuple(rate(row) for row in rows)


def augmented_plan(
    model: DynamicModel, motion: Motion, chi: Array, candidates: Sequence[CandidateColumns]
) -> AugmentedPlan:
    """The plan of a motion's rows, with candidate columns.

    Args:
        motion: treated signals.
        chi: parameters of the core's columns from which the candidates' signals are computed, (r,), SI.
        candidates: what is added.
    """
    plan = Plan.of(model, motion)
    candidate_terms = [
        TermColumn("", "", "external", "", candidate.weights)
        for candidate in candidates
        for _ in range(candidate.count)
    ]
    columns = len(model.device.parameters.raw) + np.arange(len(candidate_terms))
    selection = linalg.block_diag(plan.selection, np.eye(len(candidate_terms)))
    with_more = model.with_terms([*model.terms, *candidate_terms])
    shared = {attribute.name: getattr(plan, attribute.name) for attribute in fields(plan)}
    shared |= {"model": with_more, "columns": (*plan.columns, *columns.tolist()), "selection": selection}
    return AugmentedPlan(**shared, narrow=plan, chi=chi, candidates=tuple(candidates))


def reduced(wide: AugmentedPlan, rows: Sequence[int], ranges: Sequence[tuple[int, int]]) -> tuple[MotorRows, ...]:
    """R factors of some rows of every motor, with the candidates' columns after the base parameters'.

    Args:
        wide: the plan.
        rows: index of the device's row of each motor.
        ranges: first row and one past the last, of whole blocks.
    """
    parts = [wide.reduce(start, stop) for start, stop in ranges]
    return rows_by_motor(wide.narrow, parts, rows)
