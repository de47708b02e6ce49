"""Rows of a simulated model made linear in its parameters: what was measured, less what was simulated, plus J beta."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from haptid._internal.arrays import Array, freeze
from haptid.errors import RowsByBlockError
from haptid.motion.treatment import Motion
from haptid.observation.filtering import decimate
from haptid.observation.observation import MotorRows, Observation
from haptid.observation.plan import Plan
from haptid.observation.rows import Chunk, Rows


@dataclass(frozen=True, eq=False)
class Linearised:
    """Along one motion, sample by sample and for every torque row of the device.

    Attributes:
        motion: along which.
        error: measured less simulated, (n, samples), SI.
        slope: derivatives of what was simulated by base parameters, (n, p, samples).
    """

    motion: Motion
    error: Array
    slope: Array


def gathered(observation: Observation, beta: Array, parts: Sequence[Linearised], units: Sequence[str]) -> Observation:
    """Rows J beta' = J beta + error, filtered and decimated as the observation's are, folded block by block.

    Rows that the treatment leaves out near slow motion are left out here too.

    Args:
        observation: whose motors and blocks they are of.
        beta: what was simulated with, (p,).
        parts: one for each of the observation's motions.
        units: of every motor's rows.
    """
    made = {block: rows for part in parts for block, rows in _rows(observation, part)}

    def change(stretch: Chunk) -> Chunk:
        J, error = (np.concatenate(x, axis=1) for x in zip(*(made[k] for k in stretch.blocks), strict=True))
        return stretch.with_rows(J * stretch.used[:, :, None], (error + J @ beta) * stretch.used)

    folded = Rows(observation).folded(change, [np.arange(len(beta)) for _ in observation.motors])
    motors = (replace(motor, unit=unit) for motor, unit in zip(folded.motors, units, strict=True))
    return replace(folded, motors=tuple(motors))


def _rows(observation: Observation, part: Linearised) -> Iterator[tuple[int, tuple[Array, Array]]]:
    """Of every block of one motion that the observation has: its index, J (motors, rows, p), and errors."""
    own = [observation.model.device.row_names.index(motor.name) for motor in observation.motors]
    plan, d = Plan.of(observation.model, part.motion), part.motion.treatment.decimation
    for block, (start, stop) in _blocks(observation, part.motion, plan):
        low, high = plan.window(start, stop)
        J = decimate(part.slope[own, :, low:high], plan.taps, d)
        yield block, (J.transpose(0, 2, 1), decimate(part.error[own, low:high], plan.taps, d))


def _blocks(observation: Observation, motion: Motion, plan: Plan) -> Iterator[tuple[int, tuple[int, int]]]:
    """Of every block of one motion that the observation has: its index, and its first row and one past the last."""
    index = {block: k for k, block in enumerate(observation.blocks)}
    blocks = plan.blocks(motion.log.sha256 if motion.log else f"motion {id(motion):x}")
    for block, rows in zip(blocks, pairwise([*range(0, plan.rows, plan.block), plan.rows]), strict=True):
        if block in index:
            yield index[block], rows


def by_block(observation: Observation, method: str, triangles: Array, rows: np.ndarray) -> Observation:
    """Rows of a method that tells no motors apart, and keeps triangles alone.

    Args:
        observation: whose blocks they are of.
        method: its name.
        triangles: of every block, (blocks, p + 1, p + 1), in units of their own deviation.
        rows: in each, (blocks,).
    """

    def refuse(_: Chunk) -> Chunk:
        raise RowsByBlockError(method)

    name = observation.motors[0].name  # a known one: its rows can be asked for, and are refused
    motor = MotorRows(name, method, "1", np.arange(triangles.shape[1] - 1), freeze(triangles), rows)
    return replace(observation, motors=(motor,), change=refuse)
