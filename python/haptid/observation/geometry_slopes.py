"""Slopes of the model's torque by numbers of the device: home offsets, direction of gravity, compliance of motors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from haptid._internal.arrays import Array
from haptid.dynamics.inverse import rigid
from haptid.dynamics.model import DynamicModel
from haptid.observation.augmented import CandidateColumns, ResidualContext, torque_of

# Step of a derivative by an angle, rad, or a position, m.
SLOPE_STEP = 1e-3
# Of a torque's slope along a motion, (coordinates, samples), SI.
Slope = Callable[[ResidualContext], Array]


def home_offset_slope(model: DynamicModel, k: int) -> Slope:
    """Slope by an offset of the position of active joint k: true position less logged position."""
    direction = SLOPE_STEP * model.device.row_map[:, k, None]

    def values(context: ResidualContext) -> Array:
        c, cd, cdd = context.motion
        assert cdd is not None  # as callers require
        history = context.history
        ahead, behind = (torque_of(model, context.chi, c + sign * direction, cd, cdd, history) for sign in (1, -1))
        return np.asarray((ahead - behind) / (2 * SLOPE_STEP))

    return values


def compliance_slope(model: DynamicModel, k: int) -> Slope:
    """Slope by the compliance of a spring between row k's motor, whose position is logged, and what it moves.

    The spring gives way by compliance times the bodies' torque, so that the load is behind the motor by that much, with
    its velocity and acceleration. First order: right well below the frequency of the load on the spring.
    """
    own = np.eye(len(model.device.active))[:, k, None]

    def values(context: ResidualContext) -> Array:
        c, cd, cdd = context.motion
        assert cdd is not None  # as callers require
        chi, dt = rigid(model, context.chi), context.plan.motion.dt
        d = context.torque(chi)[k]
        rate = np.gradient(d, dt)
        behind = [own * signal for signal in (d, rate, np.gradient(rate, dt))]
        step = SLOPE_STEP / max(float(np.abs(d).max()), np.finfo(float).tiny)
        ahead, now = (
            torque_of(model, chi, c + s * behind[0], cd + s * behind[1], cdd + s * behind[2], context.history)
            for s in (step, -step)
        )
        return np.asarray((now - ahead) / (2 * step))

    return values


def slope_towards(other: DynamicModel, step: float, model: DynamicModel | None = None) -> Slope:
    """Slope by a number in which another model is larger by a step.

    Args:
        other: with the larger number.
        step: of the number.
        model: with the number as it is; None where that of the rows has friction of the same sign at every sample.
    """

    def values(context: ResidualContext) -> Array:
        c, cd, cdd = context.motion
        assert cdd is not None  # as callers require
        ahead = torque_of(other, context.chi, c, cd, cdd, context.history)
        # Rows near reversals have dry friction of another sign than a model without their plan, over a tiny step.
        now = context.predicted if model is None else torque_of(model, context.chi, c, cd, cdd, context.history)
        return np.asarray((ahead - now) / step)

    return values


def horizontal_axes(model: DynamicModel) -> Iterator[tuple[str, Array]]:
    """Two directions across gravity, each with its name: the axes of the base frame that are nearest to level."""
    gravity = model.device.gravity / np.linalg.norm(model.device.gravity)
    nearest = sorted(np.argsort(np.abs(gravity), kind="stable")[:2])
    first = np.eye(3)[nearest[0]] - gravity[nearest[0]] * gravity
    first /= np.linalg.norm(first)
    second = np.cross(gravity, first)
    second *= np.sign(second[nearest[1]]) or 1.0
    yield from zip(("xyz"[k] for k in nearest), (first, second), strict=True)


def tilted_gravity(model: DynamicModel, axis: Array, angle: float) -> DynamicModel:
    """The model with gravity of the same magnitude, to first order, turned by an angle towards an axis across it."""
    gravity = model.device.gravity
    return model.with_gravity(gravity + angle * np.linalg.norm(gravity) * axis)


def columns_of(slope: Slope, rows: int) -> list[CandidateColumns]:
    """A slope as columns, one for each row; computed once for all of them."""
    last: list[tuple[ResidualContext, Array]] = []

    def of_row(row: int, context: ResidualContext) -> Array:
        if not last or last[0][0] is not context:
            last[:] = [(context, slope(context))]
        return last[0][1][row : row + 1]

    return [CandidateColumns(np.eye(rows)[k], 1, partial(of_row, k)) for k in range(rows)]
