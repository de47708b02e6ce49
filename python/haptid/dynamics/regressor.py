"""The regressor from a motion of the coordinates, and derivatives by that motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from haptid._internal.arrays import Array
from haptid._internal.late import dataclass
from haptid.device.expressions import CustomColumn
from haptid.device.terms.friction import LoadDependentFriction
from haptid.errors import MissingAccelerationError

if TYPE_CHECKING:
    from haptid.dynamics.model import DynamicModel

# Step sizes of central differences by position, velocity and acceleration.
DIFFERENCE_STEPS = (1e-6, 1e-5, 1e-4)


@dataclass(frozen=True, eq=False)
class CoreChannels:
    """The core's input channels for a motion, (channels, n) each.

    Attributes:
        motion: positions, velocities and accelerations of the torque rows' coordinates, (3, rows, n).
        own: the columns that Python computes, (externals, n).
        loops: inputs for joints whose rates vary; no channels where there are none.
    """

    model: DynamicModel
    motion: Array
    own: Array
    loops: Array

    @staticmethod
    def of(model: DynamicModel, motion: Array) -> CoreChannels:
        """From a motion of the coordinates, (3, rows, n)."""
        c, cd, cdd = motion = np.ascontiguousarray(motion)
        loops = model.loops(c, cd)
        loops = np.zeros((0, motion.shape[2])) if loops is None else loops
        return CoreChannels(model, motion, external(model, c, cd, cdd), loops)

    def torque_slopes(self, chi: Array) -> Array:
        """Derivatives of every row's torque by the motion, (rows, 3, rows, n); `chi` of the core's columns, (r,)."""
        regressor_columns = np.flatnonzero(chi)
        slopes = self.model.mechanism.torque_slopes(
            *self.motion, self.own, regressor_columns.tolist(), chi[regressor_columns].tolist(), self.loops
        )
        return self.by_motion(slopes)

    def by_motion(self, by_channel: Array) -> Array:
        """Derivatives by the motion, (..., 3, rows, n), from those by channels, (..., channels, n).

        Exact, except for the channels that Python computes, which are differentiated by central differences.
        """
        own = self.motion.shape[0] * self.motion.shape[1]
        slopes, by_python = by_channel[..., :own, :], by_channel[..., own:, :]
        slopes = slopes.reshape(*slopes.shape[:-2], *self.motion.shape).copy()
        for s, step in enumerate(DIFFERENCE_STEPS if by_python.size else ()):
            for j in range(self.motion.shape[1]):
                change = self._python_channels(s, j, step) - self._python_channels(s, j, -step)
                slopes[..., s, j, :] += (by_python * change).sum(axis=-2) / (2 * step)
        return slopes

    def _python_channels(self, s: int, j: int, step: float) -> Array:
        """The channels that Python computes, (own, n), with one position, velocity or acceleration moved by a step."""
        channels = CoreChannels.of(self.model, moved(self.motion, s, j, step))
        return np.concatenate([channels.own, channels.loops])


def moved(motion: Array, s: int, j: int, step: float) -> Array:
    """The motion with one position, velocity or acceleration changed by a step."""
    changed = motion.copy()
    changed[s, j] += step
    return changed


def external(
    model: DynamicModel, c: Array, cd: Array, cdd: Array | None, history: Mapping[str, Array] | None = None
) -> Array:
    """Columns that Python computes: counterbalances, user-defined ones, special friction, (columns, samples).

    Friction with presliding is that of steady sliding, and that of warming zero, unless their columns are given as
    `history`, see `DynamicModel.history`.

    Raises:
        MissingAccelerationError: a column reads accelerations, and `cdd` is None.
    """
    if not model.externals:
        return np.zeros((0, c.shape[1]))
    if cdd is None:
        cdd = np.zeros_like(c)  # no column reads it
        check_linear(model)
    to_joints = np.linalg.inv(model.device.row_map)
    return np.ascontiguousarray(model.external(to_joints @ c, to_joints @ cd, to_joints @ cdd, history))


def check_columns(model: DynamicModel) -> None:
    """Raise MissingAccelerationError if a user-defined column reads accelerations."""
    for term in model.externals:
        if isinstance(term.shape, CustomColumn) and term.shape.reads(
            {f"a_{name}" for name in model.device.joint_names}
        ):
            raise _acceleration_column(term.name)


def check_linear(model: DynamicModel) -> None:
    """The same, or if it has load-dependent friction: torque is then not linear in accelerations."""
    for term in model.externals:
        if isinstance(term.shape, LoadDependentFriction):
            raise _acceleration_column(term.name)
    check_columns(model)


def rows(model: DynamicModel, c: Array, cd: Array, cdd: Array, history: Mapping[str, Array] | None = None) -> Array:
    """All of the core's columns of every coordinate's torque, (coordinates, columns, samples)."""
    mechanism = model.mechanism
    regressor_columns = list(range(mechanism.columns))
    own = external(model, c, cd, cdd, history)
    return np.asarray(mechanism.regressor(c, cd, cdd, own, regressor_columns, model.loops(c, cd)))


def regressor_columns(model: DynamicModel, c: Array, cd: Array, cdd: Array, base: Array) -> Array:
    """Columns of inverse dynamics by base parameters, (n, p, samples)."""
    used = [int(k) for k in np.flatnonzero(base.any(axis=1))]
    c, cd, cdd = (np.ascontiguousarray(x) for x in (c, cd, cdd))
    own, loops = external(model, c, cd, cdd), model.loops(c, cd)
    raw = model.mechanism.regressor(c, cd, cdd, own, used, loops)
    if np.array_equal(base[used], np.eye(len(used))):
        return np.asarray(raw)
    return np.asarray(base[used].T @ raw)


def _acceleration_column(column: str) -> MissingAccelerationError:
    return MissingAccelerationError(
        f"column {column} reads accelerations, which momentum rows, the momentum observer and Kalman filters lack.",
        where=column,
        advice=(
            "Choose formulation = 'acceleration', estimate_force or another method, or write the term as a rotor "
            "inertia."
        ),
    )
