"""Observation: y = W beta + rho of one or several motions, reduced to one R factor for each motor and time block.

W is never stored: the core computes its rows, filters and decimates them together with the torques, and reduces them by
QR decomposition (TSQR).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Literal

import numpy as np

from haptid._internal.arrays import Array, expect, freeze, freeze_fields
from haptid._internal.display import Overview, displayed
from haptid._internal.late import dataclass
from haptid.dynamics.base_parameters import BaseParameters
from haptid.dynamics.model import DynamicModel
from haptid.errors import ModelMismatchError, NoRowsError, SharedRowsError, unknown_name
from haptid.motion.channels import check_log
from haptid.motion.motion import Motion
from haptid.motion.noise_torques import said_of_noise
from haptid.observation.plan import Block, Plan, RFactors, shared_block
from haptid.observation.r_factor import conditions, r_factor
from haptid.observation.torque_steps import rounding_of

if TYPE_CHECKING:
    from haptid.observation.rows import Change


@dataclass(frozen=True, eq=False)
class MotorRows:
    """Rows of one motor, reduced by QR block by block: R beta = z, and the norm of the residual.

    Attributes:
        name: of the motor, or of the joint where rows are the joints'.
        label: for tables and figures, "motor 1" or "joint 5".
        unit: of its torque, N m or N.
        columns: indices of the base parameters that this motor's torque depends on, (p,).
        r_factors: R factor [R z; 0 rest] of each block, (blocks, p + 1, p + 1), SI.
        rows: rows reduced into each block, (blocks,).
        rounding: RMS error by the steps of the torque channel, as far as the filter leaves it, N m or N; 0 where it is
            not known, or where rows are scaled.
        free: whether it is no motor but a joint that nothing drives, and y is zero by that.
    """

    name: str
    label: str
    unit: str
    columns: np.ndarray
    r_factors: Array
    rows: np.ndarray
    rounding: float = 0.0
    free: bool = False

    def __post_init__(self) -> None:
        size = len(self.columns) + 1
        freeze_fields(self, r_factors=(None, size, size))
        self.columns.flags.writeable = self.rows.flags.writeable = False
        expect("rows", np.shape(self.rows), (len(self.r_factors),))

    @cached_property
    def whole(self) -> Array:
        """R factor of all blocks together, (p + 1, p + 1)."""
        if len(self.r_factors) == 1:
            return freeze(self.r_factors[0])
        return freeze(r_factor(self.r_factors.reshape(-1, self.r_factors.shape[-1])))

    def residual(self, beta: Array) -> float:
        """Norm of y - W beta over the motor's rows, for all base parameters beta, N m or N."""
        return float(np.linalg.norm(self.whole @ np.append(-beta[self.columns], 1.0)))

    @property
    def norm(self) -> float:
        """Norm of y over the motor's rows, N m or N."""
        return float(np.linalg.norm(self.whole[:, -1]))

    def size(self, beta: Array) -> float:
        """What errors of the rows are relative to, for all base parameters beta, N m or N.

        The norm of y; of a free joint, where y is zero, the root of half the sum of squares of the terms that cancel:
        for two of them the norm of each.
        """
        if not self.free:
            return self.norm
        terms = np.linalg.norm(self.whole[:, :-1], axis=0) * beta[self.columns]
        return float(np.linalg.norm(terms) / np.sqrt(2.0))

    def own_residual(self, beta: Array) -> float:
        """What is left of a free joint's rows by parameters of their own, for all base parameters beta, N m or N.

        Zero holds at any scale of the parameters: the largest term stays as beta has it, and the others balance it as
        well as they can. Never more than `residual`, and much less where a wrong model of the motors moved beta.
        """
        own = beta[self.columns]
        used = np.flatnonzero(own)
        terms = self.whole[:, used] * own[used]
        largest = int(np.argmax(np.linalg.norm(terms, axis=0)))
        others = np.delete(terms, largest, axis=1)
        best = np.linalg.lstsq(others, -terms[:, largest], rcond=None)[0]
        return float(np.linalg.norm(terms[:, largest] + others @ best))

    def pick(self, blocks: np.ndarray) -> MotorRows:
        """Some blocks, by index."""
        return replace(self, r_factors=self.r_factors[blocks], rows=self.rows[blocks])


@displayed
@dataclass(frozen=True, eq=False)
class Observation:
    """Rows of all motors along one or several motions, in the base parameters of one device.

    Observations of one device add: `a + b`, or `sum` of several.

    Attributes:
        motors: rows by motor.
        blocks: source and time of each block's rows, (blocks,).
        motions: that the rows were computed from.
        notes: messages for the user.
        change: applied to the motions' rows before they were reduced, where a method weights or whitens them.
    """

    model: DynamicModel
    motors: tuple[MotorRows, ...]
    blocks: tuple[Block, ...]
    motions: tuple[Motion, ...]
    notes: tuple[str, ...] = ()
    change: Change | None = None

    @property
    def base(self) -> BaseParameters:
        """Base parameters, one for each column of W."""
        return self.model.base

    @property
    def rows(self) -> int:
        """Number of rows of all motors."""
        return int(sum(motor.rows.sum() for motor in self.motors))

    def __add__(self, other: Observation) -> Observation:
        """Rows of both, as `concatenated`."""
        return concatenated((self, other))

    def __radd__(self, other: Literal[0]) -> Observation:
        """0 + observation, so that `sum` of several observations works."""
        return self if other == 0 else NotImplemented

    def shares_rows_with(self, other: Observation) -> Block | None:
        """A block that overlaps one of the other observation; None where there is none."""
        return shared_block((self.blocks, other.blocks))

    def alternate(self, run: int = 1) -> tuple[Observation, Observation]:
        """Alternate runs of time blocks, to cross-validate: of 1 the first, third, ... and the second, fourth, ..."""
        index = np.arange(len(self.blocks))
        even, odd = (self.pick(index[index // run % 2 == parity]) for parity in (0, 1))
        return even, odd

    def pick(self, blocks: np.ndarray) -> Observation:
        """Some time blocks, by index."""
        motors = tuple(motor.pick(blocks) for motor in self.motors)
        return replace(self, motors=motors, blocks=tuple(self.blocks[k] for k in blocks))

    def stack(self, weights: Array | None = None) -> Array:
        """R factor [R z; 0 rest] of all rows, each motor's rows multiplied by its weight, (p + 1, p + 1)."""
        w = np.ones(len(self.motors)) if weights is None else weights
        return r_factor(stacked(self.motors, w, len(self.base)))

    @cached_property
    def condition(self) -> tuple[float, float]:
        """Condition number of W: as it is, and with its columns scaled to unit length."""
        return self.condition_without(())

    def condition_without(self, zero: Sequence[int]) -> tuple[float, float]:
        """Condition numbers of W without the columns of some base parameters, given by index."""
        return conditions(self.stack()[:-1, [k for k in range(len(self.base)) if k not in zero]])

    def only(self, motor: str) -> Observation:
        """Rows of one motor, given by name.

        Raises:
            UnknownNameError: there is none of that name.
        """
        names = [m.name for m in self.motors]
        if motor not in names:
            message = f"the observation has no rows of motor {motor!r}; it has rows of {', '.join(names)}."
            raise unknown_name(message, motor, names, "motor")
        return replace(self, motors=(self.motors[names.index(motor)],))

    def _shown(self) -> Overview:
        rows = [[m.label, str(int(m.rows.sum())), f"{m.norm:.4g}", m.unit] for m in self.motors]
        raw, scaled = self.condition
        about = f"{self.rows} rows, {len(self.base)} base parameters, {len(self.blocks)} time blocks"
        condition = f"condition {raw:.4g} raw, {scaled:.4g} with unit columns"
        title = f"Observation of {self.model.device.name}: {about}"
        return Overview(title, ("", "rows", "norm of the torque", "unit"), rows, (condition, *self.notes))


def concatenated(observations: Iterable[Observation]) -> Observation:
    """Rows of several observations of one device together.

    Raises:
        ModelMismatchError: they are of different devices.
        SharedRowsError: two of them share rows.
        ValueError: there is none.
    """
    first, *others = observations = tuple(observations)
    if not others:
        return first
    for other in others:
        if not other.model.is_same_as(first.model):
            raise different_models(first.model, other.model)
    shared = shared_block(one.blocks for one in observations)
    if shared is not None:
        raise SharedRowsError(
            f"two observations contain the rows from {shared.start:.3f} to {shared.stop:.3f} s of log "
            f"{shared.log[:12]}: counted twice, they would make every variance too small.",
            where=shared.log,
            found=(shared.start, shared.stop),
            advice="Leave one out.",
        )
    motors = tuple(
        replace(
            own[0],
            r_factors=freeze(np.concatenate([motor.r_factors for motor in own])),
            rows=np.concatenate([motor.rows for motor in own]),
            rounding=max(motor.rounding for motor in own),
        )
        for own in zip(*(one.motors for one in observations), strict=True)
    )
    blocks, motions, notes = (
        tuple(chain.from_iterable(getattr(one, name) for one in observations))
        for name in ("blocks", "motions", "notes")
    )
    return Observation(first.model, motors, blocks, motions, notes)


def observe(
    model: DynamicModel, motion: Motion, *others: Motion, progress: Callable[[float], None] | None = None
) -> Observation:
    """Reduce motions to R factors in the device's base parameters, as one observation.

    Args:
        motion, others: treated signals; the channels are the device's joints or motors, in order.
        progress: called with the share of the work done, 0 to 1.

    Raises:
        LogMismatchError: the log has more or fewer channels than the device has coordinates or motors, or positions
            that do not fit the joints.
        MotionTooShortError: not one row fits between the filters' ends.
        NoRowsError: every row of a motor was dropped as too slow, and no joint is locked.
        SharedRowsError: two motions share rows.
    """
    motions = (motion, *others)
    for one in motions:
        if one.log:
            check_log(model.device, one.log)
    plans = [Plan.of(model, one) for one in motions]
    made, done, total = [], 0, sum(plan.rows for plan in plans)
    for plan in plans:
        parts = []
        for start, stop in plan.segments():
            parts.append(plan.reduce(start, stop))
            done += stop - start
            if progress:
                progress(done / total)
        made.append(assemble(plan, parts))
    return concatenated(made)


def assemble(plan: Plan, parts: Sequence[RFactors]) -> Observation:
    """The observation of a plan's rows, from the R factors of its segments, in order.

    A motor that rests, or whose joint is locked, has no rows: its friction is not known, and other motors' rows count.

    Raises:
        NoRowsError: every row of every motor was dropped as too slow.
    """
    motion, motors = plan.motion, rows_by_motor(plan, parts, plan.model.known_rows)
    if not any(motor.rows.any() for motor in motors):
        speed, log = motion.treatment.reversal_speed, f"{motion.log.path.name}: " if motion.log else ""
        raise NoRowsError(
            f"{log}every row of every motor is slower than reversal_speed = {speed}, so none is left.",
            where="reversal_speed",
            found=0,
            limit=speed,
            advice="Lower `reversal_speed`, or record faster motion; `haptid poses` takes logs of held poses.",
        )
    notes = plan.notes()
    if motion.log:
        notes = (*check_log(plan.model.device, motion.log), *said_of_noise(plan.model.device, motion.log), *notes)
    return Observation(plan.model, motors, plan.blocks(), (motion,), notes)


def rows_by_motor(plan: Plan, parts: Sequence[RFactors], device_rows: Iterable[int]) -> tuple[MotorRows, ...]:
    """Rows of motors from the R factors of a plan's segments, in order; `device_rows` are indices into the device's."""
    device, rounding = plan.model.device, rounding_of(plan)
    rows = np.concatenate([counts for _, counts in parts], axis=1)
    return tuple(
        MotorRows(
            device.row_names[k],
            device.row_labels[k],
            device.torque_units[k],
            parts[0][0][k][0],
            freeze(np.concatenate([stack[k][1] for stack, _ in parts])),
            rows[k],
            float(rounding[k]),
            device.free_rows[k],
        )
        for k in device_rows
    )


def stacked(motors: Sequence[MotorRows], weights: Array, columns: int) -> Array:
    """Rows [R z] of all motors, each multiplied by its weight, with their columns in place, (rows, columns + 1).

    Columns of one motor with the same place are added.
    """
    parts = []
    for motor, weight in zip(motors, weights, strict=True):
        wide, place = np.zeros((len(motor.whole), columns + 1)), np.append(motor.columns, columns)
        if np.bincount(place).max() > 1:
            np.add.at(wide.T, place, (motor.whole * weight).T)
        else:  # the usual case, and five times as fast
            wide[:, place] = motor.whole * weight
        parts.append(wide)
    return np.concatenate(parts)


def different_models(first: DynamicModel, second: DynamicModel) -> ModelMismatchError:
    """Error of values of two devices that are combined."""
    names = first.device.name, second.device.name
    return ModelMismatchError(
        f"these are of two devices, {names[0]!r} and {names[1]!r}, or of one device read twice.",
        found=names,
        advice="Read the device once, and use it for every observation.",
    )
