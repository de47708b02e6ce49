"""Passive joints of loops that are not linear: which of their positions the code finds, and how others follow these.

Loops often imply linear relations between passive joints although none is linear in the active ones: the platform of a
delta keeps its orientation, so that the joints at both ends of a rod turn by opposite angles. With them fewer positions
are unknown.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from haptid._internal.arrays import Array, freeze_fields
from haptid._internal.late import dataclass
from haptid.device.loops.linear import Closure
from haptid.device.loops.newton import NewtonClosure
from haptid.device.loops.relations import nearest
from haptid.dynamics.model import DynamicModel

# Random poses for each joint and coordinate, at which relations have to hold.
_POSES = 8
# Greatest difference from a relation, rad or mechanism sizes: positions at these poses are known to rounding.
_HOLDS = 1e-9
# Factors of a relation are multiples of this; others are a coincidence of the poses.
_FACTOR = 0.5
# A start position below this is zero, rad or m: single precision cannot hold what rounding leaves.
_ROUNDING = 1e-15


@dataclass(frozen=True, eq=False)
class PassiveJoints:
    """The joints that loops determine at every pose, as combinations of coordinates of the rows and of some of them.

    Attributes:
        joints: indices of all of them, in order.
        found: indices of those whose positions the code finds, by Newton's method.
        rates: of all of them by the rows' coordinates, then by the positions found, (joints, active + found).
        offset: of all of them, (joints,), rad or m.
    """

    joints: tuple[int, ...]
    found: tuple[int, ...]
    rates: Array
    offset: Array

    def __post_init__(self) -> None:
        freeze_fields(self, "rates", offset=(len(self.joints),))


@lru_cache(maxsize=8)
def passive_joints(model: DynamicModel) -> PassiveJoints:
    """The passive joints of a device's loops that follow at varying rates; none where all loops are linear."""
    device, closure = model.device, model.device.closure
    active = len(device.active)
    if isinstance(closure, Closure):
        return PassiveJoints((), (), np.zeros((0, active)), np.zeros(0))
    qa = closure.draw(np.random.default_rng(0), _POSES * (active + len(closure.unknown)))
    q, known = closure.positions(qa), device.row_map @ qa
    found: list[int] = []
    rows: list[tuple[Array, float]] = []
    for j in closure.unknown:
        relation = _relation(known, q[j], float(closure.units[j]))
        if relation is None:
            found.append(j)
            known = np.vstack([known, q[j]])
            relation = np.eye(len(known))[-1], 0.0
        rows.append(relation)
    rates = np.zeros((len(rows), len(known)))
    for made, (row, _) in zip(rates, rows, strict=True):
        made[: len(row)] = row
    return PassiveJoints(closure.unknown, tuple(found), rates, np.array([offset for _, offset in rows]))


def _relation(known: Array, x: Array, unit: float) -> tuple[Array, float] | None:
    """The position of a joint as a combination of known ones, with its constant; None where it is not."""
    columns = np.vstack([known, np.ones(known.shape[1])]).T
    factors = np.linalg.lstsq(columns, x, rcond=None)[0][:-1]
    row = _FACTOR * np.round(factors / _FACTOR)
    rest = x - row @ known
    return (row, nearest(float(rest.mean()), np.pi / 12)) if float(np.ptp(rest)) < _HOLDS * unit else None


def passive_positions(model: DynamicModel, q: Array) -> Array:
    """Positions of the joints that the code finds, (found, samples), rad or m, at coordinates of the torque rows."""
    positions = model.device.closure.positions(np.asarray(np.linalg.solve(model.device.row_map, q)))
    return np.asarray(positions[list(passive_joints(model).found)])


def start_pose(model: DynamicModel) -> Array:
    """Coordinates of the torque rows at which loops were first closed, (active,); zero without such loops."""
    closure = model.device.closure
    at = closure.at if isinstance(closure, NewtonClosure) else np.zeros(len(model.device.active))
    return np.asarray(model.device.row_map @ at)


def start_positions(model: DynamicModel) -> Array:
    """Positions of the joints that the code finds at the start pose, (found,), without rounding errors."""
    z = passive_positions(model, start_pose(model)[:, None])[:, 0]
    return np.where(np.abs(z) < _ROUNDING, 0.0, z)
